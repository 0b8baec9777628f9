"""The catalogue: every cause that is looked for. Adding one is its class and one line here."""

from __future__ import annotations

from lbacal_core.causes.amplifier import GainDrift, GainStep, GainTemperature, LnaNoiseSlope, LnaNoiseTemperature
from lbacal_core.causes.antenna import DipoleSwap, ResonanceShift, ResonanceWidth
from lbacal_core.causes.cable import CableLength, CableReflection
from lbacal_core.causes.cause import Cause
from lbacal_core.causes.interference import RfiBroadband, RfiLine
from lbacal_core.causes.receiver import AdcJitter, AdcNoiseStep, CableTemperature, Compression, FilterShift
from lbacal_core.causes.sky import (
    IonosphericAbsorption,
    IsotropicLevel,
    LstOffset,
    PointSource,
    SkyChange,
    SolarEmission,
)

CAUSES: tuple[Cause, ...] = (
    DipoleSwap(),
    SkyChange(
        "dipole_azimuth",
        "deg",
        "the arms of the dipoles stand at another azimuth",
        "survey the antennas",
        scopes=("station", "antenna"),
        step=0.02,
    ),
    LstOffset(),
    SkyChange(
        "zenith_weighting",
        "exponent",
        "the sky integral weighs with a wrong power of cos(zenith)",
        "repeat the integral for a uniform sky, whose value is known",
    ),
    SkyChange(
        "pattern_width",
        "fraction",
        "the antenna pattern is too wide or too narrow at fixed total power",
        "measure the pattern with a source on a drone",
    ),
    IsotropicLevel(),
    PointSource(),
    SolarEmission(),
    IonosphericAbsorption(),
    ResonanceShift(),
    ResonanceWidth(),
    FilterShift(),
    LnaNoiseSlope(),
    LnaNoiseTemperature(),
    GainTemperature(),
    CableTemperature(),
    GainStep(),
    GainDrift(),
    AdcNoiseStep(),
    Compression(),
    AdcJitter(),
    RfiLine(),
    RfiBroadband(),
)
"""Causes that act from event to event."""

ANTENNA_CAUSES = (CableLength(), CableReflection())
"""Causes seen only by comparing antennas."""

NEVER_HERE = {
    "missing_noise": "the model of event spectra contains all three noise stages; ask it of band-averaged LST curves",
}
"""Causes of the catalogue that event spectra cannot show, with the reason."""
