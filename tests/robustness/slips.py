"""What happens to files: slips of the hand in texts, flipped bits and cut ends in any file."""

from __future__ import annotations

import re
from random import Random

ODD_VALUES = (
    "0", "-1", "1e300", "-1e300", "1e-300", "nan", "inf", "1e999", "2*3", "1.5e", "1,5", "''",
    "'x'", ".true.", "1 2 3 4 5 6 7 8 9", "1e16", "2147483648", "-0.0", "1/2", "0x10", "é", "$",
)  # fmt: skip
ODD_TEXTS = (
    "'",
    '"',
    "/",
    "&",
    "!",
    "=",
    ",",
    "&scene",
    "/ &",
    "\t",
    "\x00",
    "\ufeff",
    "\r\n",
    "#",
)


def spoiled_text(text: str, random: Random) -> tuple[str, str]:
    """A text with one to three slips, and what they were."""
    kinds = []
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        kind = random.choice(
            ("value", "value", "value", "key", "line lost", "line twice", "swap", "insert", "cut",
             "lists")
        )  # fmt: skip
        text = _spoil(text, kind, random)
        kinds.append(kind)
    return text, " + ".join(sorted(set(kinds)))


def spoiled_bytes(data: bytes, random: Random) -> tuple[bytes, str]:
    """Bytes with damage of one kind, and which."""
    kind = random.choice(("flip", "flip", "burst", "zeros", "cut", "twice", "noise"))
    if not data:
        return b"\xff", kind
    spoiled = bytearray(data)
    place = random.randrange(len(data))
    length = random.choice((1, 8, 64, 512))
    if kind == "flip":
        spoiled[place] ^= 1 << random.randrange(8)
    elif kind == "burst":
        for k in range(place, min(place + length, len(data))):
            spoiled[k] = random.randrange(256)
    elif kind == "zeros":
        spoiled[place : place + length] = bytes(len(spoiled[place : place + length]))
    elif kind == "cut":
        del spoiled[place:]
    elif kind == "twice":
        spoiled[place:place] = spoiled[place : place + length]
    else:
        for _ in range(random.choice((8, 100))):
            spoiled[random.randrange(len(data))] = random.randrange(256)
    return bytes(spoiled), kind


def _spoil(text: str, kind: str, random: Random) -> str:
    lines = text.splitlines(keepends=True) or [""]
    k = random.randrange(len(lines))
    if kind == "value":
        places = list(re.finditer(r"=\s*([^=/!\n]+?)(?=\s+\w+\s*=|\s*/|\s*\n|\s*$)", text))
        if not places:
            return text
        start, end = random.choice(places).span(1)
        return text[:start] + random.choice(ODD_VALUES) + text[end:]
    if kind == "key":
        places = list(re.finditer(r"\b[a-z_]{3,}\b", text))
        if not places:
            return text
        start, end = random.choice(places).span()
        word = text[start:end]
        cut = random.randrange(len(word))
        return (
            text[:start] + word[:cut] + random.choice(("", "x", "_")) + word[cut + 1 :] + text[end:]
        )
    if kind == "line lost":
        del lines[k]
    elif kind == "line twice":
        lines.insert(k, lines[k])
    elif kind == "swap":
        other = random.randrange(len(lines))
        lines[k], lines[other] = lines[other], lines[k]
    elif kind == "insert":
        place = random.randrange(len(text) + 1)
        return text[:place] + random.choice(ODD_TEXTS) + text[place:]
    elif kind == "cut":
        return text[: random.randrange(len(text) + 1)]
    else:
        numbers = ", ".join(random.choice(ODD_VALUES[:6]) for _ in range(random.choice((2, 40))))
        lines.insert(k, f"output_times = {numbers}\n")
    return "".join(lines)
