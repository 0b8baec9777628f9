"""The catalogue: every cause that is looked for; what acts at the times of a family is an entry here, and no class."""

from __future__ import annotations

from lbacal_core.causes import chain, sky
from lbacal_core.causes.antenna import DipoleSwap, ResonanceShift, ResonanceWidth
from lbacal_core.causes.cable import CableLength, CableReflection
from lbacal_core.causes.cause import Cause, Description, SizeRange

OF_HARDWARE = ("station", "group", "antenna", "path")
"""Targets of what sits in an antenna or its receiver."""

CAUSES: tuple[Cause, ...] = (
    sky.PointSource(),
    sky.SkyChange(
        "zenith_weighting", "exponent", "the sky integral weighs with a wrong power of cos(zenith)",
        "repeat the integral for a uniform sky, whose value is known for every power of the cosine",
        sizes=SizeRange(-1.5, 1.5),
    ),
    sky.SkyChange(
        "pattern_width", "fraction", "the antenna pattern is too wide or too narrow at fixed total power",
        "measure the pattern with a source on a drone", sizes=SizeRange(-0.35, 0.35),
    ),
    sky.DipoleAzimuth(),
    DipoleSwap(),
    Cause(
        "lst_offset", "h", "the sidereal time of data or simulation is off",
        "ask whether lst_h is the edge or the centre of a bin; compare the transit of a bright source in "
        "interferometric data with its right ascension",
        step=0.005, sizes=SizeRange(-3.0, 3.0), does=sky.move_in_time,
    ),
    chain.MissingNoise(),
    Cause(
        "isotropic_level", "fraction of the mean sky power", "the isotropic part of the sky is wrong",
        "compare with an absolute measurement of the sky minimum, or with the noise levels of a laboratory",
        sizes=SizeRange(-0.5, 10.0), does=sky.add_level,
    ),
    sky.SolarEmission(),
    sky.IonosphericAbsorption(),
    ResonanceShift(),
    ResonanceWidth(),
    chain.FilterShift(),
    Cause(
        "lna_noise_slope", "fraction per 25 MHz", "the noise of the LNA has a slope in frequency",
        "measure the noise temperature of an LNA on a dummy load", sizes=SizeRange(-1.0, 1.0),
        does=chain.tilt_lna_noise,
    ),
    chain.TemperatureCause(
        "lna_noise_temperature", "fraction per 10 K", "the noise of the LNA follows temperature",
        "compare nights of equal LST in summer and winter at the lowest frequencies", scopes=OF_HARDWARE,
        sizes=SizeRange(-0.5, 0.5), does=chain.scale_lna_noise,
    ),
    chain.GainTemperature(),
    chain.TemperatureCause(
        "cable_temperature", "fraction per 10 K", "the loss of the cables (in dB) follows temperature",
        "compare short and long cables by day and by night", scopes=("station", "cable", "group", "antenna"),
        sizes=SizeRange(-1.0, 1.0), does=chain.scale_loss,
    ),
    chain.StepCause(
        "gain_step", "fraction", "the gain stepped at a date", "look into the maintenance log of that date",
        sizes=SizeRange(-1.0, 10.0), does=chain.scale_gain,
    ),
    chain.GainDrift(),
    chain.StepCause(
        "adc_noise_step", "fraction", "the noise of the digitiser stepped at a date",
        "look into the maintenance log of that date", sizes=SizeRange(-1.0, 100.0), does=chain.scale_adc_noise,
    ),
    Cause(
        "compression", "fraction", "the gain falls when the total power rises",
        "insert an attenuator and look whether the ratio of strong to weak sky changes", scopes=OF_HARDWARE,
        sizes=SizeRange(0.0, 1.0), does=chain.compress,
    ),
    Cause(
        "adc_jitter", "fraction of the mean power", "clock jitter adds white noise that follows the signal",
        "feed a sine of rising frequency and watch the noise floor", scopes=OF_HARDWARE,
        step=1e-4, sizes=SizeRange(0.0, 1.0), does=chain.add_jitter,
    ),
    sky.RfiLine(),
    sky.RfiBroadband(),
)  # fmt: skip
"""Causes that act from event to event, in the order in which they act: from the sky through beam and arms to the
digitiser."""

ANTENNA_CAUSES = (CableLength(), CableReflection())
"""Causes seen only by comparing antennas."""

DESCRIPTIONS: tuple[Description, ...] = (*CAUSES, *ANTENNA_CAUSES)
"""The whole catalogue."""
