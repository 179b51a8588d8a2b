"""Checksums: the same word by word, from parts side by side, and as Fortran finds them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dosui_post import checksum as module
from dosui_post.checksum import checksum, rows_checksums, seal_problem, text_checksum

MASK = 2**64 - 1


def step(state: int) -> int:
    """Marsaglia's xorshift, written down anew."""
    state ^= (state << 13) & MASK
    state ^= state >> 7
    return state ^ ((state << 17) & MASK)


def slow(words: list[int]) -> int:
    """The definition, word by word."""
    state = 0
    for word in words:
        state = step(state ^ word)
    value = step(step(state ^ len(words)) ^ 7640891576956012809)
    return value - 2**64 if value >= 2**63 else value


@pytest.mark.parametrize("n", [0, 1, 7, 255, 256, 257, 511, 512, 513, 1000, 4097])
def test_parts_side_by_side(n: int) -> None:
    words = np.random.default_rng(n).integers(0, 2**64, n, dtype=np.uint64)
    assert checksum(words) == slow(words.tolist())


def test_rows_and_texts() -> None:
    table = np.random.default_rng(3).normal(size=(9, 4))
    rows = [slow(row.view(np.uint64).tolist()) for row in table]
    assert rows_checksums(table).tolist() == rows
    assert text_checksum(b"abcdefghij") == slow(
        [10, *np.frombuffer(b"abcdefghij\0\0\0\0\0\0", dtype=np.uint64).tolist()]
    )


@pytest.mark.parametrize("size", [0, 8, 13, 5000])
def test_seals(tmp_path: Path, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sealed file, read in several blocks, and the same with a wrong byte anywhere."""
    monkeypatch.setattr(module, "BLOCK", 100)
    body = np.random.default_rng(size).integers(0, 256, size, dtype=np.uint8).tobytes()
    words = np.frombuffer(body[: size // 8 * 8], dtype=np.uint64).tolist()
    rest = body[size // 8 * 8 :]
    if rest:
        words += [len(rest), int.from_bytes(rest.ljust(8, b"\0"), "little")]
    seal = [int.from_bytes(b"dosuiEND", "little"), size, slow(words)]
    seal.append(slow([word & MASK for word in seal]))
    whole = body + b"".join((word & MASK).to_bytes(8, "little") for word in seal)
    path = tmp_path / "file.h5"
    path.write_bytes(whole)
    assert seal_problem(path) == ""
    for place in range(0, len(whole), max(1, len(whole) // 60)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 16]) + whole[place + 1 :])
        assert seal_problem(path) != ""
    path.write_bytes(whole[:-1])
    assert seal_problem(path) != ""
