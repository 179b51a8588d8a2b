"""Scenes of earlier versions with the present names of keys and choices.

Everything else of a file stays as it is, comments and layout included.
"""

from __future__ import annotations

from pathlib import Path

from dosui_post.errors import DosuiPostError
from dosui_post.namelist import pieces

#: (group, former key): present key
KEYS = {
    ("material", "compression_index"): "lambda",
    ("material", "swelling_index"): "kappa",
}
#: (group, present key, former choice): present choice
CHOICES = {("scene", "water", "saturated"): "coupled"}


def renamed(text: str) -> tuple[str, list[str]]:
    """The text with present names, and what has been changed, a line each."""
    group, key, line = "", "", 1
    written: list[str] = []
    changes: list[str] = []
    for kind, token in pieces(text):
        new = token
        if kind == "group":
            group, key = token[1:].strip().lower(), ""
        elif kind == "end":
            group = ""
        elif group and kind == "key":
            name = token.split("=")[0].split("(")[0].strip()
            key = KEYS.get((group, name.lower()), name.lower())
            if key != name.lower():
                new = token.replace(name, key, 1)
                changes.append(f"{line}: &{group} {name} is {key}")
        elif group and kind == "string":
            choice = CHOICES.get((group, key, token[1:-1].strip().lower()))
            if choice is not None:
                new = token[0] + choice + token[-1]
                changes.append(f"{line}: &{group} {key} = {token} is {new}")
        line += token.count("\n")
        written.append(new)
    return "".join(written), changes


def rename(path: Path) -> list[str]:
    """Rewrites a file, if there is anything to rewrite; returns what has been changed."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            text = file.read()
    except UnicodeDecodeError as error:
        raise DosuiPostError(f"{path} is no text: {error}") from error
    text, changes = renamed(text)
    if changes:
        with path.open("w", encoding="utf-8", newline="") as file:
            file.write(text)
    return [f"{path}:{change}" for change in changes]
