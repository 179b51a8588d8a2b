"""What the site does with the pages of the repository (hooks of MkDocs).

Pages beside docs/ (README, CONTRIBUTING, those of scenes and postprocess) become pages of the site,
links between all of them are turned to their places there, and other files that they link are
copied. Formulas become MathML, so that the site needs no network. A link that leads nowhere is a
warning, which `--strict` makes an error.
"""

from __future__ import annotations

import html
import logging
import os
import re
import unicodedata
from pathlib import Path, PurePosixPath
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.nav import Link, Navigation
from mkdocs.structure.pages import Page

log = logging.getLogger("mkdocs.hooks.dosui")
ROOT = Path(__file__).resolve().parents[2]
SEARCH_SHIM = "assets/javascripts/iframe-worker.js"
LINK = re.compile(r'(?<=\]\()([^()\s#:]+)(?=[#)])|(?<=src=")([^":]+)(?=")')
ROW = "display: flex; align-items: center; gap: 2em; padding: 0.6em 0; overflow: auto hidden"
STYLED = re.compile(r'<(mi|mn) mathvariant="(bold|sans-serif|bold-italic)">(.*?)</\1>')
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.S)


def places() -> dict[str, str]:
    """Place in the site of every file of the repository outside docs/ that belongs to it."""
    found = {
        "README.md": "index.md",
        "CONTRIBUTING.md": "contributing.md",
        "postprocess/README.md": "postprocess.md",
        "input": "scenes/index.md",
        "LICENSE": "LICENSE",
        "CITATION.cff": "CITATION.cff",
    }
    for page in sorted((ROOT / "input").glob("*/README.md")):
        found[page.relative_to(ROOT).as_posix()] = f"scenes/{page.parent.name}.md"
    return found


def groups() -> list[str]:
    """Pages of docs/namelist: first the list, then what it lists, then any others."""
    folder = ROOT / "docs/namelist"
    listed = re.findall(r"\]\((\w+\.md)\)", (folder / "README.md").read_text())
    names = ["README.md", *listed, *sorted(path.name for path in folder.glob("*.md"))]
    return list(dict.fromkeys(names))


def scenes(found: dict[str, str]) -> str:
    """The page that lists the scenes."""
    text = "# Scenes\n\nThe scenes that come with dosui, in the folder `input`.\n\n"
    for origin, place in found.items():
        if place.startswith("scenes/") and origin != "input":
            title = (ROOT / origin).read_text().splitlines()[0].lstrip("# ")
            text += f"- [{title}]({place.removeprefix('scenes/')})\n"
    return text


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Every scene and every group of keys in the navigation, as the pages list them."""
    generated = {
        "Scenes": [place for place in places().values() if place.startswith("scenes/")],
        "Keys": [f"namelist/{name}" for name in groups()],
    }
    for item in config.nav:
        if isinstance(item, dict):
            item.update({title: generated[title] for title in item if title in generated})
    config.extra["polyfills"] = [SEARCH_SHIM]  # in place of one from the network
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    found = places()
    for origin, place in found.items():
        if origin == "input":
            file = File.generated(config, place, content=scenes(found))
        else:
            file = File.generated(config, place, abs_src_path=str(ROOT / origin))
        files.append(file)
    shim = Path(__file__).with_name("iframe-worker.js")
    files.append(File.generated(config, SEARCH_SHIM, abs_src_path=str(shim)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turns links from places in the repository to places in the site."""
    found = places()
    origins = {place: origin for origin, place in found.items()}
    here = page.file.src_uri
    if origins.get(here) == "input":
        return markdown
    origin = PurePosixPath(origins.get(here, f"docs/{here}"))

    def turned(match: re.Match[str]) -> str:
        target = os.path.normpath(origin.parent / match.group(0))
        place = found.get(target)
        if place is None and target.startswith("docs/"):
            place = target.removeprefix("docs/")
        if place is None and (ROOT / target).is_file():  # a source, as it is
            place = f"repository/{target}"
            if files.get_file_from_path(place) is None:
                files.append(File.generated(config, place, abs_src_path=str(ROOT / target)))
        if place is None:
            log.warning("%s links to %s, which is not in the site", origin, match.group(0))
            return match.group(0)
        return os.path.relpath(place, PurePosixPath(here).parent)

    return LINK.sub(turned, markdown)


def on_page_content(text: str, *, page: Page, **_: Any) -> str:
    """Formulas as MathML; the number of a formula stands behind it."""

    def formula(match: re.Match[str]) -> str:
        kind, tex = match.group(1), html.unescape(match.group(2))
        number = re.search(r"\\tag\{(.*?)\}", tex)
        tex = re.sub(r"\\tag\{.*?\}", "", tex)
        try:
            mathml = convert(tex, display="block" if kind == "div" else "inline")
        except Exception as error:
            log.warning("%s: %r in %s", page.file.src_uri, error, tex)
            return match.group(0)
        mathml = STYLED.sub(styled, mathml)
        if "\\" in mathml:
            log.warning("%s: unknown command in %s", page.file.src_uri, tex)
        if kind == "span":
            return f'<span class="formula">{mathml}</span>'
        behind = f"<span>({number.group(1)})</span>" if number else ""
        return f'<div class="formula" style="{ROW}">{mathml}{behind}</div>'

    text = FORMULA.sub(formula, text)
    if "$" in re.sub(r"<(code|math)\b.*?</\1>", "", text, flags=re.S):
        log.warning("%s: a $ that begins no formula", page.file.src_uri)
    return text


def styled(match: re.Match[str]) -> str:
    """A letter of another style as a character of its own: browsers know no other way."""
    kind, style, letter = match.groups()
    name = unicodedata.name(html.unescape(letter), "")
    name = re.sub(r"^(?:LATIN|GREEK) (\w+) LETTER", r"\1", name)
    name = f"MATHEMATICAL {style.replace('-i', ' i').upper()} {name}"
    try:
        letter = unicodedata.lookup(name)
    except KeyError:
        log.warning("there is no character %s", name)
    return f"<{kind}>{letter}</{kind}>"


def on_nav(nav: Navigation, **_: Any) -> Navigation:
    """The pages that FORD writes beside, where docs/build.sh asks for them."""
    if os.environ.get("DOSUI_SITE_API"):
        nav.items.append(Link("Source", "api/index.html"))
    return nav
