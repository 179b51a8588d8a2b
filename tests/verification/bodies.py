"""Closed triangulated surfaces: (n, 3, 3) arrays of corners, counter-clockwise from outside."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

Faces = dict[str, np.ndarray]


def quads(corners: np.ndarray) -> np.ndarray:
    """Two triangles for each of (n, 4, 3) quadrilaterals."""
    return np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])


def prism(outlines: list[np.ndarray], caps: list[np.ndarray], low: float, high: float) -> Faces:
    """Between two levels of y, above outlines in the x-z plane (holes run the other way round).

    `caps` are quadrilaterals (4, 2) that fill the cross-section; all run like the outline.
    """
    faces = {}
    for number, outline in enumerate(outlines):
        a, b = outline, np.roll(outline, -1, axis=0)
        corners = np.stack(
            [at_level(a, low), at_level(a, high), at_level(b, high), at_level(b, low)], 1
        )
        faces[f"side{number + 1}"] = quads(corners)
    cells = np.array(caps)
    faces["front"] = quads(np.stack([at_level(cells[:, k], low) for k in range(4)], 1))
    faces["back"] = quads(np.stack([at_level(cells[:, k], high) for k in (3, 2, 1, 0)], 1))
    return faces


def at_level(points: np.ndarray, y: float) -> np.ndarray:
    """(n, 2) points of the x-z plane in space."""
    return np.stack([points[:, 0], np.full(len(points), y), points[:, 1]], 1)


def box(low: tuple[float, ...], high: tuple[float, ...]) -> Faces:
    """Six faces, called as those of a box."""
    low, high = np.array(low), np.array(high)
    faces = {}
    for axis, letter in enumerate("xyz"):
        for side, sign in ((0, "-"), (1, "+")):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            corner = np.empty((1, 4, 3))
            corner[0, :, axis] = (low, high)[side][axis]
            order = ((0, 0), (1, 0), (1, 1), (0, 1)) if side else ((0, 0), (0, 1), (1, 1), (1, 0))
            for k, (i, j) in enumerate(order):
                corner[0, k, u] = (low, high)[i][u]
                corner[0, k, v] = (low, high)[j][v]
            faces[f"{letter}{sign}"] = quads(corner)
    return faces


def angle_piece(size: float, depth: float) -> Faces:
    """An L in the x-z plane: a square of `size` without its upper right quarter."""
    half = 0.5 * size
    outline = half * np.array([(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2), (0, 1)])
    cells = [half * square((x, z)) for x, z in ((0, 0), (1, 0), (0, 1))]
    return prism([outline], cells, 0.0, depth)


def tunnel_block(size: float, depth: float) -> Faces:
    """A block with a square tunnel along y of a third of its `size`: genus 1."""
    third = size / 3
    ring = [(0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (3, 2), (3, 3), (2, 3), (1, 3), (0, 3)]
    outer = third * np.array([*ring, (0, 2), (0, 1)])
    inner = third * np.array([(1, 1), (1, 2), (2, 2), (2, 1)])
    places = [(x, z) for x in range(3) for z in range(3) if (x, z) != (1, 1)]
    return prism([outer, inner], [third * square(place) for place in places], 0.0, depth)


def square(corner: tuple[int, int]) -> np.ndarray:
    """Of side 1, counter-clockwise."""
    return np.array(corner) + np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)


def octant(level: int, radius: float = 1.0) -> Faces:
    """The eighth of a ball where x, y, z > 0; faces are called as those of a cut sphere."""
    x = np.eye(3)[None]
    for _ in range(level):
        a, b, c = x[:, 0], x[:, 1], x[:, 2]
        ab, bc, ca = unit(a + b), unit(b + c), unit(c + a)
        x = np.concatenate(
            [np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    faces = {"round": radius * x}
    for axis, letter in enumerate("xyz"):
        fans = []
        for k in range(3):
            a, b = x[:, k], x[:, (k + 1) % 3]
            lies = (a[:, axis] < 1e-12) & (b[:, axis] < 1e-12)
            fans.append(np.stack([0 * a[lies], b[lies], a[lies]], 1))
        faces[letter + "-"] = radius * np.concatenate(fans)
    return faces


def unit(x: np.ndarray) -> np.ndarray:
    """Vectors of length 1."""
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def grid(f, nu: int, nv: int) -> np.ndarray:
    """Triangles of a surface f(u, v), u and v from 0 to 1."""
    u, v = np.meshgrid(np.linspace(0, 1, nu + 1), np.linspace(0, 1, nv + 1), indexing="ij")
    p = np.stack(f(u, v), axis=-1)
    corners = np.stack([p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]], axis=2)
    return quads(corners.reshape(-1, 4, 3))


def torus(major: float, minor: float, nu: int, nv: int) -> Faces:
    """About the z axis."""

    def f(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
        a, b = 2 * np.pi * (u % 1.0), 2 * np.pi * (v % 1.0)
        r = major + minor * np.cos(b)
        return r * np.cos(a), r * np.sin(a), minor * np.sin(b)

    return {"torus": grid(f, nu, nv)}


def bend(inner: float, outer: float, depth: float, n: int, m: int) -> Faces:
    """A quarter of a ring about the y axis: n steps of angle, m over the depth along y.

    `inlet` lies in the plane z = 0, `outlet` in x = 0.
    """

    def shell(radius: float):
        return lambda u, v: (
            radius * np.cos(u * np.pi / 2),
            depth * v,
            radius * np.sin(u * np.pi / 2),
        )

    def plate(y: float):
        return lambda u, v: (
            (inner + (outer - inner) * v) * np.cos(u * np.pi / 2),
            y + 0 * u,
            (inner + (outer - inner) * v) * np.sin(u * np.pi / 2),
        )

    def end(angle: float):
        return lambda u, v: (
            (inner + (outer - inner) * u) * np.cos(angle),
            depth * v,
            (inner + (outer - inner) * u) * np.sin(angle),
        )

    return {
        "outer": flipped(grid(shell(outer), n, m)),
        "inner": grid(shell(inner), n, m),
        "front": flipped(grid(plate(0.0), n, 1)),
        "back": grid(plate(depth), n, 1),
        "inlet": flipped(grid(end(0.0), 1, m)),
        "outlet": grid(end(np.pi / 2), 1, m),
    }


def flipped(x: np.ndarray) -> np.ndarray:
    """The same triangles, seen from the other side."""
    return x[:, ::-1]


def turned(faces: Faces, axis: tuple[float, ...], angle: float) -> Faces:
    """Turned about an axis through the origin, angle in degrees."""
    k = unit(np.array(axis, dtype=float))
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    rotation = c * np.eye(3) + s * cross + (1 - c) * np.outer(k, k)
    return {name: x @ rotation.T for name, x in faces.items()}


def volume(faces: Faces) -> float:
    """Signed volume."""
    return float(sum(np.linalg.det(x).sum() for x in faces.values()) / 6)


def centroid(faces: Faces) -> np.ndarray:
    """Of the solid."""
    x = np.concatenate(list(faces.values()))
    parts = np.linalg.det(x) / 6
    return (parts[:, None] * x.sum(axis=1) / 4).sum(axis=0) / parts.sum()


def write_text(path: Path, faces: Faces, scale: float = 1.0) -> None:
    """A text STL file with one solid for each face."""
    lines = []
    for name, triangles in faces.items():
        lines.append(f"solid {name}")
        for triangle in scale * triangles:
            lines += ["facet normal 0 0 0", "  outer loop"]
            lines += ["    vertex " + " ".join(repr(float(c)) for c in p) for p in triangle]
            lines += ["  endloop", "endfacet"]
        lines.append(f"endsolid {name}")
    path.write_text("\n".join(lines) + "\n")


def write_binary(path: Path, faces: Faces, scale: float = 1.0) -> None:
    """A binary STL file."""
    triangles = scale * np.concatenate(list(faces.values()))
    record = np.zeros(len(triangles), dtype=[("f", "<f4", 12), ("spare", "<u2")])
    record["f"][:, 3:] = triangles.reshape(-1, 9)
    head = b"made by a test".ljust(80) + struct.pack("<I", len(triangles))
    path.write_bytes(head + record.tobytes())
