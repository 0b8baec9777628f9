"""The catalogue: every cause that is looked for. Adding one is its class and one line here."""

from __future__ import annotations

from lbacal_core.causes.amplifier import (
    GainDrift,
    GainStep,
    GainTemperature,
    LnaNoiseSlope,
    LnaNoiseTemperature,
    MissingNoise,
)
from lbacal_core.causes.antenna import DipoleSwap, ResonanceShift, ResonanceWidth
from lbacal_core.causes.cable import CableLength, CableReflection
from lbacal_core.causes.cause import Cause, Description, SizeRange
from lbacal_core.causes.receiver import AdcJitter, AdcNoiseStep, CableTemperature, Compression, FilterShift
from lbacal_core.causes.sky import (
    DipoleAzimuth,
    IonosphericAbsorption,
    IsotropicLevel,
    LstOffset,
    PointSource,
    RfiBroadband,
    RfiLine,
    SkyChange,
    SolarEmission,
)

CAUSES: tuple[Cause, ...] = (
    PointSource(),
    SkyChange(
        "zenith_weighting",
        "exponent",
        "the sky integral weighs with a wrong power of cos(zenith)",
        "repeat the integral for a uniform sky, whose value is known for every power of the cosine",
        sizes=SizeRange(-1.5, 1.5),
    ),
    SkyChange(
        "pattern_width",
        "fraction",
        "the antenna pattern is too wide or too narrow at fixed total power",
        "measure the pattern with a source on a drone",
        sizes=SizeRange(-0.35, 0.35),
    ),
    DipoleAzimuth(),
    DipoleSwap(),
    LstOffset(),
    MissingNoise(),
    IsotropicLevel(),
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
"""Causes that act from event to event, in the order in which they act: from the sky through beam and arms to the
digitiser."""

ANTENNA_CAUSES = (CableLength(), CableReflection())
"""Causes seen only by comparing antennas."""

DESCRIPTIONS: tuple[Description, ...] = (*CAUSES, *ANTENNA_CAUSES)
"""The whole catalogue."""
