"""The reader, on files written as the format says, and on broken ones."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from synthetic import Step, common, lattice, terzaghi_file, write_result

from dosui_post.errors import DosuiPostError
from dosui_post.namelist import parse
from dosui_post.result import Result, to_xyz


def two_steps(path: Path, **options: object) -> Path:
    first, second = lattice(0.2, 0.2, 0.1), lattice(0.3, 0.2, 0.1)
    steps = [
        Step(0.0, first, {"pore_pressure": first[:, 2], "velocity": 2 * first}),
        Step(1.5, second, {"pore_pressure": second[:, 0], "velocity": 3 * second}),
    ]
    history = {"time": np.array([0.0, 1.0, 1.5]), "probe": np.array([1.0, 2.0, 3.0])}
    return write_result(path, common(), steps, history, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("room", [0, 5])
def test_steps_fields_and_histories(tmp_path: Path, room: int) -> None:
    with Result(two_steps(tmp_path / "a.vtkhdf", room=room)) as result:
        assert result.n_steps == 2
        assert result.times.tolist() == [0.0, 1.5]
        assert result.points(0).shape == (4, 3)
        assert np.array_equal(result.points(1), lattice(0.3, 0.2, 0.1))
        assert np.array_equal(result.points(-1), result.points(1))
        assert np.array_equal(result.field("pore_pressure", 1), lattice(0.3, 0.2, 0.1)[:, 0])
        assert np.array_equal(result.field("velocity", 1), 3 * lattice(0.3, 0.2, 0.1))
        assert result.field_unit("pore_pressure") == "Pa"
        assert result.history("probe").tolist() == [1.0, 2.0, 3.0]
        assert result.history_unit("time") == "s"
        assert result.step_near(1.4) == 1
        assert result.metadata["git_hash"] == "0123abc"


def test_killed_while_writing_a_step(tmp_path: Path) -> None:
    """More entries in the tables than NSteps says: the step that was not finished."""
    path = two_steps(tmp_path / "a.vtkhdf", room=3)
    with h5py.File(path, "r+") as file:
        file["VTKHDF/Steps"].attrs["NSteps"] = np.int64(1)
        file["History"].attrs["n_entries"] = np.int64(2)
    with Result(path) as result:
        assert result.times.tolist() == [0.0]
        assert len(result.history("probe")) == 2
        with pytest.raises(DosuiPostError, match="no step 1"):
            result.points(1)


def test_a_link_to_the_committed_twin(tmp_path: Path) -> None:
    path = two_steps(tmp_path / "a.vtkhdf")
    with h5py.File(path, "r+") as file:
        file.move("VTKHDF", "Commits/b")
        file["VTKHDF"] = h5py.SoftLink("/Commits/b")
    with Result(path) as result:
        assert result.n_steps == 2


def test_parts_of_a_step_are_joined(tmp_path: Path) -> None:
    path = two_steps(tmp_path / "a.vtkhdf")
    with h5py.File(path, "r+") as file:
        del file["VTKHDF/NumberOfPoints"]
        file["VTKHDF/NumberOfPoints"] = np.array([3, 1, 2, 4])
        file["VTKHDF/Steps/NumberOfParts"][:] = [2, 2]
        file["VTKHDF/Steps/PartOffsets"][:] = [0, 2]
    with Result(path) as result:
        assert [len(result.points(step)) for step in range(2)] == [4, 6]


@pytest.mark.parametrize("as_attributes", [False, True])
def test_scene_from_echo_and_text(tmp_path: Path, as_attributes: bool) -> None:
    text = "&water bulk_modulus = 1.0 /\n&probe name = 'only in the text' /"
    path = two_steps(tmp_path / "a.vtkhdf", text=text, as_attributes=as_attributes)
    with Result(path) as result:
        assert result.scene.one("water").number("bulk_modulus") == 2.2e9
        assert result.scene.one("probe").text("name") == "only in the text"
        assert result.scene.one("material").text("name") == "soil"


def test_reference_points(tmp_path: Path) -> None:
    still = terzaghi_file(tmp_path / "still.vtkhdf")
    moving = terzaghi_file(tmp_path / "moving.vtkhdf", moving=True)
    with Result(still) as a, Result(moving) as b:
        assert np.array_equal(a.reference_points(-1), a.points(-1))
        assert not np.array_equal(b.points(-1), a.points(-1))
        assert np.allclose(b.reference_points(-1), a.points(-1), atol=1e-15)


def test_every_step_is_read_by_vtk(tmp_path: Path) -> None:
    reader_module = pytest.importorskip("vtkmodules.vtkIOHDF")
    numpy_support = pytest.importorskip("vtkmodules.util.numpy_support")
    path = two_steps(tmp_path / "a.vtkhdf")
    reader = reader_module.vtkHDFReader()
    reader.SetFileName(str(path))
    for step in range(2):
        reader.SetStep(step)
        reader.Update()
        data = reader.GetOutputDataObject(0)
        with Result(path) as result:
            points = numpy_support.vtk_to_numpy(data.GetPoints().GetData())
            assert np.array_equal(points, result.points(step))
            pressure = numpy_support.vtk_to_numpy(data.GetPointData().GetArray("pore_pressure"))
            assert np.array_equal(pressure, result.field("pore_pressure", step))
        assert data.GetNumberOfVerts() == len(points)


# ---------------------------------------------------------------------- broken files


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(DosuiPostError, match="does not exist"):
        Result(tmp_path / "nothing.vtkhdf")
    with pytest.raises(DosuiPostError, match="folder"):
        Result(tmp_path)


def test_no_hdf5(tmp_path: Path) -> None:
    path = tmp_path / "a.vtkhdf"
    path.write_text("no hdf5")
    with pytest.raises(DosuiPostError, match="cannot be read as HDF5"):
        Result(path)


def test_truncated_file(tmp_path: Path) -> None:
    path = two_steps(tmp_path / "a.vtkhdf")
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(DosuiPostError):
        Result(path)


def test_other_hdf5_file(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["x"] = 1.0
    with pytest.raises(DosuiPostError, match="no /VTKHDF"):
        Result(path)
    with h5py.File(path, "a") as file:
        file.create_group("VTKHDF")
    with pytest.raises(DosuiPostError, match="not a result file"):
        Result(path)


@pytest.mark.parametrize("name", ["Points", "PointData", "Steps/PointOffsets", "NumberOfPoints"])
def test_lost_dataset(tmp_path: Path, name: str) -> None:
    path = two_steps(tmp_path / "a.vtkhdf")
    with h5py.File(path, "r+") as file:
        del file["VTKHDF"][name]
    with pytest.raises(DosuiPostError, match="not a result file"):
        Result(path)


def test_no_step(tmp_path: Path) -> None:
    path = two_steps(tmp_path / "a.vtkhdf")
    with h5py.File(path, "r+") as file:
        file["VTKHDF/Steps"].attrs["NSteps"] = np.int64(0)
    with pytest.raises(DosuiPostError, match="no completed output step"):
        Result(path)


def test_lost_rows(tmp_path: Path) -> None:
    path = two_steps(tmp_path / "a.vtkhdf")
    with h5py.File(path, "r+") as file:
        del file["VTKHDF/PointData/pore_pressure"]
        file["VTKHDF/PointData/pore_pressure"] = np.zeros(7)
    with Result(path) as result, pytest.raises(DosuiPostError, match="damaged"):
        result.field("pore_pressure", 1)


def test_unknown_names_are_answered_with_the_known(tmp_path: Path) -> None:
    with Result(two_steps(tmp_path / "a.vtkhdf")) as result:
        with pytest.raises(DosuiPostError, match="pore_pressure, velocity"):
            result.field("pressure", 0)
        with pytest.raises(DosuiPostError, match="probe, time"):
            result.history("settlement")


# ---------------------------------------------------------------------- namelists


def test_namelist() -> None:
    groups = parse(
        """ prose before
        &Material  Name='it''s / clay' E = 1.0d6, nu=.25 rigid = .FALSE. wet=T ! rigid = .true.
          n = 2*0.5, -3 /
        &table time(1) = 0.0, 1.0  time(3) = 5
          vertices(:,1) = 0.0, 1.0 vertices(:,2) = 2.0, 3.0 largest = Infinity odd = NaN
          limit(2) = 7.0/
        &material name = "second" /
        &empty /
        """
    )
    assert [group.name for group in groups] == ["material", "table", "material", "empty"]
    clay, table, second, _ = groups
    assert clay.text("name") == "it's / clay"
    assert clay.number("e") == 1e6
    assert clay.number("nu") == 0.25
    assert clay.flag("rigid", True) is False
    assert clay.flag("wet", False) is True
    assert clay.numbers("n") == [0.5, 0.5, -3.0]
    assert table.numbers("time") == [0.0, 1.0, 5.0]
    assert table.numbers("vertices") == [0.0, 1.0, 2.0, 3.0]
    assert table.number("largest") == np.inf
    assert np.isnan(table.number("odd"))
    assert np.array_equal(table.numbers("limit"), [np.nan, 7.0], equal_nan=True)
    assert second.text("name") == "second"


def test_namelist_complaints_name_group_and_key() -> None:
    (group,) = parse("&water bulk_modulus = 'stiff' rigid = 3 /")
    with pytest.raises(DosuiPostError, match="&water bulk_modulus"):
        group.number("bulk_modulus")
    with pytest.raises(DosuiPostError, match="no value of unit_weight in &water"):
        group.number("unit_weight")
    with pytest.raises(DosuiPostError, match="not a logical"):
        group.flag("rigid", False)


def test_vectors_of_each_dimension() -> None:
    assert to_xyz([3.0]).tolist() == [0, 0, 3]
    assert to_xyz([1.0, 3.0]).tolist() == [1, 0, 3]
    assert to_xyz([1.0, 2.0, 3.0]).tolist() == [1, 2, 3]
    with pytest.raises(DosuiPostError, match="components"):
        to_xyz([])
