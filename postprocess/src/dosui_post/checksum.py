"""Checksums of result files and checkpoints, as src/parallel/dosui_checksum.f90 defines them.

Every 8-byte word is added (exclusive or) to a state, which then makes a step of an xorshift
generator. The step is linear over bits, so many parts are summed side by side and put together.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

Words = npt.NDArray[np.uint64]

ALL_BITS = 2**64 - 1
SALT = 7640891576956012809
MARK = b"dosuiEND"
SEAL_BYTES = 32
LANE = 256  # words of a part
FEW = 512  # words that are summed one by one
BLOCK = 2**20  # words that are held at once


def checksum(words: npt.NDArray[np.generic]) -> int:
    """Checksum of 8-byte numbers in C order, as a signed integer like the file's."""
    flat = np.ascontiguousarray(words).reshape(-1).view(np.uint64)
    return _value(_state(flat), len(flat))


def rows_checksums(table: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """One checksum for each row of a table (n, columns)."""
    words = np.ascontiguousarray(table).view(np.uint64)
    state = np.zeros(len(words), dtype=np.uint64)
    for column in range(words.shape[1]):
        state = _step(state ^ words[:, column])
    state = _step(_step(state ^ np.uint64(words.shape[1])) ^ np.uint64(SALT))
    return state.view(np.int64)


def text_checksum(text: bytes) -> int:
    """Checksum of a text: its length, then its bytes with zeros up to a full word."""
    return checksum(_text_words(text))


def seal_problem(path: Path) -> str:
    """What is wrong with a file that ends with a seal (a checkpoint); '' if nothing is."""
    size = path.stat().st_size - SEAL_BYTES
    with path.open("rb") as file:
        file.seek(max(size, 0))
        seal = file.read(SEAL_BYTES)
        words = np.frombuffer(seal, dtype=np.int64) if len(seal) == SEAL_BYTES else None
        if words is None or seal[:8] != MARK or words[1] != size or words[3] != checksum(words[:3]):
            return "it does not end with a checksum: damaged, cut short, or no checkpoint"
        file.seek(0)
        state, n = 0, size // 8
        for first in range(0, n, BLOCK):
            part = np.frombuffer(file.read(8 * min(BLOCK, n - first)), dtype=np.uint64)
            state = _join(state, _state(part), len(part))
        rest = file.read(size - 8 * n)
    if rest:
        tail = _text_words(rest).view(np.uint64)
        state, n = _join(state, _state(tail), len(tail)), n + len(tail)
    return "" if _value(state, n) == words[2] else "its checksum does not fit"


def _text_words(text: bytes) -> npt.NDArray[np.int64]:
    padded = text + b"\0" * (-len(text) % 8)
    return np.concatenate([[len(text)], np.frombuffer(padded, dtype=np.int64)]).astype(np.int64)


def _value(state: int, n: int) -> int:
    value = _step_of_one(_step_of_one(state ^ n) ^ SALT)
    return value - 2**64 if value >= 2**63 else value


def _step(state: Words) -> Words:
    state = state ^ (state << np.uint64(13))
    state = state ^ (state >> np.uint64(7))
    return state ^ (state << np.uint64(17))


def _step_of_one(state: int) -> int:
    state ^= state << 13 & ALL_BITS
    state ^= state >> 7
    return state ^ (state << 17 & ALL_BITS)


def _state(words: Words) -> int:
    """The state after some words: parts of LANE words side by side, then pairs of parts."""
    if len(words) <= FEW:
        single = 0
        for word in words.tolist():
            single = _step_of_one(single ^ word)
        return single
    lanes = max(1, -(-len(words) // LANE))
    padded = np.zeros(lanes * LANE, dtype=np.uint64)
    padded[len(padded) - len(words) :] = words  # zeros at the start leave the state at 0
    table = np.ascontiguousarray(padded.reshape(lanes, LANE).T)
    state = np.zeros(lanes, dtype=np.uint64)
    for row in table:
        state = _step(state ^ row)
    columns = _power(LANE)
    while len(state) > 1:
        if len(state) % 2:
            state = np.concatenate([np.zeros(1, dtype=np.uint64), state])
        state = _image(columns, state[0::2]) ^ state[1::2]
        columns = _image(columns, columns)
    return int(state[0])


def _join(first: int, second: int, n: int) -> int:
    """The state after two parts, the second of n words."""
    return int(_image(_power(n), np.array([first], dtype=np.uint64))[0]) ^ second


def _power(n: int) -> Words:
    """The step made n times: images of the single bits."""
    square = _step(np.uint64(1) << np.arange(64, dtype=np.uint64))
    power = np.uint64(1) << np.arange(64, dtype=np.uint64)
    while n > 0:
        if n % 2:
            power = _image(square, power)
        square = _image(square, square)
        n //= 2
    return power


def _image(columns: Words, words: Words) -> Words:
    """Product of a matrix of bits, given by its columns, with words."""
    result = np.zeros_like(words)
    for bit in range(64):
        result ^= columns[bit] * ((words >> np.uint64(bit)) & np.uint64(1))
    return result
