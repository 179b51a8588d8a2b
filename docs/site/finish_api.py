"""Makes FORD's pages need no network: finish_api.py OUTPUT

Bootstrap and lunr come from the installed MkDocs instead of a server, and MathJax is left out: no
docstring holds a formula for it.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import mkdocs

PACKAGE = Path(mkdocs.__file__).parent
COPIES = {
    "bootstrap.min.css": PACKAGE / "themes/mkdocs/css/bootstrap.min.css",
    "bootstrap.bundle.min.js": PACKAGE / "themes/mkdocs/js/bootstrap.bundle.min.js",
    "lunr.js": PACKAGE / "contrib/search/templates/search/lunr.js",
}
MATHJAX = re.compile(r"<script[^>]*(?:mathjax-config|MathJax\.js)[^>]*>.*?</script>", re.S | re.I)
TAG = re.compile(r"<(?:script|link)\b[^>]*>")
REMOTE = re.compile(r'"https://[^"]*/([^"/]+)"')
CHECKSUM = re.compile(r'\s+(?:integrity|crossorigin)="[^"]*"')


def local(tag: str, to_root: str) -> str:
    """A tag that loads a copy; ValueError if there is none."""
    match = REMOTE.search(tag)
    if not match:
        return tag
    if match.group(1) not in COPIES:
        raise ValueError(f"FORD loads {match.group(0)}, of which there is no copy")
    return CHECKSUM.sub("", tag.replace(match.group(0), f'"{to_root}local/{match.group(1)}"'))


def finished(text: str, to_root: str) -> str:
    """A page that loads only what lies beside it."""
    return TAG.sub(lambda match: local(match.group(0), to_root), MATHJAX.sub("", text))


def main(output: Path) -> None:
    (output / "local").mkdir(exist_ok=True)
    for name, path in COPIES.items():
        shutil.copyfile(path, output / "local" / name)
    for page in output.rglob("*.html"):
        to_root = "../" * (len(page.relative_to(output).parts) - 1)
        page.write_text(finished(page.read_text(), to_root))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
