"""Steady and periodic seepage: free surfaces, barriers, formulas, rain."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import Run, Runner, scene_text

CONDUCTIVITY = 1.0e-5  # m/s


def column(run: Run, name: str, x: float, step: int = -1) -> dict[str, np.ndarray]:
    """The particles of one vertical lattice line, from below."""
    data = run.fields(name, step)
    rows = np.nonzero(np.abs(data["points"][:, 0] - x) < 1e-6)[0]
    rows = rows[np.argsort(data["points"][rows, 2])]
    return {key: values[rows] for key, values in data.items()}


def level(line: dict[str, np.ndarray]) -> float:
    """Where the pressure of a vertical line becomes zero [m]."""
    z, p = line["points"][:, 2], line["pore_pressure"]
    k = np.nonzero(p > 0)[0][-1]
    return float(z[k] + (z[k + 1] - z[k]) * p[k] / (p[k] - p[k + 1]))


def obstacle_dam(width: float, up: float, down: float, h: float) -> float:
    """Elevation of the free surface where it leaves the dam [m]: Baiocchi's inequality.

    w >= 0 with laplacian(w) = 1 where w > 0, and w = (y_f - y)^2/2 (1 + y_f'^2) below the free
    surface; finite differences, projected over-relaxation.
    """
    nx, ny = round(width / h), round(up / h)
    x, y = np.linspace(0, width, nx + 1), np.linspace(0, up, ny + 1)
    w = np.zeros((nx + 1, ny + 1))
    w[:, 0] = up**2 / 2 - (up**2 - down**2) * x / (2 * width)
    w[0] = (up - y) ** 2 / 2
    w[-1] = np.where(y <= down, (down - y) ** 2 / 2, 0)
    for i in range(1, nx):
        w[i, 1:-1] = (1 - x[i] / width) * w[0, 1:-1] + x[i] / width * w[-1, 1:-1]
    factor = 2 / (1 + np.sin(np.pi / max(nx, ny)))
    i, j = np.meshgrid(np.arange(1, nx), np.arange(1, ny), indexing="ij")
    colours = [(i[(i + j) % 2 == c], j[(i + j) % 2 == c]) for c in (0, 1)]
    for _ in range(5000):
        change = 0.0
        for a, b in colours:
            mean = 0.25 * (w[a - 1, b] + w[a + 1, b] + w[a, b - 1] + w[a, b + 1] - h * h)
            new = np.maximum(0, w[a, b] + factor * (mean - w[a, b]))
            change = max(change, float(np.abs(new - w[a, b]).max()))
            w[a, b] = new
        if change < 1e-10:
            break
    ends = []
    for row in (nx - 1, nx - 2):  # (y_f - y) ~ sqrt(w), and then on to the face
        k = np.nonzero(w[row] > 1e-9)[0][-1]
        s1, s2 = np.sqrt(w[row, k - 1]), np.sqrt(w[row, k - 2])
        ends.append(y[k - 1] + h * s1 / (s2 - s1))
    return 2 * ends[0] - ends[1]


def test_dam_with_a_free_surface(dosui: Runner) -> None:
    """Dupuit's discharge is exact for any free surface between vertical faces."""
    run = dosui(scene_text("dam/scene.nml"))
    assert run.status == 0, run.stderr
    dupuit = CONDUCTIVITY * (24.0**2 - 4.0**2) / (2 * 16.0)
    for x in (0.25, 4.25, 8.25, 12.25):
        line = column(run, "dam", x)
        discharge = 0.5 * float(line["darcy_velocity"][:, 0].sum())
        assert discharge == pytest.approx(dupuit, rel=0.01)
    face = 1.5 * level(column(run, "dam", 15.75)) - 0.5 * level(column(run, "dam", 15.25))
    reference = obstacle_dam(16.0, 24.0, 4.0, 0.125)
    assert reference == pytest.approx(12.8, abs=0.1)
    assert face - 4.0 == pytest.approx(reference - 4.0, rel=0.06)  # coarse: 3 % with half the cell


@pytest.mark.parametrize("ranks", [1, pytest.param(3, marks=pytest.mark.long)])
def test_flow_under_a_sheet_pile(dosui: Runner, ranks: int) -> None:
    """Half the head difference, from the conformal map; errors fall with the spacing."""
    errors = []
    for spacing in ("0.5", "0.25", "0.125"):
        text = scene_text("sheet_pile/scene.nml", spacing=spacing)
        run = dosui(text, ranks=ranks, folder=spacing)
        assert run.status == 0, run.stderr
        time = run.history("sheet_pile", "time")
        inflow = run.history("sheet_pile", "inflow_upstream")
        outflow = run.history("sheet_pile", "inflow_downstream")
        rate = float((inflow[-1] - inflow[-2]) / (time[-1] - time[-2]))
        assert rate == pytest.approx(
            -float((outflow[-1] - outflow[-2]) / (time[-1] - time[-2])), rel=1e-6
        )
        errors.append(abs(rate / (0.5 * CONDUCTIVITY) - 1))
    assert errors[0] < 0.05
    assert errors[1] < 0.025
    assert errors[1] < 0.6 * errors[0]
    assert errors[2] < 0.015


def test_a_barrier_changes_the_answer(dosui: Runner) -> None:
    """Without it the same scene lets much more through."""
    text = scene_text("sheet_pile/scene.nml", spacing="0.5")
    first = text.index("&barrier")
    last = text.index("/", first) + 1
    open_layer = dosui(text[:first] + text[last:], folder="open")
    with_pile = dosui(text, folder="pile")
    rates = []
    for run in (open_layer, with_pile):
        assert run.status == 0, run.stderr
        inflow = run.history("sheet_pile", "inflow_upstream")
        time = run.history("sheet_pile", "time")
        rates.append((inflow[-1] - inflow[-2]) / (time[-1] - time[-2]))
    assert rates[0] > 1.5 * rates[1]


QUICK = """
&scene dimension = 1 integrator = 'quasi_static' gravity = -9.81 /
&grid spacing = 0.1 /
&time end_time = 1.0e4 relative_tolerance = 1.0e-3 /
&material name = 'sand' young_modulus = 2.0e7 poisson_ratio = 0.25
  hydraulic_conductivity = 1.0e-4 /
&region name = 'column' material = 'sand' box_min = 0.0 box_max = 2.0 /
&initial_state pore_pressure = 'hydrostatic' water_level = 2.0
  effective_stress = 'geostatic' surface_level = 2.0 /
&surface name = 'bottom' region = 'column' face = 'z-' /
&surface name = 'top' region = 'column' face = 'z+' /
&mechanical_condition surface = 'bottom' kind = 'roller' /
&hydraulic_condition surface = 'bottom' kind = 'head' value = {head} /
&hydraulic_condition surface = 'top' kind = 'head' value = 2.0 /
&output name = 'quick' /
"""


@pytest.mark.parametrize("share", [0.9, 1.0])
def test_quick_condition(dosui: Runner, share: float) -> None:
    """At the critical gradient i_c = (1 - n) (rho_s - rho_w)/rho_w the stress vanishes."""
    critical = 0.7 * 1650.0 / 1000.0
    run = dosui(QUICK.format(head=2.0 + share * critical * 2.0))
    assert run.status == 0, run.stderr
    data = run.fields("quick")
    order = np.argsort(data["points"][:, 2])
    weight = 0.7 * 1650.0 * 9.81
    # the strain is the same in a whole cell, so the cells' means are what can vanish
    depth = 2.0 - data["points"][order, 2].reshape(-1, 2).mean(axis=1)
    stress = data["effective_stress"][order, 2].reshape(-1, 2).mean(axis=1)
    assert np.abs(stress + (1 - share) * weight * depth).max() <= 1e-6 * weight * 2.0
    rise = data["head"][order][[0, -1]]
    gradient = (rise[0] - rise[1]) / (2.0 - 0.05)
    assert gradient == pytest.approx(share * critical, rel=1e-6)


RAIN = """
&scene dimension = 1 integrator = '{integrator}' gravity = -9.81 /
&grid spacing = 0.05 /
&time end_time = {time} relative_tolerance = 1.0e-3 output_interval = {interval} /
&material name = 'sand' rigid = .true. porosity = 0.4 hydraulic_conductivity = 1.0e-5
  retention = 'van_genuchten' retention_alpha = 2.0 retention_exponent = 2.0 /
&region name = 'column' material = 'sand' box_min = 0.0 box_max = 1.0 /
&initial_state pore_pressure = 'hydrostatic' water_level = 0.0 /
&surface name = 'bottom' region = 'column' face = 'z-' /
&surface name = 'top' region = 'column' face = 'z+' /
&hydraulic_condition surface = 'bottom' kind = 'head' value = 0.0 /
&hydraulic_condition surface = 'top' kind = 'rainfall' value = {rain} /
&output name = 'rain' history_interval = 50.0 /
"""


def test_light_rain_enters_whole(dosui: Runner) -> None:
    """Rain below the conductivity all goes in, and in the end all of it comes out below."""
    run = dosui(RAIN.format(integrator="quasi_static", time=4.0e5, interval=0.0, rain=2.0e-6))
    assert run.status == 0, run.stderr
    time, rain = run.history("rain", "time"), run.history("rain", "inflow_top")
    assert rain[-1] == pytest.approx(2.0e-6 * time[-1], rel=1e-6)
    data = run.fields("rain")
    assert (data["pore_pressure"] < 0).all()
    assert np.allclose(data["darcy_velocity"][:, 2], -2.0e-6, rtol=0.01)


def test_heavy_rain_ponds(dosui: Runner) -> None:
    """Rain above the conductivity ponds: it enters at zero pressure, the rest runs off."""
    run = dosui(RAIN.format(integrator="quasi_static", time=4.0e5, interval=0.0, rain=5.0e-5))
    assert run.status == 0, run.stderr
    time, rain = run.history("rain", "time"), run.history("rain", "inflow_top")
    early = rain[1] / time[1]
    late = (rain[-1] - rain[-2]) / (time[-1] - time[-2])
    assert early == pytest.approx(5.0e-5, rel=1e-3)
    assert late == pytest.approx(1.0e-5, rel=0.01)  # the gradient of the saturated column is 1
    assert run.fields("rain")["pore_pressure"] == pytest.approx(0.0, abs=20.0)


def test_explicit_and_quasi_static_agree_on_rain(dosui: Runner) -> None:
    """Two integrators, one answer while the front moves."""
    pressures = []
    for integrator in ("quasi_static", "explicit"):
        text = RAIN.format(integrator=integrator, time=2.0e3, interval=1.0e3, rain=8.0e-6)
        if integrator == "explicit":
            text += "&water bulk_modulus = 1.0e5 /\n"
        else:
            text = text.replace("1.0e-3", "1.0e-4") + "&water bulk_modulus = 1.0e5 /\n"
        run = dosui(text, folder=integrator)
        assert run.status == 0, run.stderr
        pressures.append(run.fields("rain")["pore_pressure"])
    assert pressures[0] == pytest.approx(pressures[1], abs=0.01 * 9810.0)


class Seabed:
    """Harmonic pressure on a poroelastic layer on rock, by Chebyshev collocation over the depth.

    u_x = U sin(kx), u_z = W cos(kx), p = P cos(kx), all times exp(i w t).
    """

    depth, length, period, load = 2.0, 8.0, 10.0, 1000.0
    young, poisson, porosity, water, conductivity = 2.0e7, 0.3, 0.4, 1.0e9, 1.0e-3

    def __init__(self, n: int = 80) -> None:
        angle = np.pi * np.arange(n + 1) / n
        node = np.cos(angle)
        weight = np.where((np.arange(n + 1) % n) == 0, 2.0, 1.0) * (-1.0) ** np.arange(n + 1)
        gap = node[:, None] - node[None, :] + np.eye(n + 1)
        slope = np.outer(weight, 1 / weight) / gap
        slope -= np.diag(slope.sum(axis=1))
        d = slope * 2 / self.depth
        self.z = self.depth * (node + 1) / 2  # from the rock up
        k, w = 2 * np.pi / self.length, 2 * np.pi / self.period
        g = self.young / (2 * (1 + self.poisson))
        la = 2 * g * self.poisson / (1 - 2 * self.poisson)
        kappa, storage = self.conductivity / 9810.0, self.porosity / self.water
        one, zero, m = np.eye(n + 1), np.zeros((n + 1, n + 1)), n + 1
        bending = d @ d - k * k * one
        a = np.block(
            [
                [g * bending - (la + g) * k * k * one, -(la + g) * k * d, k * one],
                [(la + g) * k * d, g * bending + (la + g) * d @ d, -d],
                [-1j * w * k * one, -1j * w * d, kappa * bending - 1j * w * storage * one],
            ]
        ).astype(complex)
        b = np.zeros(3 * m, complex)
        top, bottom = 0, n
        rows = {
            top: np.hstack([g * d[top], -g * k * one[top], zero[top]]),
            m + top: np.hstack([la * k * one[top], (la + 2 * g) * d[top], zero[top]]),
            2 * m + top: np.hstack([zero[top], zero[top], one[top]]),
            bottom: np.hstack([one[bottom], zero[bottom], zero[bottom]]),
            m + bottom: np.hstack([zero[bottom], one[bottom], zero[bottom]]),
            2 * m + bottom: np.hstack([zero[bottom], zero[bottom], d[bottom]]),
        }
        for row, values in rows.items():
            a[row] = values
        b[2 * m + top] = self.load
        self.pressure = np.linalg.solve(a, b)[2 * m :]

    def at(self, z: np.ndarray) -> np.ndarray:
        """Complex amplitude of the pressure over x = 0 [Pa]."""
        order = np.argsort(self.z)
        return np.interp(z, self.z[order], self.pressure.real[order]) + 1j * np.interp(
            z, self.z[order], self.pressure.imag[order]
        )


WAVE = f"""
&scene dimension = 2 integrator = 'quasi_static' /
&grid spacing = 0.1 /
&time end_time = 30.0 relative_tolerance = 1.0e-3 largest_step = 0.25 output_interval = 0.5 /
&material name = 'bed' young_modulus = {Seabed.young} poisson_ratio = {Seabed.poisson}
  porosity = {Seabed.porosity} hydraulic_conductivity = {Seabed.conductivity} /
&water bulk_modulus = {Seabed.water} /
&region name = 'bed' material = 'bed' box_min = 0.0, 0.0 box_max = 4.0, 2.0 /
&surface name = 'left' region = 'bed' face = 'x-' /
&surface name = 'right' region = 'bed' face = 'x+' /
&surface name = 'rock' region = 'bed' face = 'z-' /
&surface name = 'floor' region = 'bed' face = 'z+' /
&mechanical_condition surface = 'left' kind = 'roller' /
&mechanical_condition surface = 'right' kind = 'roller' /
&mechanical_condition surface = 'rock' kind = 'fixed' /
&mechanical_condition surface = 'floor' kind = 'pressure' value = {Seabed.load}
  formula = 'cos(pi*x/4)*cos(pi*t/5)' /
&hydraulic_condition surface = 'floor' kind = 'pressure' value = {Seabed.load}
  formula = 'cos(pi*x/4)*cos(pi*t/5)' /
&output name = 'wave' /
"""


def test_seabed_under_a_standing_wave(dosui: Runner) -> None:
    """Amplitude and phase of the pressure over the depth (Yamamoto et al. 1978, finite layer)."""
    run = dosui(WAVE, timeout=600)
    assert run.status == 0, run.stderr
    times = run.times("wave")
    last = np.nonzero(times > times[-1] - Seabed.period + 1e-6)[0]
    assert len(last) == 20
    points = run.fields("wave")["points"]
    found = np.zeros(len(points), complex)
    for step in last:
        now = run.fields("wave", int(step))["pore_pressure"]
        found += now * np.exp(-2j * np.pi * times[step] / Seabed.period) / 10
    exact = Seabed().at(points[:, 2]) * np.cos(np.pi * points[:, 0] / 4)
    assert np.abs(found - exact).max() <= 0.01 * Seabed.load
