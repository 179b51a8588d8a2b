"""Finite elements of other programs on the report's problems: mesh, steps, errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dosui_post.exact import Mandel
from dosui_post.report.scenes import Problem
from dosui_post.result import FloatArray
from dosui_post.verify import relative_l2

SIDES = ("base", "right", "top", "left")


def step_ends(problem: Problem, n: int) -> list[float]:
    """Ends of the steps [s]: growing until the first output, then even: errors balance."""
    first, *later = problem.times
    largest = 2.0 * first / n
    ends = [first * (j / n) ** 2 for j in range(1, n + 1)]
    for end in later:
        count = math.ceil((end - ends[-1]) / largest * (1 - 1.0e-9))
        ends += np.linspace(ends[-1], end, count + 1)[1:].tolist()
    return ends


def extent(problem: Problem, spacing: float) -> tuple[float, float]:
    """Width and height [m]: a column is one element wide, which is all that it needs."""
    width, height = problem.size
    return (width if problem.kind == "mandel" else spacing, height)


@dataclass
class Mesh:
    """Quadrilaterals of eight nodes."""

    points: FloatArray
    cells: list[list[int]]

    @classmethod
    def of(cls, problem: Problem, spacing: float) -> Mesh:
        """A regular mesh of the body."""
        nx, nz = (round(size / spacing) for size in extent(problem, spacing))
        number: dict[tuple[int, int], int] = {}
        places = [(i, k) for k in range(2 * nz + 1) for i in range(2 * nx + 1)]
        for place in places:  # corners first: they are the nodes of the pressure
            if place[0] % 2 == 0 and place[1] % 2 == 0:
                number[place] = len(number)
        for place in places:
            if place[0] % 2 + place[1] % 2 == 1:
                number[place] = len(number)
        around = ((0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1))
        cells = [
            [number[2 * i + di, 2 * k + dk] for di, dk in around]
            for k in range(nz)
            for i in range(nx)
        ]
        points = np.array([[0.5 * spacing * i, 0.5 * spacing * k, 0.0] for i, k in number])
        return cls(points, cells)

    def middles(self) -> FloatArray:
        """Centres of the elements (n, 3)."""
        return self.at_middles(self.points)

    def at_middles(self, nodal: FloatArray) -> FloatArray:
        """Mean of the corners: a bilinear field in the centres."""
        corners = np.array(self.cells)[:, :4]
        return np.asarray(nodal[corners].mean(axis=1), dtype=np.float64)

    def side(self, name: str) -> list[int]:
        """Numbers of the nodes on a side, corners and middles."""
        axis, end = {
            "base": (1, "min"),
            "right": (0, "max"),
            "top": (1, "max"),
            "left": (0, "min"),
        }[name]
        values = self.points[:, axis]
        place = values.max() if end == "max" else values.min()
        return [int(k) for k in np.nonzero(np.abs(values - place) < 1.0e-9)[0]]


def rollers(problem: Problem) -> tuple[tuple[str, int], ...]:
    """Sides without normal displacement, and its component."""
    fixed = (("left", 0), ("base", 1))
    return fixed if problem.kind == "mandel" else (*fixed, ("right", 0))


def drained(problem: Problem) -> str:
    """The side without pressure."""
    return "right" if problem.kind == "mandel" else "top"


def plate_motion(problem: Problem, time: float) -> float | None:
    """Exact displacement of Mandel's plate along z [m]; None for a column, which has a load."""
    solution = problem.solution
    if not isinstance(solution, Mandel):
        return None
    return -solution.settlement(problem.size[1], time)


def error_of(problem: Problem, mesh: Mesh, nodal: FloatArray, time: float) -> float:
    """Relative L2 error of the pressure in the centres of the elements."""
    x, z = mesh.middles()[:, 0], mesh.middles()[:, 1]
    place = x if problem.kind == "mandel" else problem.length - z
    exact = problem.solution.pressure(place, time)
    return relative_l2(mesh.at_middles(nodal), exact, np.ones(len(exact)))
