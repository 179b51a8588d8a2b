"""The rules of documents.py and docstrings.py find what they are for, and nothing else."""

from __future__ import annotations

from pathlib import Path

import documents
import pytest
from docstrings import missing_units, wrong_choices

MODULE = """module dosui_thing
  implicit none
  private
  public :: flow
  type, public :: thing_t
    real(wp) :: length = 0.0_wp   !! [m]
  contains
    procedure :: pull => thing_pull
  end type thing_t
contains
  pure real(wp) function flow(head, &
                              time)
    !! Water that flows [m3/s].
    real(wp), intent(in) :: head(:)   !! (n) above the base [m]
    real(wp), intent(in) :: time
    !! since the start [s]
  end function flow

  subroutine thing_pull(self, force)
    class(thing_t), intent(inout) :: self
    real(wp), intent(in) :: force     !! tension positive [N, N/m in 2-D]
  end subroutine thing_pull

  subroutine hidden(x)
    real(wp), intent(in) :: x
  end subroutine hidden
end module dosui_thing
"""


def test_a_module_with_all_units_is_clean() -> None:
    assert missing_units(MODULE) == []


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("above the base [m]", "above the base", 14),
        ("above the base [m]", "see [Biot1941]", 14),
        ("above the base [m]", "(x, z): [1, 2]", 14),
        ("since the start [s]", "since the start", 15),
        ("flows [m3/s]", "flows", 11),
        ("[N, N/m in 2-D]", "", 21),
        ("!! [m]\n", "! [m]\n", 6),
    ],
)
def test_a_missing_unit_is_found(old: str, new: str, line: int) -> None:
    assert MODULE.count(old) == 1
    assert [found for found, _ in missing_units(MODULE.replace(old, new))] == [line]


DOCS = "docs"  # names of files that do not exist here are put together


SCENE = """  type, public :: water_t
    character(len=64) :: stepping = 'auto'   !! 'single', 'rkl2' or 'auto'
    character(len=64) :: region = ''         !! named 'so'
  end type water_t
"""
KEYS = """    call v%name(water%stepping, &
                key('stepping', 'how', &
                    choices='auto single '// &
                    'rkl2'))
"""


def test_values_in_comments_are_those_of_keys() -> None:
    assert wrong_choices(SCENE, KEYS) == []
    assert [line for line, _ in wrong_choices(SCENE.replace("'single', ", ""), KEYS)] == [2]
    assert [line for line, _ in wrong_choices(SCENE, KEYS.replace("rkl2", "rkl2 rkc"))] == [2]


def tree(root: Path, **files: str) -> Path:
    """Files by name ('a__b' is b.md in a/) of a clean tree, some of them replaced."""
    given = {
        "docs__refs": "@book{Biot1941,\n}\n",
        "docs__README": "# Pages\n\n## Contents\n\n- [One](one.md)\n"
        "    - [Two parts](one.md#two-parts)\n",
        "docs__one": "# One\n\n## Two parts\n\nA formula [Biot1941], [back](README.md#contents).\n",
        "src__room__dosui_x": f"!! After [Biot1941]; {DOCS}/one.md shows it.\n",
    } | files
    for name, text in given.items():
        ending = "bib" if "refs" in name else "f90" if "src" in name else "md"
        path = root / f"{name.replace('__', '/')}.{ending}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


RULES = {
    "links": documents.check_links,
    "contents": documents.check_contents,
    "references": documents.check_references,
    "widths": documents.check_widths,
}


@pytest.mark.parametrize("rule", RULES)
def test_a_clean_tree_is_clean(tmp_path: Path, rule: str) -> None:
    assert RULES[rule](tree(tmp_path)) == []


ONE = "# One\n\n## Two parts\n\n"


@pytest.mark.parametrize(
    ("rule", "files", "place"),
    [
        ("links", {"docs__one": ONE + "[gone](gone.md)\n"}, "one.md:5"),
        ("links", {"docs__one": ONE + "[gone](README.md#gone)\n"}, "one.md:5"),
        ("links", {"docs__one": ONE + '<img src="gone.png">\n'}, "one.md:5"),
        ("links", {"src__room__dosui_x": f"! {DOCS}/gone.md\n"}, "dosui_x.f90:1"),
        ("contents", {"docs__one": "# One\n\n## Other\n"}, "README.md:3"),
        ("contents", {"docs__one": "# One more\n\n## Two parts\n"}, "README.md:5"),
        ("contents", {"docs__one": ONE + "## Three\n"}, "README.md:3"),
        ("contents", {"docs__two": "# Two\n"}, "README.md:3"),
        ("references", {"docs__one": ONE + "[Biot1955]\n"}, "one.md:5"),
        ("references", {"docs__refs": "@book{Biot1941,\n}\n@book{Biot1955,\n}\n"}, "refs.bib:3"),
        ("references", {"docs__refs": "@book{Biot1941,\n}\n@book{Biot1941,\n}\n"}, "refs.bib:3"),
        ("references", {"src__room__dosui_x": "!! (Biot 1941)\n"}, "dosui_x.f90:1"),
        ("references", {"src__room__dosui_x": "!! Biot et al. (1941)\n"}, "dosui_x.f90:1"),
        ("widths", {"docs__one": ONE + "word " * 30 + "\n"}, "one.md:5"),
        ("widths", {"docs__one": ONE + "| a | " + "word " * 30 + "|\n"}, "one.md:5"),
    ],
)
def test_what_is_wrong_is_found(
    tmp_path: Path, rule: str, files: dict[str, str], place: str
) -> None:
    problems = RULES[rule](tree(tmp_path, **files))
    assert any(f"{place}:" in problem for problem in problems), problems


def test_code_is_no_text(tmp_path: Path) -> None:
    code = "`[x](gone.md)` and\n\n    [y](gone.md) [Biot1955]\n\n```\n[z](gone.md)\n```\n"
    root = tree(tmp_path, docs__one=ONE + "[Biot1941]\n" + code)
    assert documents.check_links(root) == []
    assert documents.check_references(root) == []


@pytest.mark.parametrize(
    ("heading", "name"),
    [
        ("What is exact, and what is not", "what-is-exact-and-what-is-not"),
        ("`&rigid_wall`", "rigid_wall"),
        ("Unit tests (.pf)", "unit-tests-pf"),
    ],
)
def test_anchors_are_those_of_github(heading: str, name: str) -> None:
    assert documents.anchor(heading) == name
