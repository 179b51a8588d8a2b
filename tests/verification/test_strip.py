"""Consolidation under a strip load against mixed finite elements (Q2 displacements, Q1 pressures).

The reference is assembled here from its weak form, with grids and steps of its own; the surface is
drained beside and below the strip (the case of Schiffman, Chen & Jordan 1969 on a body of finite
size). Its settlement changes by 4e-3 when grid and steps are halved; REFERENCE is the finer one.
"""

from __future__ import annotations

import numpy as np
import pytest
from conftest import Runner
from scipy.sparse import bmat, coo_matrix, csr_matrix
from scipy.sparse.linalg import splu

SIZE, WIDTH, LOAD = 5.0, 1.0, 1000.0  # m (half of the strip), Pa
YOUNG, POROSITY, WATER, CONDUCTIVITY, UNIT_WEIGHT = 1.0e6, 0.3, 2.2e9, 1.0e-7, 9810.0
TIMES = (2.0e4, 1.0e5, 5.0e5, 1.0e7)  # s; the last one is drained

REFERENCE = {  # Elements(20, nu).settlements(8): undrained, then at TIMES [m]
    0.0: (0.76518e-3, 1.19088e-3, 1.56254e-3, 2.06579e-3, 2.59083e-3),
    0.3: (0.99366e-3, 1.30706e-3, 1.54079e-3, 1.86071e-3, 2.17132e-3),
}


def shapes(order: int, x: float) -> tuple[np.ndarray, np.ndarray]:
    """Values and slopes of Lagrange polynomials on 0 to 1."""
    if order == 1:
        return np.array([1 - x, x]), np.array([-1.0, 1.0])
    return (
        np.array([(1 - x) * (1 - 2 * x), 4 * x * (1 - x), x * (2 * x - 1)]),
        np.array([4 * x - 3, 4 - 8 * x, 4 * x - 1]),
    )


class Elements:
    """Stiffness K, coupling B, conductance L and storage S of a square of n x n elements."""

    def __init__(self, n: int, nu: float) -> None:
        self.n, self.h = n, SIZE / n
        lame = YOUNG * nu / ((1 + nu) * (1 - 2 * nu))
        shear = YOUNG / (2 * (1 + nu))
        stiffness = np.array(
            [[lame + 2 * shear, lame, 0], [lame, lame + 2 * shear, 0], [0, 0, shear]]
        )
        k, b = np.zeros((18, 18)), np.zeros((4, 18))
        flow, store = np.zeros((4, 4)), np.zeros((4, 4))
        points, weights = np.polynomial.legendre.leggauss(3)
        for i in range(3):
            for j in range(3):
                area = 0.25 * weights[i] * weights[j] * self.h**2
                x, z = 0.5 + 0.5 * points[i], 0.5 + 0.5 * points[j]
                (nx, dx), (nz, dz) = shapes(2, x), shapes(2, z)
                gx = np.outer(nz, dx).ravel() / self.h
                gz = np.outer(dz, nx).ravel() / self.h
                strain = np.zeros((3, 18))
                strain[0, 0::2] = gx
                strain[1, 1::2] = gz
                strain[2, 0::2], strain[2, 1::2] = gz, gx
                k += area * strain.T @ stiffness @ strain
                (px, ex), (pz, ez) = shapes(1, x), shapes(1, z)
                p = np.outer(pz, px).ravel()
                grad = np.array([np.outer(pz, ex).ravel(), np.outer(ez, px).ravel()]) / self.h
                b += area * np.outer(p, strain[0] + strain[1])
                flow += area * CONDUCTIVITY / UNIT_WEIGHT * grad.T @ grad
                store += area * POROSITY / WATER * np.outer(p, p)
        fine, coarse = 2 * n + 1, n + 1
        place = [(i, j) for j in range(n) for i in range(n)]
        nodes = [
            [(2 * j + b) * fine + 2 * i + a for b in range(3) for a in range(3)] for i, j in place
        ]
        u = np.array([[2 * m + c for m in cell for c in range(2)] for cell in nodes])
        p = np.array(
            [[(j + b) * coarse + i + a for b in range(2) for a in range(2)] for i, j in place]
        )
        self.n_u, self.n_p = 2 * fine**2, coarse**2
        self.stiffness = self._sum(k, u, u, (self.n_u, self.n_u))
        self.coupling = self._sum(b, p, u, (self.n_p, self.n_u))
        self.flow = self._sum(flow, p, p, (self.n_p, self.n_p))
        self.storage = self._sum(store, p, p, (self.n_p, self.n_p))
        side, top = np.arange(fine), 2 * n * fine
        held = [2 * side, 2 * side + 1, 2 * side * fine, 2 * (side * fine + 2 * n)]
        self.free_u = np.setdiff1d(np.arange(self.n_u), np.concatenate(held))
        self.free_p = np.arange(self.n_p - coarse)
        # Simpson's weights along the strip
        line = np.zeros(fine)
        for i in range(round(WIDTH / self.h)):
            line[2 * i : 2 * i + 3] += self.h * np.array([1, 4, 1]) / 6
        self.mean = np.zeros(self.n_u)
        self.mean[2 * (top + side) + 1] = line / WIDTH

    def _sum(
        self, block: np.ndarray, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]
    ) -> csr_matrix:
        row = np.repeat(rows, columns.shape[1], axis=1).ravel()
        column = np.tile(columns, (1, rows.shape[1])).ravel()
        values = np.tile(block.ravel(), len(rows))
        return coo_matrix((values, (row, column)), shape=shape).tocsr()

    def settlements(self, steps: int) -> np.ndarray:
        """Of the strip: undrained, then at TIMES. Backward Euler in even steps of the logarithm,
        extrapolated from two numbers of steps."""
        return 2 * self._euler(2 * steps) - self._euler(steps)

    def _euler(self, steps: int) -> np.ndarray:
        u = self.free_u
        k = self.stiffness[u][:, u]
        force = -LOAD * WIDTH * self.mean[u]
        found = []
        content = np.zeros(self.n_p)
        ends = [0.0]
        for time in TIMES:
            first = max(ends[-1], 1.0e-3 * TIMES[0])
            ends += list(np.geomspace(first, time, steps + 1)[1 if ends[-1] > 0 else 0 :])
        before = 0.0
        for end in [0.0, *ends[1:]]:
            dt = end - before
            p = self.free_p if dt > 0 else np.arange(self.n_p)  # nothing drains at t = 0
            b, c = self.coupling[p][:, u], (self.storage + dt * self.flow)[p][:, p]
            matrix = bmat([[k, -b.T], [b, c]]).tocsc()
            x = splu(matrix, permc_spec="MMD_AT_PLUS_A").solve(np.concatenate([force, content[p]]))
            content = self.coupling[:, u] @ x[: len(u)] + self.storage[:, p] @ x[len(u) :]
            before = end
            if end == 0.0 or any(abs(end - time) < 1e-9 * time for time in TIMES):
                found.append(-self.mean[u] @ x[: len(u)])
        return np.array(found)


def scene(spacing: float, per_cell: int, nu: float, jitter: float) -> str:
    """The same for dosui."""
    times = ", ".join(repr(t) for t in TIMES[:-1])
    return f"""
&scene dimension = 2 integrator = 'quasi_static' /
&grid spacing = {spacing} /
&time end_time = {TIMES[-1]!r} output_times = {times} /
&material name = 'soil' young_modulus = {YOUNG} poisson_ratio = {nu} porosity = {POROSITY}
  hydraulic_conductivity = {CONDUCTIVITY} /
&water bulk_modulus = {WATER} unit_weight = {UNIT_WEIGHT} /
&region name = 'soil' material = 'soil' box_min = 0, 0 box_max = {SIZE}, {SIZE}
  particles_per_cell = {per_cell} jitter = {jitter} /
&surface name = 'base' region = 'soil' face = 'z-' /
&surface name = 'top' region = 'soil' face = 'z+' /
&surface name = 'strip' region = 'soil' face = 'z+' box_min = -1, 0 box_max = {WIDTH}, 6 /
&surface name = 'left' region = 'soil' face = 'x-' /
&surface name = 'right' region = 'soil' face = 'x+' /
&mechanical_condition surface = 'base' kind = 'fixed' /
&mechanical_condition surface = 'left' kind = 'roller' /
&mechanical_condition surface = 'right' kind = 'roller' /
&mechanical_condition surface = 'strip' kind = 'pressure' value = {LOAD} /
&hydraulic_condition surface = 'top' kind = 'head' value = 0 /
&hydraulic_condition surface = 'strip' kind = 'head' value = 0 /
&probe name = 'settlement' kind = 'settlement' surface = 'strip' /
&output name = 'strip' /
"""


@pytest.mark.parametrize("nu", [0.0, 0.3])
def test_the_reference_converges(nu: float) -> None:
    """Half as many elements and steps change it by half a percent."""
    assert Elements(10, nu).settlements(4) == pytest.approx(REFERENCE[nu], rel=5e-3)


@pytest.mark.parametrize("nu", [0.0, 0.3])
@pytest.mark.parametrize(
    ("spacing", "per_cell", "jitter"),
    [(0.2, 2, 0.0), pytest.param(0.1, 1, 0.0, marks=pytest.mark.long), (0.2, 2, 0.25)],
)
def test_settlement_of_a_strip(
    dosui: Runner, spacing: float, per_cell: int, jitter: float, nu: float
) -> None:
    """From the undrained to the drained one, within 1 %."""
    run = dosui(scene(spacing, per_cell, nu, jitter))
    assert run.status == 0, run.stderr
    times, values = run.history("strip", "time"), run.history("strip", "settlement")
    found = np.array([values[0], *np.interp(TIMES, times, values)])
    assert found == pytest.approx(REFERENCE[nu], rel=1e-2)
    for step in range(1, len(TIMES) + 1):
        pressure = run.fields("strip", step)["pore_pressure"] / LOAD
        assert pressure.min() >= -1e-3
        assert pressure.max() <= 1.0
