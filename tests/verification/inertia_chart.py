"""The chart of docs/theory/dynamics.md: where columns under harmonic loads need which equations.

A saturated column, fixed and closed at z = 0, loaded by q exp(i w t) and drained at z = H. In the
modes u = a sin(k z), v = b sin(k z) of the skeleton's displacement and the water's against it, and
p = -(k/S)(a + b) cos(k z), Biot's equations (1956) are

    -w^2 (rho a + rho_w b) = -(M + 1/S) k^2 a - k^2/S b - (2/H) (-1)^n q
    -w^2 rho_w a - w^2 rho_w/n b = -k^2/S (a + b) - i w (gamma_w/K) b

The forms leave out what KEPT says. `python inertia_chart.py ../../docs/images/inertia.png`
"""

from __future__ import annotations

import sys

import numpy as np
from test_dynamic import DENSITY, FLUID, HEIGHT, LOAD, MODULUS, POROSITY, STORAGE, UNIT_WEIGHT

# of the inertia: total, of the water at the skeleton's acceleration, at its own against it
KEPT = {
    "Biot": (1.0, 1.0, 1.0),
    "u-p": (1.0, 1.0, 0.0),  # fluid_inertia
    "default": (1.0, 0.0, 0.0),
    "quasi-static": (0.0, 0.0, 0.0),
}
SPEED = float(np.sqrt((MODULUS + 1.0 / STORAGE) / DENSITY))  # V_c, undrained [m/s]
WARNED = 0.03  # k omega/g beyond which --check warns [-]


def amplitudes(form: str, conductivity: float, omega: float, modes: int = 200) -> np.ndarray:
    """Complex ones of displacement and pressure in the modes: (2, mode)."""
    total, shared, own = KEPT[form]
    k = np.pi * (np.arange(modes) + 0.5) / HEIGHT
    stiffness = k**2 / STORAGE
    matrix = np.empty((modes, 2, 2), dtype=complex)
    matrix[:, 0, 0] = MODULUS * k**2 + stiffness - total * omega**2 * DENSITY
    matrix[:, 0, 1] = stiffness - own * omega**2 * FLUID
    matrix[:, 1, 0] = stiffness - shared * omega**2 * FLUID
    matrix[:, 1, 1] = stiffness - own * omega**2 * FLUID / POROSITY
    matrix[:, 1, 1] += 1j * omega * UNIT_WEIGHT / conductivity
    push = -(2 / HEIGHT) * (-1.0) ** np.arange(modes) * LOAD
    determinant = matrix[:, 0, 0] * matrix[:, 1, 1] - matrix[:, 0, 1] * matrix[:, 1, 0]
    a = push * matrix[:, 1, 1] / determinant
    b = -push * matrix[:, 1, 0] / determinant
    return np.array([a, -k / STORAGE * (a + b)])


def errors(form: str, conductivity: float, omega: float) -> np.ndarray:
    """Of displacement and pressure against Biot's equations, over their norms [-]."""
    exact = amplitudes("Biot", conductivity, omega)
    wrong = amplitudes(form, conductivity, omega) - exact
    return np.linalg.norm(wrong, axis=1) / np.linalg.norm(exact, axis=1)


def place(first: float, second: float) -> tuple[float, float]:
    """Conductivity [m/s] and pulsation [1/s] of Pi_1 = k V_c^2/(g (rho_w/rho) omega L^2) and
    Pi_2 = omega^2 L^2/V_c^2."""
    omega = np.sqrt(second) * SPEED / HEIGHT
    gravity = UNIT_WEIGHT / FLUID
    return first * gravity * FLUID / DENSITY * omega * HEIGHT**2 / SPEED**2, omega


def draw(path: str) -> None:
    """Lines of 3 % of the displacement."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    first, second = np.logspace(-3, 3, 81), np.logspace(-4, 2, 81)
    figure, axes = plt.subplots(figsize=(6.4, 5.2))
    for form, colour in (("quasi-static", "C0"), ("u-p", "C1"), ("default", "C2")):
        found = [[errors(form, *place(x, y))[0] for x in first] for y in second]
        lines = axes.contour(first, second, found, [0.03], colors=colour)
        axes.plot([], [], color=colour, label=f"{form}: 3 % off in displacements")
        assert len(lines.allsegs[0]) > 0
    axes.plot(first, DENSITY / FLUID * WARNED / first, "k--", label="dosui warns: kω/g = 0.03")
    axes.set(xscale="log", yscale="log", xlim=(1e-3, 1e3), ylim=(1e-4, 1e2))
    axes.set(xlabel=r"$\Pi_1 = k V_c^2/(g\,(\rho_w/\rho)\,\omega L^2)$")
    axes.set(ylabel=r"$\Pi_2 = \omega^2 L^2/V_c^2$")
    for x, y, text in (
        (2e-3, 6e-3, "slow: quasi_static will do"),
        (1.5e-3, 0.3, "dynamic: explicit,\nsemi_implicit"),
        (5.0, 3.0, "fast: Biot's full equations\n(not in dosui)"),
    ):
        axes.text(x, y, text)
    axes.legend(loc="upper right", fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    draw(sys.argv[1])
