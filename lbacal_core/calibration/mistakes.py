"""Mistakes that users have made, as changes of P_sky: the data say whether one describes them better.

Where the sky may follow waves along LST that no model has, data with a mistaken input are not improbable by themselves.
They are still far more probable with the input set right. The gain of a mistake is ln of the probability of the data
with P_sky as it would be, over that with P_sky as it is, both with the sky free within what is known of it. Where
nothing is wrong, a gain of g or more has a probability of at most exp(-g).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from lbacal_core.calibration.other_antennas import exchange_antennas
from lbacal_core.curves import CalibrationCurve
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument

LARGEST_GAIN = 10.0
"""Both polarisations together; 24 antennas of clean drawn worlds reach -0.4, exchanged letters 15 and more."""
LIKELY_MISTAKE = "likely mistake"
"""Under this name the notes of a report hold them."""
CLOCK_HOURS = (-2, -1, 1, 2)
OTHER_ANTENNAS = ("hamaker", "short-dipole", "quarter-wave")
"""A dipole over lossy ground, a short one over a conducting plane, and one whose height grows with the wavelength."""
Owner = tuple[str | None, int | None]
"""Station and antenna of a curve."""


@dataclass(frozen=True)
class Mistake:
    """What P_sky would be without a mistake.

    Attributes
    ----------
    name
        What is wrong, in words.
    change
        By dipole, ln of P_sky without the mistake over P_sky, shape (lst, freq), on the grid of the freedom of the sky.
    antenna
        The antenna that it is, where the antenna is wrong. The fit absorbs its level in A(nu), which is free, so that
        only its form along LST shows, and the level is what makes C wrong.
    """

    name: str
    change: Mapping[str, Floats]
    antenna: str | None = None

    def shown(self, dipole: str) -> Floats:
        """What data can show of the change, shape (lst, freq)."""
        change = self.change[dipole]
        return change if self.antenna is None else change - change.mean(axis=0)


def list_mistakes(instrument: Instrument, power: Mapping[str, Floats], lst_hours: Floats) -> list[Mistake]:
    """Letters exchanged, times in another zone, the pattern of another antenna.

    Parameters
    ----------
    power
        P_sky by dipole, shape (lst, freq), on `lst_hours`, a regular grid of the sidereal day.
    """
    mistakes = []
    for one, other in combinations(sorted(power), 2):
        exchanged = {one: other, other: one}
        change = {dipole: np.log(power[exchanged.get(dipole, dipole)] / power[dipole]) for dipole in power}
        mistakes.append(Mistake(f"dipoles {one} and {other} exchanged", change))
    steps = lst_hours.size / 24.0
    for hours in CLOCK_HOURS:
        late = {dipole: np.log(np.roll(one, round(-hours * steps), axis=0) / one) for dipole, one in power.items()}
        mistakes.append(Mistake(f"times {abs(hours)} h too {'late' if hours < 0 else 'early'}", late))
    others = exchange_antennas(instrument, power, lst_hours, {name: name for name in OTHER_ANTENNAS})
    return [*mistakes, *(Mistake(f"the antenna is like {one.name}", one.change, one.name) for one in others)]


def name_mistakes(found: Sequence[tuple[CalibrationCurve, Floats]], mistakes: Sequence[Mistake]) -> dict[Owner, str]:
    """The likely mistake of each antenna, station or array where there is one: its dipoles share it.

    Parameters
    ----------
    found
        Curves with the gain of each mistake, shape (mistake,).
    """
    total: dict[Owner, Floats] = {}
    for curve, gain in found:
        total[curve.owner] = total.get(curve.owner, np.zeros(len(mistakes))) + gain
    return {
        owner: mistakes[int(np.argmax(gain))].name
        for owner, gain in total.items()
        if gain.size and float(np.max(gain)) > LARGEST_GAIN
    }


def describe_mistakes(mistaken: Mapping[Owner, str]) -> str:
    """What may be wrong, the most frequent first, with the first antenna or station that shows it."""
    owners: dict[str, list[Owner]] = {}
    for owner, name in mistaken.items():
        owners.setdefault(name, []).append(owner)
    order = sorted(owners, key=lambda name: (-len(owners[name]), name))
    return "; ".join(f"{name} ({_name(owners[name][0])}{_more(len(owners[name]) - 1)})" for name in order)


def _name(owner: Owner) -> str:
    station, antenna = owner
    return (station or "array") + ("" if antenna is None else f" antenna {antenna}")


def _more(number: int) -> str:
    return f" and {number} more" if number else ""
