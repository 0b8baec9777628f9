"""Data sets with something hidden: a small station, a fault of a wanted ideal SNR, and what the finder answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import draw_stations, simulate_campaign
from lbacal_twin.faults.catalogue import catalogue_faults, draw_fault
from lbacal_twin.faults.fault import EVERYWHERE, Fault, Where
from lbacal_twin.faults.hardware import ResonanceFault
from lbacal_twin.faults.sky import PatternWidth, RfiBroadband, RfiLine
from lbacal_twin.gains import BEHIND_EVERYTHING, EventGains
from lbacal_twin.hardware import Scene
from lbacal_twin.nuisances import NONE, REALISTIC, Nuisances
from lbacal_twin.settings import TwinSettings
from lbacal_twin.view import View
from lbacal_twin.world import World
from validation.hidden.finder import Answer, FittedModel, ask_finder
from validation.hidden.ideal import IdealDetector, ideal_detector
from validation.hidden.worlds import OWN, STATION, Finder, alternatives, free_modes, view_of

SMALL = (0, 1, 3, 4, 10, 11)
"""Antennas of three cable lengths, two of each."""
ALIKE = (0, 1, 2, 6, 7, 8, 9, 12, 3, 4)
"""Eight antennas of one cable length, to be compared, and two of another."""
SMALLEST = (0, 1, 3, 4)
"""Antennas of two cable lengths, two of each."""
EVENTS, FEW_EVENTS = 250, 150
STATIC = ("cable_length", "cable_reflection")
LARGEST_CHANGE = 0.5
"""A fault that has to change the power by more than this fraction somewhere to be seen counts as not identifiable."""
SMALL_CHANGE = 0.1
"""In a drawn world the ideal SNR of a fault that changes the power by less is that to first order, good to 5 %. Jitter
of the converter that changes it by half has 10 to first order, and 4 to 7 beside the chain that fits it best."""
FEWEST_SCALINGS, MOST_SCALINGS = 2, 8
SNR_ERROR = 0.01
"""Relative error of the ideal SNR that a planted fault has."""
HEARING = 0.3
"""Gain of an antenna over that of the median one, below which it is deaf."""
FEWEST_SPECTRA = 60
"""Spectra of a path below which `lbacal fit` says that they are too few."""
SMALLEST_SHARE = 0.1
"""Share of its information that a fault must keep beside the freedom of the models: below, they hide it."""

SCOPES: dict[str, tuple[str, ...]] = {
    "dipole_swap": ("station", "antenna"),
    "dipole_azimuth": ("station", "antenna"),
    "resonance_shift": ("station", "antenna"),
    "resonance_width": ("station", "antenna"),
    "filter_shift": ("station", "antenna", "path"),
    "lna_noise_temperature": ("station", "antenna", "path"),
    "gain_temperature": ("station", "antenna", "path"),
    "cable_length": ("antenna",),
    "cable_reflection": ("antenna",),
    "cable_temperature": ("station", "cable"),
    "gain_step": ("path", "antenna", "cable", "station"),
    "gain_drift": ("path", "antenna", "cable", "station"),
    "adc_noise_step": ("path", "antenna", "cable", "station"),
    "compression": ("station", "antenna", "path"),
    "adc_jitter": ("station", "path"),
    "rfi_line": ("station", "antenna"),
}
"""Whom a cause can concern, by the contract; where it is silent, by the physics: the sky is common to a station, a plug
belongs to an antenna, a receiver to a path. The station, where nothing is said."""
ON_BOARDS = ("gain_step", "gain_drift", "adc_noise_step", "gain_temperature", "lna_noise_temperature", "compression")
"""What a board that antennas share can do to all of them, where a data set has boards."""
BOARD = 4
"""Antennas of a board."""


@dataclass(frozen=True)
class Planted:
    """A fault and whom it concerns, in the words of a report."""

    cause: str
    fault: Fault
    scope: str
    label: str

    def sized(self, size: float) -> Planted:
        """The same fault of another size."""
        return replace(self, fault=replace(self.fault, size=size))


@dataclass(frozen=True)
class DataSet:
    """One simulated station-year, with nothing hidden until faults are given.

    Attributes
    ----------
    seed
        Seed of events, weather, hardware and noise, and of the finder.
    half
        0 or 1: only every second event, from the first or the second on; None: all.
    world
        Its sky, antenna and form of the event gains; None where the finder's sky is the true one, at its word.
    finder
        The sky and the antenna with which the finder simulates.
    """

    seed: int
    antennas: tuple[int, ...] = SMALL
    nuisances: Nuisances = NONE
    events: int = EVENTS
    half: int | None = None
    world: World | None = None
    finder: Finder = OWN

    @property
    def settings(self) -> TwinSettings:
        """The settings of the simulation."""
        return TwinSettings(stations=(STATION,), events_per_year=self.events)

    @property
    def instrument(self) -> Instrument:
        """The Superterp, of which only some antennas of one station are used; in a drawn world they share boards."""
        return _instrument(self.antennas, has_boards=self.world is not None)

    def rng(self) -> np.random.Generator:
        """The same random numbers at every call."""
        return np.random.default_rng([20261121, self.seed])

    @cached_property
    def sky_power(self) -> SkyPower:
        """The true P_sky."""
        return self.finder.power() if self.world is None else self.world.sky_power(self.instrument)

    @property
    def view(self) -> View:
        """The true sky by direction."""
        return view_of(self.finder.sky, self.finder.antenna) if self.world is None else view_of(*self.world.models)

    @property
    def gains(self) -> EventGains:
        """Where the gains of events act."""
        return BEHIND_EVERYTHING if self.world is None else self.world.gains

    @cached_property
    def detector(self) -> IdealDetector:
        """The ideal detector; differences between models stay free where the finder's sky is the package's own."""
        (station,), _ = draw_stations(
            self.settings, self.instrument, self.sky_power, self.rng(), self.nuisances, self.view
        )
        modes = None
        if self.world is not None:
            modes = free_modes(self.finder, alternatives(self.world, self.finder), station.scene.lst_hours)
        return ideal_detector(self.settings, self.nuisances, station, self.spectra(), self.gains, modes)

    @property
    def scene(self) -> Scene:
        """The surroundings of the station."""
        return self.detector.station.scene

    def spectra(self, faults: Sequence[Fault] = ()) -> Spectra:
        """The spectra with faults; events, weather, hardware and noise are the same with any."""
        campaign = simulate_campaign(
            self.settings, self.instrument, self.sky_power, self.rng(), faults, self.nuisances, self.view, self.gains
        )
        if self.half is None:
            return campaign.spectra
        _, event = np.unique(campaign.spectra.time_unix, return_inverse=True)
        return campaign.spectra.select(event % 2 == self.half)

    def ask(self, faults: Sequence[Fault] = (), *, is_own_sky: bool = False, without: str = "") -> Answer:
        """Search the data with the faults; the sky power is given and taken as exact.

        Unless it counts as the package's own, whose differences from other models are projected out, as it does in a
        world that was drawn.
        """
        return self.ask_and_fit(faults, is_own_sky=is_own_sky, without=without)[0]

    def ask_and_fit(
        self, faults: Sequence[Fault] = (), *, is_own_sky: bool = False, without: str = ""
    ) -> tuple[Answer, FittedModel | None]:
        """The answer, and the fitted model with what was found; None where the finder broke down."""
        known = None if self.world is None else alternatives(self.world, self.finder)
        return ask_finder(
            self.spectra(faults),
            self.instrument,
            self.finder.power(),
            is_own_sky=is_own_sky or known is not None,
            models=known,
            seed=self.seed,
            without=without,
        )

    def draw(self, cause: str, rng: np.random.Generator, scopes: tuple[str, ...] = ()) -> Planted:
        """A fault of a cause: its law, and whom it concerns, of these scopes or of all that it can have."""
        scopes = scopes or self.scopes_of(cause)
        scope = scopes[rng.integers(len(scopes))]
        where, label = self._choose(scope, rng, self._comparable if cause in STATIC else self.hearing)
        return Planted(cause, draw_fault(cause, rng, self.settings, where=where), scope, label)

    def scopes_of(self, cause: str) -> tuple[str, ...]:
        """Whom a cause can concern in this data set."""
        boards = ("group",) if self.world is not None and cause in ON_BOARDS else ()
        return (*SCOPES.get(cause, ("station",)), *boards)

    @cached_property
    def hearing(self) -> tuple[int, ...]:
        """Antennas that receive the sky, in as many events as a fit needs.

        One that is deaf, or died in the first weeks, is reported as that, and nothing else is asked of it.
        """
        gain, spectra = self.detector.station.stages.gain, self.spectra()
        of_antenna = gain.mean(axis=tuple(range(1, gain.ndim)))
        receives = of_antenna > HEARING * np.median(of_antenna)
        events = np.array([self._spectra_of(spectra, int(a)) for a in self.scene.antennas])
        return tuple(int(a) for a in self.scene.antennas[receives & (events >= FEWEST_SPECTRA)])

    @staticmethod
    def _spectra_of(spectra: Spectra, antenna: int) -> int:
        """Spectra of the dipole of an antenna that has fewer."""
        return min(int(np.sum((spectra.antenna == antenna) & (spectra.dipole == dipole))) for dipole in DIPOLES)

    @property
    def _comparable(self) -> tuple[int, ...]:
        """Antennas of the most common cable, which have others to be compared with."""
        scene = self.scene
        names, counts = np.unique(scene.cables, return_counts=True)
        alike = scene.antennas[scene.cables == names[np.argmax(counts)]]
        return tuple(int(a) for a in alike if a in self.hearing)

    def _choose(self, scope: str, rng: np.random.Generator, antennas: Sequence[int]) -> tuple[Where, str]:
        antenna = int(rng.choice(antennas))
        if scope == "antenna":
            return Where(antennas=(antenna,)), f"antenna {antenna}"
        if scope == "path":
            dipole = str(rng.choice(DIPOLES))
            return Where(antennas=(antenna,), dipoles=(dipole,)), f"antenna {antenna} {dipole}"
        if scope == "group":
            board = antenna // BOARD
            members = tuple(a for a in self.antennas if a // BOARD == board)
            return Where(antennas=members), f"group {_board_of(antenna)}"
        if scope == "cable":
            cable = str(rng.choice(np.unique(self.scene.cables)))
            return Where(cables=(cable,)), f"cable {cable}"
        return EVERYWHERE, "station"

    def snr(self, planted: Planted) -> float:
        """The ideal SNR of a fault."""
        if planted.cause in STATIC:
            return self.detector.snr_against_others(planted.fault)
        if self.world is not None and self._change_by(planted) < SMALL_CHANGE:
            return self.detector.linear_snr([planted.fault])
        return self.detector.snr([planted.fault])

    def with_snr(self, planted: Planted, snr: float) -> Planted | None:
        """The fault with the size that has a wanted ideal SNR, or None where no sensible size has it.

        Almost all faults are linear: scaled once, and once more for what is not, and again where that was not enough. A
        fault that other models of the sky make as well is none that this finder could show.
        """
        is_seen = planted.cause not in STATIC and self.world is not None
        if is_seen and self.detector.share_left([planted.fault]) < SMALLEST_SHARE:
            return None
        for scalings in range(MOST_SCALINGS):
            now = self.snr(planted)
            if scalings >= FEWEST_SCALINGS and abs(now / snr - 1.0) < SNR_ERROR:
                return planted
            size = planted.fault.size * snr / now if now > 1e-9 else np.inf
            if not np.isfinite(size) or (planted.cause == "dipole_swap" and abs(size) > 1):
                return None
            planted = planted.sized(size)
            if self._change_by(planted) > LARGEST_CHANGE:
                return None
        return None

    def _change_by(self, planted: Planted) -> float:
        """Largest relative change of the power by a fault."""
        return float(np.abs(self.detector.template([planted.fault])).max())


def plain(seed: int) -> DataSet:
    """A data set with nothing hidden, as small as serves to count false alarms in thousands."""
    return DataSet(seed, SMALLEST, events=FEW_EVENTS)


def realistic(seed: int) -> DataSet:
    """The same with every nuisance: an antenna dies, and in every third the station itself is the noisy one."""
    noisy = STATION if seed % 3 == 0 else "CS003"
    return replace(plain(seed), nuisances=replace(REALISTIC, noisy_stations=(noisy,), dead_antennas=1))


def comparable(seed: int) -> DataSet:
    """A data set with nothing hidden and enough antennas to compare them with each other."""
    return DataSet(seed, ALIKE, events=FEW_EVENTS)


def draw_one(data: DataSet, snr: float, rng: np.random.Generator, causes: Sequence[str]) -> Planted:
    """A fault of the wanted ideal SNR, of a cause drawn among those that the data set can show."""
    for _ in range(200):
        sized = data.with_snr(data.draw(str(rng.choice(list(causes))), rng), snr)
        if sized is not None:
            return sized
    raise RuntimeError(f"data set {data.seed} can show no fault of SNR {snr:g}")


def moving_causes() -> list[str]:
    """Causes that act from event to event and that a complete model of the noise stages leaves to be found."""
    return sorted(set(catalogue_faults()) - {"missing_noise", *STATIC})


def is_in_family(planted: Planted) -> bool:
    """Whether the planted law is one that the contract or the docs list, not one beside it."""
    fault = planted.fault
    if isinstance(fault, PatternWidth):  # a power of itself; the catalogue's pattern has a term in cos(zenith angle)
        return False
    if isinstance(fault, ResonanceFault):
        return not fault.is_circuit
    if isinstance(fault, RfiLine) and fault.width_mhz > 1.0:
        return False
    return fault.hours == (6.0, 18.0) if isinstance(fault, (RfiLine, RfiBroadband)) else True


@cache
def _instrument(antennas: tuple[int, ...], *, has_boards: bool) -> Instrument:
    whole = load_instrument("lofar-superterp")
    used = [r for r in whole.antennas if r.station == STATION and r.antenna in antennas]
    return replace(whole, antennas=[replace(r, group=_board_of(r.antenna) if has_boards else None) for r in used])


def _board_of(antenna: int) -> str:
    return f"board {antenna // BOARD}"


def correlations(information: Floats) -> Floats:
    """Correlations of signatures from their inner products."""
    scale = np.sqrt(np.diag(information))
    return np.asarray(information / scale / scale[:, None])
