"""The pages of the manual against the code."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from conftest import BIN, ROOT


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_namelist_pages_are_those_of_the_code(tmp_path: Path, dimension: int) -> None:
    program = str(BIN / f"dosui{dimension}d")
    subprocess.run([program, "--docs", str(tmp_path)], check=True, timeout=60)
    written = {path.name: path.read_text() for path in tmp_path.iterdir()}
    committed = {path.name: path.read_text() for path in (ROOT / "docs/namelist").iterdir()}
    assert sorted(written) == sorted(committed)
    for name, text in written.items():
        assert text == committed[name], f"{name}: run dosui --docs docs/namelist"
