"""What docs/site does with the source before FORD, and with FORD's pages after it."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs/site"))

from finish_api import finished
from prepare_sources import ROOT, prepared

MODULE = """!! What it is for.
!!
!!     a*b = <c>
module dosui_thing
  private
contains
  subroutine act(x)
    !! Kernel: 2**n of <name> in `a_b` [m].
    real(wp), intent(in) :: x(:, :)   !! (ndim, n) [m_w]
    print *, 'no !! docstring_of_it'
"""


def test_the_head_of_a_module_comes_after_its_first_line() -> None:
    lines = prepared(MODULE).splitlines()
    assert lines[:4] == [
        "module dosui_thing",
        "  !! What it is for.",
        "  !!",
        "  !!     a*b = <c>",
    ]


def test_docstrings_are_no_markdown() -> None:
    text = prepared(MODULE)
    assert r"!! Kernel&#58; 2\*\*n of &lt;name&gt; in `a_b` [m]." in text
    assert r"!! (ndim, n) [m\_w]" in text
    assert "'no !! docstring_of_it'" in text


@pytest.mark.parametrize("path", sorted((ROOT / "src").glob("*/*.f90")), ids=lambda p: p.stem)
def test_the_code_stays_what_it_is(path: Path) -> None:
    def code(text: str) -> list[str]:
        lines = [re.sub(r"\s*!!.*", "", line) for line in text.splitlines()]
        return sorted(line for line in lines if line.strip())

    assert code(prepared(path.read_text())) == code(path.read_text())


HEAD = """<link href="https://cdn.org/bootstrap@5.3.3/css/bootstrap.min.css" rel="stylesheet"
  integrity="sha384-x" crossorigin="anonymous">
<script type="text/x-mathjax-config">MathJax.Hub</script>
<script src="https://cdn.org/mathjax@2.7.9/MathJax.js?config=x" async></script>
<a href="https://example.org/page.html">a link</a>
"""


def test_pages_load_what_lies_beside_them() -> None:
    text = finished(HEAD, "../")
    assert '<link href="../local/bootstrap.min.css" rel="stylesheet">' in text
    assert "mathjax" not in text.lower()
    assert '<a href="https://example.org/page.html">' in text


def test_an_unknown_file_of_a_server_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"new\.js"):
        finished('<script src="https://cdn.org/new.js"></script>', "")
