"""Numbers with units, for people."""

from __future__ import annotations

import math

_PREFIXES = {"Pa": ((1e9, "G"), (1e6, "M"), (1e3, "k")), "N/m³": ((1e3, "k"),)}
_PREFIXES["N/m"] = ((1e6, "M"), (1e3, "k"))
_PREFIXES["N/m²"] = _PREFIXES["Pa"]
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def si(value: float, unit: str) -> str:
    """A value with its unit: 1000000.0, 'Pa' gives '1 MPa'; 1e-5, 'm/s' gives '10⁻⁵ m/s'."""
    factor, scaled_unit = scale(abs(value), unit) if unit in _PREFIXES else (1.0, unit)
    return f"{number(value * factor)} {scaled_unit}"


def number(value: float) -> str:
    """Four digits at most, with a power of ten where it is shorter."""
    if value == 0 or not math.isfinite(value) or 1e-3 < abs(value) < 1e5:
        return f"{value:.4g}".replace("inf", "∞")
    mantissa, exponent = f"{value:.3e}".split("e")
    power = "10" + str(int(exponent)).translate(_SUPERSCRIPT)
    digits = mantissa.rstrip("0").rstrip(".")
    return power if digits == "1" else f"{digits}×{power}"


def scale(magnitude: float, unit: str) -> tuple[float, str]:
    """Factor and unit that make a magnitude handy: 2e6, 'Pa' gives (1e-6, 'MPa')."""
    if not math.isfinite(magnitude) or magnitude == 0:
        return 1.0, unit
    for size, prefix in _PREFIXES.get(unit, ()):
        if magnitude >= 0.9999 * size:
            return 1 / size, prefix + unit
    if unit == "m" and magnitude < 0.05:
        return (1e3, "mm") if magnitude >= 5e-5 else (1e6, "µm")
    return 1.0, unit
