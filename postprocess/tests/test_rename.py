"""Scenes of earlier versions get the present names, and nothing else changes."""

from __future__ import annotations

from pathlib import Path

import pytest

from dosui_post.cli import main
from dosui_post.errors import DosuiPostError
from dosui_post.rename import rename, renamed

OLD = """! water = 'saturated' in a comment, swelling_index too
&scene
  dimension = 2, Water='Saturated'  ! 'saturated'
  title = 'a saturated clay & its swelling_index = 1 / '
/
water = 'saturated' between groups
&material name = 'saturated' Compression_Index = 0.2, swelling_index=0.04 /
&output name = "saturated" /
"""
NEW = """! water = 'saturated' in a comment, swelling_index too
&scene
  dimension = 2, Water='coupled'  ! 'saturated'
  title = 'a saturated clay & its swelling_index = 1 / '
/
water = 'saturated' between groups
&material name = 'saturated' lambda = 0.2, kappa=0.04 /
&output name = "saturated" /
"""


def test_names_and_choices_change_alone() -> None:
    text, changes = renamed(OLD)
    assert text == NEW
    assert changes == [
        "3: &scene water = 'Saturated' is 'coupled'",
        "7: &material Compression_Index is lambda",
        "7: &material swelling_index is kappa",
    ]
    assert renamed(NEW) == (NEW, [])


def test_files_are_rewritten_in_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "old.nml"
    path.write_bytes(OLD.replace("\n", "\r\n").encode())
    assert main(["rename", str(path)]) == 0
    assert path.read_bytes() == NEW.replace("\n", "\r\n").encode()
    assert f"{path}:7: &material swelling_index is kappa" in capsys.readouterr().out
    before = path.stat().st_mtime_ns
    assert rename(path) == []
    assert path.stat().st_mtime_ns == before


def test_files_that_are_no_text(tmp_path: Path) -> None:
    path = tmp_path / "scene.nml"
    path.write_bytes(b"&scene water = \xff\xfe /")
    with pytest.raises(DosuiPostError, match="no text"):
        rename(path)
