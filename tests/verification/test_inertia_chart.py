"""The chart of the water's inertia (docs/theory/dynamics.md) and the warning on its line."""

from __future__ import annotations

import math

from conftest import Runner
from inertia_chart import WARNED, errors, place
from test_dynamic import DENSITY, FLUID, HEIGHT, MODULUS, UNIT_WEIGHT, harmonic


def test_errors_on_the_line() -> None:
    """On the line of the warning the default is 3 % off, u-p 5.5 %; a fifth of it ten times below;
    without any inertia 3 % are reached for long columns, too."""
    for second in (3e-3, 1e-2, 3e-2, 0.1):
        on_line = DENSITY / FLUID * WARNED / second
        for form, most in (("default", 0.032), ("u-p", 0.056)):
            below, on, beyond = (errors(form, *place(x * on_line, second))[0] for x in (0.1, 1, 3))
            assert below <= 0.2 * most
            assert 0.8 * most <= on <= most
            assert beyond > 2 * most
    slow, fast = (errors("quasi-static", *place(1e-3, second))[0] for second in (0.05, 0.1))
    assert slow <= 0.03 < fast


def test_warning_on_the_line(dosui: Runner) -> None:
    """--check warns beyond k omega/g = 0.03, not before."""
    pulsation = math.pi / HEIGHT * math.sqrt(MODULUS / DENSITY)
    for share, warns in ((0.99, False), (1.01, True)):
        column = harmonic(share * WARNED * UNIT_WEIGHT / FLUID / pulsation)
        run = dosui(column.scene(20, "explicit"), "--check")
        assert run.status == 0, run.stderr
        assert ("k omega/g is 0.03" in run.stderr) == warns, run.stderr
