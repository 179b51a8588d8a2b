"""Reads a result file of dosui: VTKHDF poly data plus /History and /Scene.

A run that was killed leaves a valid file: only the first `NSteps` steps and the first
`n_entries` rows of the histories count, whatever room the datasets have. What is read is compared
with the file's checksums; files of versions that had none are read without.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from dosui_post.checksum import checksum, rows_checksums, text_checksum
from dosui_post.errors import DosuiPostError
from dosui_post.namelist import Group, parse

FloatArray = npt.NDArray[np.float64]

AXES = "xyz"


class Scene:
    """The scene as the run understood it: the echo, and the text as read for what it lacks."""

    def __init__(self, text: str, echo: str) -> None:
        self.text = text
        self.echo = echo
        self.groups = parse(echo)
        known = {group.name for group in self.groups}
        self.groups += [group for group in parse(text) if group.name not in known]

    def all(self, name: str) -> list[Group]:
        """Every group of a name, in the scene's order."""
        return [group for group in self.groups if group.name == name]

    def with_key(self, key: str) -> Group:
        """The first group that has a key; an empty one if there is none."""
        return next((group for group in self.groups if key in group), Group("scene"))

    def one(self, name: str) -> Group:
        """The first group of a name; an empty one if there is none."""
        groups = self.all(name)
        return groups[0] if groups else Group(name)


class Result:
    """An open result file. Use it in a `with` block."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._file = _open(self.path)
        try:
            self._read_layout()
        except (KeyError, IndexError, TypeError, ValueError, OSError, RuntimeError) as error:
            self._file.close()
            raise DosuiPostError(f"{self.path} is not a result file of dosui: {error}") from error
        except DosuiPostError:
            self._file.close()
            raise

    def __enter__(self) -> Result:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    @property
    def name(self) -> str:
        """Name of the file without its ending."""
        return self.path.stem

    @property
    def n_steps(self) -> int:
        """Completed output steps."""
        return len(self.times)

    def points(self, step: int) -> FloatArray:
        """Positions of the particles (n, 3) [m], as written."""
        with self._reading():
            offset = int(self._steps["PointOffsets"][self._index(step)])
            return self._rows(self._root["Points"], "Points", offset, step)

    def field_names(self) -> list[str]:
        """Names of the fields stored for every particle."""
        return sorted(self._root["PointData"])

    def has_field(self, name: str) -> bool:
        """Tells whether there is a field of this name."""
        return name in self._root["PointData"]

    def field(self, name: str, step: int) -> FloatArray:
        """A field of one step, (n) or (n, components), in the unit of `field_unit`."""
        with self._reading():
            data = self._field(name)
            offsets = self._steps.get("PointDataOffsets", {})
            table = offsets[name] if name in offsets else self._steps["PointOffsets"]
            return self._rows(data, name, int(table[self._index(step)]), step)

    def field_unit(self, name: str) -> str:
        """Unit of a field, '' for a pure number."""
        return _unit(self._field(name))

    def reference_points(self, step: int) -> FloatArray:
        """Positions before the deformation (n, 3) [m].

        Small-strain runs leave the particles where they are; in updated runs the
        displacement is taken off.
        """
        points = self.points(step)
        if self._points_move() and self.has_field("displacement"):
            points = points - self.field("displacement", step)
        return points

    def history_names(self) -> list[str]:
        """Names of the histories, `time` among them."""
        return sorted(self._history) if self._history is not None else []

    def history(self, name: str) -> FloatArray:
        """Completed rows of a history."""
        if self._history is None or name not in self._history:
            known = ", ".join(self.history_names()) or "none"
            raise DosuiPostError(f"{self.path} has no history '{name}' (it has: {known})")
        with self._reading():
            self._check_history()
            return np.asarray(self._history[name][: self._n_entries], dtype=np.float64)

    def history_unit(self, name: str) -> str:
        """Unit of a history, '' for a pure number."""
        self.history(name)
        assert self._history is not None
        return _unit(self._history[name])

    def step_near(self, time: float) -> int:
        """Step whose time is nearest to `time` [s]."""
        return int(np.argmin(np.abs(self.times - time)))

    # ------------------------------------------------------------------ inside

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """What HDF5 cannot read is damaged."""
        try:
            yield
        except (KeyError, TypeError, ValueError, OSError, RuntimeError) as error:
            raise DosuiPostError(f"{self.path} is damaged: {error}") from error

    def _read_layout(self) -> None:
        if "VTKHDF" not in self._file:
            raise DosuiPostError(f"{self.path} is not a result file of dosui: it has no /VTKHDF")
        self._root = self._file["VTKHDF"]
        self._steps = self._root["Steps"]
        n_steps = int(self._steps.attrs["NSteps"])
        if n_steps < 1:
            raise DosuiPostError(f"{self.path} has no completed output step")
        # What is missing is missed here, not in the middle of a figure.
        needed = [self._root["Points"], self._root["PointData"], self._steps["PointOffsets"]]
        if any(len(part) == 0 for part in needed):
            raise DosuiPostError(f"{self.path} holds no particles")
        self.times = np.asarray(self._steps["Values"][:n_steps], dtype=np.float64)
        self._count = self._points_per_step(n_steps)
        self._history: Any = self._file.get("History")
        self._n_entries = 0
        if self._history is not None and len(self._history) > 0:
            longest = max(len(self._history[name]) for name in self._history)
            self._n_entries = int(self._history.attrs.get("n_entries", longest))
        self._read_checksums(n_steps)
        group = self._file.get("Scene")
        self.metadata = dict(group.attrs) if group is not None else {}
        self.scene = Scene(_stored_text(group, "text"), _stored_text(group, "echo"))

    def _read_checksums(self, n_steps: int) -> None:
        self._sums: dict[str, npt.NDArray[np.int64]] = {}
        self._history_is_checked = False
        group = self._file.get("Checksums")
        if group is None:
            return
        names = _lines(group, "step_columns")
        table = np.asarray(group["steps"][:n_steps])
        if table.shape != (n_steps, len(names)):
            raise DosuiPostError(f"{self.path} is damaged: its table of checksums is too short")
        self._sums = dict(zip(names, table.T, strict=True))
        offsets = np.asarray(self._steps["PointOffsets"][:n_steps], dtype=np.int64)
        places = [self.times, offsets.view(np.float64), self._count.view(np.float64)]
        self._compare("place", rows_checksums(np.column_stack(places)))
        for name in ("text", "echo"):
            stored = np.asarray(self._file["Scene"][name][()]).tobytes().rstrip(b"\0")
            if text_checksum(stored) != int(group.attrs[f"scene_{name}"]):
                raise DosuiPostError(f"{self.path} is damaged: the scene's checksum does not fit")

    def _compare(self, name: str, found: npt.NDArray[np.int64], first: int = 0) -> None:
        """Compares checksums of steps from `first` on with the file's."""
        if name not in self._sums:
            return
        wrong = np.nonzero(self._sums[name][first : first + len(found)] != found)[0]
        if len(wrong) > 0:
            raise DosuiPostError(
                f"{self.path} is damaged: the checksum of {name} in step {first + wrong[0]}"
                " does not fit"
            )

    def _check_history(self) -> None:
        """Compares the histories with their checksums, once."""
        if self._history_is_checked or "Checksums" not in self._file:
            return
        group = self._file["Checksums"]
        n = self._n_entries
        columns = [self._history[name][:n] for name in _lines(group, "history_columns")]
        if columns:
            found = rows_checksums(np.column_stack(columns))
            wrong = np.nonzero(np.asarray(group["history"][:n]) != found)[0]
            if len(wrong) > 0:
                raise DosuiPostError(
                    f"{self.path} is damaged: the checksum of row {wrong[0]} of the histories"
                    " does not fit"
                )
        self._history_is_checked = True

    def check(self) -> int:
        """Compares everything that the file shows with its checksums.

        Returns how many checksums there are; 0 for a file of a version that had none.
        """
        if not self._sums:
            return 0
        with self._reading():
            self._check_history()
            for step in range(self.n_steps):
                self.points(step)
                for name in self._sums.keys() - {"place", "Points"}:
                    self.field(name, step)
                self._check_vertices(step)
        return len(self._sums) * self.n_steps + self._n_entries

    def _check_vertices(self, step: int) -> None:
        """Points are vertices 0, 1, ..., which has no checksum."""
        vertices = self._root["Vertices"]
        offset, count = int(self._steps["PointOffsets"][step]), int(self._count[step])
        first = offset + step
        numbers = np.arange(count + 1)
        fits = (
            np.array_equal(vertices["Offsets"][first : first + count + 1], numbers)
            and np.array_equal(vertices["Connectivity"][:count], numbers[:count])
            and int(vertices["NumberOfCells"][step]) == count
            and np.array_equal(self._steps["CellOffsets"][step], [offset, 0, 0, 0])
        )
        if not fits:
            raise DosuiPostError(f"{self.path} is damaged: the vertices of step {step} are wrong")

    def _points_per_step(self, n_steps: int) -> npt.NDArray[np.int64]:
        counts = self._root["NumberOfPoints"]
        first = self._steps["PartOffsets"][:n_steps] if "PartOffsets" in self._steps else None
        parts = self._steps["NumberOfParts"][:n_steps] if "NumberOfParts" in self._steps else None
        if first is None or parts is None:
            return np.asarray(counts[:n_steps], dtype=np.int64)
        return np.array(
            [np.sum(counts[i : i + n]) for i, n in zip(first, parts, strict=True)], dtype=np.int64
        )

    def _index(self, step: int) -> int:
        if not -self.n_steps <= step < self.n_steps:
            raise DosuiPostError(
                f"{self.path} has no step {step} (there are {self.n_steps}, counted from 0)"
            )
        return step % self.n_steps

    def _field(self, name: str) -> Any:
        if not self.has_field(name):
            known = ", ".join(self.field_names())
            raise DosuiPostError(f"{self.path} has no field '{name}' (it has: {known})")
        return self._root["PointData"][name]

    def _rows(self, data: Any, name: str, offset: int, step: int) -> FloatArray:
        count = int(self._count[self._index(step)])
        try:
            stored = np.asarray(data[offset : offset + count])
        except OSError as error:
            raise DosuiPostError(f"{self.path} cannot be read: {error}") from error
        if name in self._sums:
            self._compare(name, np.array([checksum(stored)]), self._index(step))
        rows = stored.astype(np.float64)
        if len(rows) != count:
            raise DosuiPostError(f"{self.path} is damaged: step {step} lacks rows of {data.name}")
        return rows

    def _points_move(self) -> bool:
        last = self.n_steps - 1
        if last > 0 and self._count[0] == self._count[last]:
            return not np.array_equal(self.points(0), self.points(last))
        return self.scene.with_key("deformation").text("deformation", "") == "updated"


def to_xyz(values: list[float]) -> FloatArray:
    """A vector of a scene, (z), (x, z) or (x, y, z), as (x, y, z)."""
    if not 1 <= len(values) <= 3:
        raise DosuiPostError(f"a vector of the scene has {len(values)} components")
    full = np.zeros(3)
    full[2] = values[-1]
    full[: len(values) - 1] = values[:-1]
    return full


def _open(path: Path) -> Any:
    if path.is_dir():
        raise DosuiPostError(f"{path} is a folder, not a result file")
    if not path.exists():
        raise DosuiPostError(f"{path} does not exist")
    try:
        return h5py.File(path, "r")
    except OSError as error:
        if "lock" in str(error).lower():
            # A run may still be writing; its completed steps can be read all the same.
            try:
                return h5py.File(path, "r", locking=False)
            except OSError as second:
                error = second
        raise DosuiPostError(f"{path} cannot be read as HDF5: {error}") from error


def _unit(data: Any) -> str:
    unit = _text(data.attrs.get("unit", ""))
    return "" if unit == "-" else unit


def _lines(group: Any, name: str) -> list[str]:
    return _text(group[name][()]).split("\n")[:-1]


def _stored_text(group: Any, name: str) -> str:
    """A text kept as dataset or as attribute; '' if there is none."""
    if group is None:
        return ""
    if name in group:
        return _text(group[name][()])
    return _text(group.attrs.get(name, ""))


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray):
        value = value.tobytes() if value.dtype.kind in "Su" else "".join(map(str, value.ravel()))
    if isinstance(value, bytes):
        value = value.decode("utf-8", errors="replace")
    return str(value).rstrip("\0 ")
