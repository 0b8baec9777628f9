"""What nature may be other than the simulation takes it to be: one standard deviation of each thing that may be wrong.

Other models of sky and antenna, smooth departures of level and shape, other antennas, mistakes of users; and for the
error of C the terms of sky, pattern and ground.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from threadpoolctl import threadpool_limits

from lbacal_core.antenna.ideal import QuarterWaveDipole, ShortDipole
from lbacal_core.antenna.model import AntennaModel
from lbacal_core.antenna.names import load_antenna
from lbacal_core.data.constants import SPEED_OF_LIGHT
from lbacal_core.data.tables import read_prior
from lbacal_core.errors import BadInputError, require_name
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import hash_content
from lbacal_core.sky.antenna_of import antenna_of
from lbacal_core.sky.differences import LST_HOURS, ZENITH_GAIN, DifferenceModels, compute_model_differences, waves_at
from lbacal_core.sky.power import compute_sky_power, vary_sky_power
from lbacal_core.sky.sky_terms import PAPER, SKY_BUDGETS, SkyTerm, sky_terms

# What P_sky would be with other antennas than the one that an instrument names.
#
# What they change most is the level of P_sky, by a factor of 2 and more where a dipole stands half a wavelength above
# the ground. The fit absorbs a level in A(nu), which is free, so that C is wrong by its root where the antenna is
# another.

PHASES = np.linspace(1.0, 3.0, 11)
"""Heights of short dipoles, k h at the highest channel: 0.6 to 1.8 m at 80 MHz. At pi the zenith is dark."""
SAME = 0.01
"""An antenna that changes P_sky by less, r.m.s., is the same."""


@dataclass(frozen=True)
class OtherAntenna:
    """Another antenna.

    Attributes
    ----------
    change
        By dipole, ln of P_sky with it over P_sky, shape (lst, freq), on a regular grid of the sidereal day from 0 h.
    share
        Its probability among the others before the data are asked: kinds are alike, and so are heights of one kind.
    """

    name: str
    change: Mapping[str, Floats]
    share: float = 1.0


def exchange_antennas(
    instrument: Instrument, power: Mapping[str, Floats], lst_hours: Floats, antennas: Mapping[str, str | AntennaModel]
) -> Iterator[OtherAntenna]:
    """P_sky with each other antenna, by dipole, shape (lst, freq); antennas that change nothing are left out."""
    own = load_antenna(antenna_of(instrument)).name
    for name, antenna in antennas.items():
        try:
            other = compute_sky_power(instrument, antenna=antenna, lst_hours=lst_hours).power
        except BadInputError:
            # a pattern that is not known at these channels or for a tilted arm
            continue
        change = {dipole: np.log(other[dipole] / one) for dipole, one in power.items()}
        if name != own and max(float(np.sqrt(np.mean(one**2))) for one in change.values()) > SAME:
            yield OtherAntenna(name, change)


def list_other_antennas(instrument: Instrument, power: Mapping[str, Floats], lst_hours: Floats) -> list[OtherAntenna]:
    """Dipoles over lossy ground and over a conducting plane, at heights between which data cannot tell."""
    wavenumber = 2.0 * np.pi * 1e6 * float(instrument.frequency_mhz.max()) / SPEED_OF_LIGHT
    heights = (PHASES / wavenumber).tolist()
    kinds: list[dict[str, str | AntennaModel]] = [
        {"hamaker": "hamaker"},
        {"quarter-wave": QuarterWaveDipole()},
        {f"a short dipole at {height:.2f} m": ShortDipole(height_m=height) for height in heights},
    ]
    found = [list(exchange_antennas(instrument, power, lst_hours, kind)) for kind in kinds]
    count = sum(len(kind) > 0 for kind in found)
    return [replace(one, share=1.0 / count / len(kind)) for kind in found for one in kind]


# Mistakes that users have made, as changes of P_sky.

CLOCK_HOURS = (-2, -1, 1, 2)
OTHER_ANTENNA = "the antenna is like"
"""How the mistake begins that no record can be put right for."""
OTHER_ANTENNAS = ("hamaker", "short-dipole", "quarter-wave")
"""A dipole over lossy ground, a short one over a conducting plane, and one whose height grows with the wavelength."""


@dataclass(frozen=True)
class Mistake:
    """P_sky without a mistake of the record.

    Attributes
    ----------
    name
        What is wrong, in words.
    change
        By dipole, ln of P_sky without the mistake over P_sky, shape (lst, freq), on the grid of the sky's prior.
    antenna
        The antenna that it is, where the antenna is wrong. The fit absorbs its level in A(nu), which is free, so that
        only its form along LST shows, and the level is what makes C wrong.
    """

    name: str
    change: Mapping[str, Floats]
    antenna: str | None = None

    def shown(self, dipole: str) -> Floats:
        """The part of the change that data can show, shape (lst, freq)."""
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
    return [*mistakes, *(Mistake(f"{OTHER_ANTENNA} {one.name}", one.change, one.name) for one in others)]


# What the package's own sky power may be wrong by: other models of sky and antenna, and smooth departures of both.

SKY_HARMONICS = 8
"""P_sky and its changes have no more, to 0.005 %."""


def sky_prior(instrument: Instrument, models: DifferenceModels | None = None) -> SkyPrior:
    """The freedom of `compute_sky_power` for an instrument; by all other models that ship unless named."""
    with threadpool_limits(1):
        return _sky_prior(instrument, models or DifferenceModels())


def _sky_prior(instrument: Instrument, models: DifferenceModels) -> SkyPrior:
    own = compute_sky_power(instrument, lst_hours=LST_HOURS)
    wider = vary_sky_power(instrument, lst_hours=LST_HOURS, zenith_gain_fraction=ZENITH_GAIN)
    differences = compute_model_differences(instrument, models)
    waves = np.concatenate([one.changes for one in waves_at(instrument.frequency_mhz, LST_HOURS)])
    modes = {}
    for dipole, values in own.power.items():
        pattern = np.log(wider.power[dipole] / values)[None]
        modes[dipole] = np.concatenate([differences.list_modes(dipole), pattern])
    made_of = {"own": own.digest(), "sizes": {name: row.sizes for name, row in read_prior().items()}}
    mistakes = list_mistakes(instrument, own.power, LST_HOURS)
    others = list_other_antennas(instrument, own.power, LST_HOURS)
    names = {"mistakes": [one.name for one in mistakes], "other_antennas": [one.name for one in others]}
    digest = hash_content({**made_of, "skies": models.skies, "antennas": models.antennas, **names})
    return SkyPrior(modes, digest, tuple(mistakes), tuple(others), waves)


@dataclass(frozen=True)
class SkyPrior:
    """How far P_sky may differ from the one that is given.

    Attributes
    ----------
    modes
        By dipole, shape (mode, lst, freq), on a regular grid of the sidereal day that begins at 0 h: independent
        changes of ln P_sky, one standard deviation each.
    digest
        Hash of what they were made from.
    mistakes
        Named changes of P_sky that would put a mistaken input right, on the same grid.
    antennas
        What P_sky would be with other antennas.
    waves
        The modes of every dipole that are waves along LST which no model has.
    """

    modes: Mapping[str, Floats]
    digest: str
    mistakes: Sequence[Mistake] = ()
    antennas: Sequence[OtherAntenna] = ()
    waves: Floats | None = None

    def series(self, dipole: str) -> Floats:
        """Coefficients of `harmonics_at` of the modes, shape (mode, harmonic, freq)."""
        return _series_of(self.modes[dipole])

    def search_series(self, dipole: str) -> Floats:
        """As `series`, with the waves of searches: no find may come from a sky that is more wrong than models are."""
        if self.waves is None:
            return self.series(dipole)
        beyond = (read_prior()["widening"].size ** 2 - 1.0) ** 0.5
        return np.concatenate([self.series(dipole), _series_of(beyond * self.waves)])

    def mistake_series(self, dipole: str) -> Floats:
        """Coefficients of `harmonics_at` of what data show of each mistake, shape (mistake, harmonic, freq)."""
        shown = [one.shown(dipole) for one in self.mistakes]
        return _series_of(np.reshape(shown, (-1, *self.modes[dipole].shape[1:])))


def _series_of(changes: Floats) -> Floats:
    terms = np.fft.rfft(changes, axis=1)[:, : SKY_HARMONICS + 1] / changes.shape[1]
    return np.concatenate([terms[:, :1].real, 2.0 * terms[:, 1:].real, -2.0 * terms[:, 1:].imag], axis=1)


# What may be wrong with sky, pattern and ground: changes of P_sky, one standard deviation each.

DEFAULT_SKY_BUDGET = "models"
PAPER_BUDGET = "paper"
PATTERN = "antenna pattern"


def list_changes(instrument: Instrument, sky_budget: str = DEFAULT_SKY_BUDGET) -> list[SkyTerm]:
    """How far sky (by one of `SKY_BUDGETS`), pattern and ground may be from what C is made with; terms alike are one.

    Where no sky or antenna model reaches the instrument's channels, the level of the sky alone; `measured` is refused.
    """
    require_name("sky budget", sky_budget, SKY_BUDGETS)
    try:
        changes = [*sky_terms(instrument, sky_budget, instrument.sky or "gsm"), _pattern(instrument)]
        return changes if sky_budget == PAPER_BUDGET else [*changes, _ground(instrument)]
    except BadInputError:
        if sky_budget not in (DEFAULT_SKY_BUDGET, PAPER_BUDGET):  # what was asked for cannot be had
            raise
        return [_level(instrument)]


def _level(instrument: Instrument) -> SkyTerm:
    """The error of the level that the paper gives."""
    hours = np.arange(24.0)
    total = np.sqrt(sum(read_prior()[name].size ** 2 for name in PAPER))
    change = dict.fromkeys(instrument.dipole_azimuth_deg, np.full((hours.size, instrument.frequency_mhz.size), total))
    return SkyTerm("level of the sky", "Mulrey et al. 2019: no model reaches these channels", hours, change)


def _pattern(instrument: Instrument) -> SkyTerm:
    """The antenna pattern, wider or narrower."""
    own, wider = (vary_sky_power(instrument, zenith_gain_fraction=size) for size in (0.0, ZENITH_GAIN))
    change = {dipole: np.log(wider.power[dipole] / power) for dipole, power in own.power.items()}
    source = "gain at zenith +-10 % with the total fixed (Mulrey et al. 2019, section 4.2)"
    return SkyTerm(PATTERN, source, own.lst_hours, change)


def _ground(instrument: Instrument) -> SkyTerm:
    """Power that the antenna receives from the ground, the same at all LST."""
    own = compute_sky_power(instrument)
    row = read_prior()["ground"]
    share = np.interp(instrument.frequency_mhz, row.at_mhz, row.sizes)
    change = {dipole: np.log1p(share * power.mean(axis=0) / power) for dipole, power in own.power.items()}
    return SkyTerm("ground and losses", "75 K of 300 K through the ground", own.lst_hours, change)
