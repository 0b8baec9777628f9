"""One answer: fit, audit and investigation of the same data contradict each other nowhere.

A trouble is hidden in a year of ten antennas: in the record, in a path, in the chain, in the sky, or a gain that
follows what no cause does. Every second world has a sky and an antenna that the finder does not know. Each of the three
says what is wrong in its own words; they are read as causes of the catalogue, and compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbacal_core.audit.audit import AuditReport, audit
from lbacal_core.audit.verdict import RIGHT, UNDECIDED, WRONG
from lbacal_core.calibration.chain_test import LIKELY_MISTAKE
from lbacal_core.curves.curves import MISFIT, FitReport
from lbacal_core.discovery.report import investigate
from lbacal_core.instrument.sidereal import SIDEREAL_DAY_S
from lbacal_core.pipeline import calibrate
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.differences import DifferenceModels
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults import hardware, sky, uncatalogued
from lbacal_twin.faults.fault import Fault, Where
from lbacal_twin.nuisances import REALISTIC
from lbacal_twin.settings import TwinSettings
from lbacal_twin.view import View
from lbacal_twin.world import draw_world
from validation.audit import ANTENNAS, PATH_KINDS, SKIES, hide
from validation.frozen.data_sets import TEN
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by
from validation.superterp import power_of, superterp

STATION, EVENTS = "CS002", 300
ONE = Where(antennas=(3,))
RECORDS = (
    *PATH_KINDS,
    "letters of one",
    "letters of a field",
    "letters of all",
    "cable",
    "clock",
    "arms",
    "latitude",
    "longitude",
)
FAULTS: Mapping[str, Fault] = {
    "gain step": hardware.GainStep(size=0.06, where=ONE, date="2014-07-01"),
    "gain step of all": hardware.GainStep(size=0.04, date="2014-05-11"),
    "gain drift": hardware.GainDrift(size=0.08, where=ONE),
    "gain with temperature": hardware.GainTemperature(size=0.02),
    "cable with temperature": hardware.CableTemperature(size=0.02),
    "cable reflection": hardware.CableReflection(size=0.02, where=ONE, delay_us=0.4, phase_rad=1.0),
    "filter": hardware.FilterShift(size=0.001, date="2014-06-07"),
    "converter": hardware.AdcNoiseStep(size=0.05, date="2014-09-27"),
    "jitter": hardware.AdcJitter(size=0.1),
    "compression": hardware.Compression(size=0.3, where=ONE),
    "resonance": hardware.ResonanceShift(size=0.1, follows="temperature"),
    "amplifier": hardware.LnaNoiseTemperature(size=0.1, where=ONE),
    "swap of some power": sky.DipoleSwap(size=0.5),
    "arms by 8 deg": sky.DipoleAzimuth(size=8.0),
    "clock by 20 min": sky.LstOffset(size=0.33),
    "narrow beam": sky.ZenithWeighting(size=0.3),
    "ionosphere": sky.IonosphericAbsorption(size=0.05),
    "Sun": sky.SolarEmission(size=0.2),
    "line": sky.RfiLine(size=0.1, hours=(18.0, 23.0)),
    "machines": sky.RfiBroadband(size=0.1),
    "supply": uncatalogued.MainsHum(size=0.03),
    "frost and heat": uncatalogued.FrostAndHeat(size=0.03),
}  # fmt: skip
WAVES: Mapping[str, tuple[float, int, bool]] = {
    "LST 2 %": (0.02, 1, False),
    "LST 4 %": (0.04, 1, False),
    "LST 6 %": (0.06, 1, False),
    "LST 3 %, two waves, slope": (0.03, 2, True),
    "LST 3 %, four waves": (0.03, 4, False),
}
"""Amplitude and number of waves a sidereal day; and whether it grows along frequency, from -1 to 1."""
TROUBLES = ("nothing", *RECORDS, *FAULTS, *WAVES)

TRUE_RECORD = (superterp().latitude_deg, superterp().longitude_deg, superterp().dipole_azimuth_deg)
CAUSES_OF_CHECK = {
    "exchange": {"dipole_swap"}, "clock": {"lst_offset"}, "place": {"lst_offset", "site"}, "arms": {"dipole_azimuth"},
    "cable": {"cable_length"}, "stepped": {"gain_step"},
}  # fmt: skip
"""What a line of the audit says, in the words of the catalogue. Paths that do not work have no cause."""
CAUSES_OF_WORDS = {
    "exchanged at": "dipole_swap", "sidereal time is": "lst_offset", "turned by": "dipole_azimuth",
    "latitude": "site", "longitude has": "lst_offset", "the antenna is like": "pattern_width",
}  # fmt: skip
"""The same of the likely mistakes of a fit."""
CONSISTENT = "consistent"


@dataclass(frozen=True)
class Said:
    """The answers of fit, audit and investigation on one data set.

    Attributes
    ----------
    is_misfit
        Whether a path or the station is a misfit.
    mistakes, wrong, found
        Sets of causes that the data cannot tell apart, each named for the station: by fit, audit, investigation.
    right
        Causes of which the audit says that they are not there.
    is_healthy
        Whether the audit finds nothing wrong.
    verdict, axis
        What the investigation concludes.
    """

    is_misfit: bool
    mistakes: Sequence[set[str]]
    wrong: Sequence[set[str]]
    right: set[str]
    is_healthy: bool
    found: Sequence[set[str]]
    verdict: str
    axis: str

    def contradictions(self) -> list[str]:
        """Which two statements cannot both be true."""
        named = [*self.mistakes, *self.found]
        told = [f"right: {cause}" for cause in sorted(self.right) if {cause} in named]
        if self.is_healthy and self.mistakes:
            told.append("right: the record, of which the fit names a mistake")
        if self.is_misfit and self.verdict == CONSISTENT and self.is_healthy:
            told.append("misfit, and nothing is found")
        pairs = {
            "fit and investigation": (self.mistakes, self.found),
            "audit and investigation": (self.wrong, self.found),
            "fit and audit": (self.mistakes, self.wrong),
        }
        for whom, (one, other) in pairs.items():
            if one and other and not any(a & b for a in one for b in other):
                told.append(f"other names: {whom}")
        return told


def make(trouble: str, seed: int) -> tuple[Spectra, Simulation]:
    """Spectra with a trouble, and what is believed of them."""
    rng = np.random.default_rng([20261126, seed])
    used = [r for r in superterp().antennas if r.station == STATION and r.antenna in TEN]
    instrument = replace(superterp(), antennas=used)
    believed, others, power, view = power_of(), DifferenceModels(), power_of(), View(superterp())
    if seed % 2:
        world = draw_world(rng, SKIES, ANTENNAS)
        others = DifferenceModels(
            tuple(one for one in others.skies if one != world.sky),
            tuple(one for one in others.antennas if one != world.antenna),
        )
        power, view = world.sky_power(superterp()), world.view(superterp())
    settings, faults = (
        TwinSettings(stations=(STATION,), events_per_year=EVENTS),
        [FAULTS[trouble]] if trouble in FAULTS else [],
    )
    spectra = simulate_campaign(settings, instrument, power, rng, faults, REALISTIC, view).spectra
    if trouble in RECORDS:
        faulty = hide(trouble, spectra, instrument, rng)
        spectra, instrument = faulty.spectra, faulty.instrument
    if trouble in WAVES:
        size, number, has_slope = WAVES[trouble]
        along = np.linspace(-1.0, 1.0, spectra.frequency_mhz.size) if has_slope else np.ones(spectra.frequency_mhz.size)
        wave = np.cos(2 * np.pi * number * spectra.time_unix / SIDEREAL_DAY_S)[:, None]
        spectra = replace(spectra, power=spectra.power * (1.0 + size * wave * along))
    # a record that is wrong has a P_sky of its own
    record = (instrument.latitude_deg, instrument.longitude_deg, instrument.dipole_azimuth_deg)
    return spectra, Simulation(instrument, believed if record == TRUE_RECORD else None, is_own_sky=True, models=others)


def ask(spectra: Spectra, simulation: Simulation, seed: int) -> tuple[AuditReport, list[FitReport], dict[str, Any]]:
    """Run audit, fits of paths and station, and investigation."""
    audited = audit(spectra, simulation.instrument, others=simulation.models)
    fits = [calibrate(spectra, simulation, scope) for scope in ("antenna", "station")]
    return audited, fits, investigate(spectra, simulation, seed=seed)[0]


def read(audited: AuditReport, fits: Sequence[FitReport], content: Mapping[str, Any]) -> Said:
    """Read the answers as causes."""
    notes = [one.provenance.notes.get(LIKELY_MISTAKE, "") for one in fits]
    named = [{cause for words, cause in CAUSES_OF_WORDS.items() if words in note} for note in notes]
    checks: dict[str, list[set[str]]] = {WRONG: [], RIGHT: [], UNDECIDED: []}
    for line in audited.lines:
        of_line = [CAUSES_OF_CHECK[check] for check in line.candidates or (line.check,) if check in CAUSES_OF_CHECK]
        if of_line and not line.antennas:
            checks[line.verdict].append(set().union(*of_line))
    findings, left = content["findings"], content["unexplained"]
    return Said(
        is_misfit=any(curve.status == MISFIT for one in fits for curve in one.curves),
        mistakes=[one for one in named if one],
        wrong=checks[WRONG],
        right=set().union(*checks[RIGHT]),
        is_healthy=audited.is_healthy,
        found=[{f["cause"], *f["indistinguishable"]} for f in findings if f["evidence"]["target"] == "station"],
        verdict=content["verdict"],
        axis=str(left["where"]["axis"]) if left else "",
    )


def listen(seed: int) -> Row:
    """A trouble, and what is said of it."""
    trouble, number = TROUBLES[seed % len(TROUBLES)], seed // len(TROUBLES)
    said = read(*ask(*make(trouble, number), seed=seed))
    of_lists = {name: [sorted(one) for one in getattr(said, name)] for name in ("mistakes", "wrong", "found")}
    one_by_one = {"is_misfit": said.is_misfit, "healthy": said.is_healthy, "verdict": said.verdict, "axis": said.axis}
    return {"trouble": trouble, **one_by_one, **of_lists, "contradictions": said.contradictions()}


def judge(rows: Sequence[Row]) -> list[Found]:
    plain = [row for row in rows if row["trouble"] == TROUBLES[0]]
    silent = sum(row["healthy"] and not row["is_misfit"] and row["verdict"] == CONSISTENT for row in plain)
    return [
        rate_of("contradictory", sum(bool(row["contradictions"]) for row in rows), len(rows)),
        rate_of("loud", len(plain) - silent, len(plain)),
    ]


PARTS = (Part("troubles", listen, judge, 2 * len(TROUBLES), by("trouble"), ("contradictory",)),)
