"""How values are written to people, the same in alarms, on pages and by commands: a path, a chance, a share.

Keys that a program reads back are written elsewhere: that of a scope is `lbacal_core.validity.Scope.key`.
"""

from __future__ import annotations

SMALLEST_CHANCE = 1e-300
"""A smaller probability is a rounding error of double precision: it is told as smaller than this one."""


def name_path(station: str | None, antenna: int | None = None, dipole: str | None = None) -> str:
    """Name a path, a station, one of its polarisations, or the array: ``CS002 antenna 17 X``."""
    parts = [station or "array"]
    parts += [] if antenna is None else [f"antenna {antenna}"]
    parts += [dipole] if dipole else []
    return " ".join(parts)


def write_chance(p_value: float) -> str:
    """Write a p-value with what it is: ``p = 3.1e-05``."""
    return f"p < {SMALLEST_CHANCE:.0e}" if p_value < SMALLEST_CHANCE else f"p = {p_value:.1e}"


def write_percent(fraction: float, digits: int = 2) -> str:
    """Write a change with its sign: ``+1.25 %``."""
    return f"{100.0 * fraction:+.{digits}f} %"


def write_change(fraction: float, sigma: float) -> str:
    """Write a change and its error: ``+1.25 ± 0.20 %``."""
    return f"{100.0 * fraction:+.2f} ± {100.0 * sigma:.2f} %"
