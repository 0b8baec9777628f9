"""The causes of the contract's catalogue as faults to plant, with settings to draw from and a size to start from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from lbacal_core.errors import UnknownNameError
from lbacal_twin.faults import hardware, sky
from lbacal_twin.faults.fault import EVERYWHERE, Fault, Where
from lbacal_twin.settings import YEAR_S, TwinSettings


@dataclass(frozen=True)
class Cause:
    """One cause that can be planted.

    Attributes
    ----------
    unit
        Unit of the size.
    typical
        A size that a station-year shows at some 10 standard deviations: the start of a search for another SNR.
    laws
        Choices of the further parameters; a date is drawn where one is needed.
    """

    fault: type[Fault]
    unit: str
    typical: float
    laws: tuple[Mapping[str, Any], ...] = ({},)


FOLLOWS = tuple(
    {"follows": name, "is_circuit": law}
    for name in ("temperature", "season", "wet", "rain", "soaked")
    for law in (True, False)
)
HOURS = ((0.0, 24.0), (6.0, 18.0), (7.0, 19.0), (18.0, 23.0), (22.0, 4.0))


def catalogue_faults() -> dict[str, Cause]:
    """Every cause of the contract's catalogue by its ID."""
    return {
        "dipole_swap": Cause(sky.DipoleSwap, "fraction exchanged", 0.006),
        "dipole_azimuth": Cause(sky.DipoleAzimuth, "deg", 0.4),
        "lst_offset": Cause(sky.LstOffset, "h", 0.01),
        "zenith_weighting": Cause(sky.ZenithWeighting, "exponent", 0.03),
        "pattern_width": Cause(sky.PatternWidth, "fraction", 0.02),
        "isotropic_level": Cause(sky.IsotropicLevel, "fraction of the mean sky power", 0.02),
        "point_source": Cause(
            sky.ExtraSource,
            "fraction of its flux",
            0.1,
            tuple({"source": name} for name in ("cas-a", "cyg-a", "tau-a", "vir-a")),
        ),
        "solar_emission": Cause(
            sky.SolarEmission,
            "fraction of the mean sky power at 55 MHz",
            0.002,
            tuple({"index": i} for i in (1.0, 1.5, 2.0)),
        ),
        "ionospheric_absorption": Cause(
            sky.IonosphericAbsorption, "optical depth at 30 MHz", 0.004, tuple({"power": n} for n in (0.5, 0.75, 1.0))
        ),
        "resonance_shift": Cause(hardware.ResonanceShift, "MHz", 0.004, FOLLOWS),
        "resonance_width": Cause(hardware.ResonanceWidth, "fraction", 0.003, FOLLOWS),
        "filter_shift": Cause(hardware.FilterShift, "fraction", 2e-4, ({"follows": "temperature"}, {"date": None})),
        "missing_noise": Cause(
            hardware.MissingNoise,
            "unit of the stage (N_LNA: that of P_sky)",
            1e-16,
            tuple({"stage": s} for s in ("lna", "rcu", "adc")),
        ),
        "lna_noise_slope": Cause(hardware.LnaNoiseSlope, "fraction per 25 MHz", 0.03),
        "lna_noise_temperature": Cause(hardware.LnaNoiseTemperature, "fraction per 10 K", 0.004),
        "gain_temperature": Cause(
            hardware.GainTemperature,
            "fraction per 10 K",
            0.002,
            tuple({"delay_h": hours} for hours in (0.0, 1.0, 2.0, 3.0)),
        ),
        "cable_length": Cause(hardware.CableLength, "m", 3.0),
        "cable_reflection": Cause(
            hardware.CableReflection,
            "relative amplitude of the power",
            0.005,
            tuple({"delay_us": d, "phase_rad": 0.7 * p} for d in (0.2, 0.36, 0.4, 0.575, 0.65, 0.93) for p in range(9)),
        ),
        "cable_temperature": Cause(hardware.CableTemperature, "fraction per 10 K", 0.002),
        "gain_step": Cause(hardware.GainStep, "fraction", 0.004, ({"date": None},)),
        "gain_drift": Cause(hardware.GainDrift, "fraction per year", 0.007),
        "adc_noise_step": Cause(hardware.AdcNoiseStep, "fraction", 0.01, ({"date": None},)),
        "compression": Cause(hardware.Compression, "relative gain per relative power", 0.01),
        "adc_jitter": Cause(hardware.AdcJitter, "fraction of the mean power", 3e-4),
        "rfi_line": Cause(
            sky.RfiLine,
            "fraction of the mean power",
            0.01,
            tuple(
                {"line_mhz": f, "width_mhz": w, "hours": h}
                for f in (36.3, 45.0, 66.8)
                for w in (0.5, 2.0)
                for h in HOURS
            ),
        ),
        "rfi_broadband": Cause(
            sky.RfiBroadband,
            "fraction of the mean sky power at 55 MHz",
            0.002,
            tuple({"index": i, "hours": h} for i in (-3.0, -2.0, 0.0) for h in HOURS),
        ),
    }


def draw_fault(
    cause: str, rng: np.random.Generator, settings: TwinSettings, size: float | None = None, where: Where = EVERYWHERE
) -> Fault:
    """Draw one fault of a cause: its settings, and a date in the middle of the campaign; typical size unless given."""
    known = catalogue_faults()
    if cause not in known:
        raise UnknownNameError("cause", cause, list(known))
    entry = known[cause]
    law = dict(entry.laws[rng.integers(len(entry.laws))])
    if "date" in law:
        instant = settings.start_unix + settings.years * YEAR_S * rng.uniform(0.2, 0.8)
        law["date"] = datetime.fromtimestamp(instant, UTC).date().isoformat()
    return entry.fault(size=entry.typical if size is None else size, where=where, **law)
