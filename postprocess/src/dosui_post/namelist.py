"""A reader of Fortran namelists, enough for the scenes that dosui stores in its results."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

from dosui_post.errors import DosuiPostError

Value: TypeAlias = bool | int | float | str

_TOKEN = re.compile(
    r"""
      (?P<space>[\s,]+)
    | (?P<comment>![^\n]*)
    | (?P<string>'(?:[^']|'')*'|"(?:[^"]|"")*")
    | (?P<group>&\s*\w+)
    | (?P<end>/)
    | (?P<key>[A-Za-z_][\w%]*\s*(?:\([^)]*\)\s*)?=)
    | (?P<repeat>\d+\*)
    | (?P<word>[^\s,'"!/=]+)
    """,
    re.VERBOSE,
)
_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([edq][+-]?\d+)?|[+-]?(inf(inity)?|nan)", re.IGNORECASE)


@dataclass
class Group:
    """One `&name … /`: keys in lower case, each with the list of its values."""

    name: str
    values: dict[str, list[Value]] = field(default_factory=dict)

    def __contains__(self, key: str) -> bool:
        return bool(self.values.get(key))

    def number(self, key: str) -> float:
        """The first value of a key as a number."""
        value = self._first(key)
        if isinstance(value, str | bool):
            raise DosuiPostError(f"&{self.name} {key} = {value!r} is not a number")
        return float(value)

    def numbers(self, key: str) -> list[float]:
        """All values of a key as numbers."""
        self._first(key)
        if any(isinstance(value, str | bool) for value in self.values[key]):
            raise DosuiPostError(f"&{self.name} {key} is not a list of numbers")
        return [float(value) for value in self.values[key]]

    def text(self, key: str, default: str | None = None) -> str:
        """The first value of a key as text without trailing blanks."""
        if default is not None and key not in self:
            return default
        return str(self._first(key)).rstrip()

    def flag(self, key: str, default: bool) -> bool:
        """The first value of a key as a logical."""
        if key not in self:
            return default
        value = self._first(key)
        if not isinstance(value, bool):
            raise DosuiPostError(f"&{self.name} {key} = {value!r} is not a logical")
        return value

    def _first(self, key: str) -> Value:
        if key not in self:
            raise DosuiPostError(f"the scene in the result has no value of {key} in &{self.name}")
        return self.values[key][0]


def parse(text: str) -> list[Group]:
    """Groups of a namelist text in their order; groups of one name may come several times.

    An index, as in `time(2) = 1.0`, says where the first value goes (NaN before it); sections
    (`vertices(:, 1)`) append. Text outside of the groups is skipped, as Fortran does.
    """
    groups: list[Group] = []
    group: Group | None = None
    values: list[Value] = []
    position, repeat = 0, 1
    for kind, token in _tokens(text):
        if kind == "group":
            group = Group(token[1:].strip().lower())
            groups.append(group)
            values = []
        elif group is None:
            continue
        elif kind == "end":
            group = None
        elif kind == "key":
            key, index = _split_key(token)
            values = group.values.setdefault(key, [])
            position = index if index is not None else len(values)
            repeat = 1
        elif kind == "repeat":
            repeat = int(token[:-1])
        else:
            value = _unquote(token) if kind == "string" else _convert(token)
            values.extend([math.nan] * (position - len(values)))
            values[position : position + repeat] = [value] * repeat
            position, repeat = position + repeat, 1
    return groups


def pieces(text: str) -> Iterator[tuple[str, str]]:
    """All of a text in pieces, each with its kind: together they are the text again."""
    position = 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            yield "other", text[position]
            position += 1
            continue
        position = match.end()
        yield str(match.lastgroup), match.group()


def _tokens(text: str) -> Iterator[tuple[str, str]]:
    for kind, token in pieces(text):
        if kind not in ("space", "comment", "other"):
            yield kind, token


def _split_key(token: str) -> tuple[str, int | None]:
    match = re.match(r"([\w%]+)\s*(?:\(\s*(\d+)?[^)]*\))?", token)
    assert match is not None
    name, index = match.group(1).lower(), match.group(2)
    if index is None or "," in token:
        return name, None
    return name, int(index) - 1


def _unquote(token: str) -> str:
    quote = token[0]
    return token[1:-1].replace(quote + quote, quote)


def _convert(word: str) -> Value:
    if re.fullmatch(r"[+-]?\d+", word):
        return int(word)
    if _REAL.fullmatch(word):
        return float(re.sub("[dDqQ]", "e", word) if word[-1].isdigit() else word)
    logical = re.fullmatch(r"\.?([tf])\w*\.?", word, re.IGNORECASE)
    if logical:
        return logical.group(1).lower() == "t"
    return word
