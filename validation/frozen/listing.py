"""The frozen data sets by name.

The laws, targets and sizes were drawn once by `validation.hidden` (ideal SNR 15, pairs 10 each given the other, effects
of no catalogue 25) and are written down here, so that they depend on no code that may change. Chosen by hand are sizes
of `adc_jitter` and `cable_length`, large enough to be found, and of `isotropic_level` and `missing_noise`, which the
free parameters of event spectra absorb at any size.
"""

from __future__ import annotations

from dataclasses import replace

from lbacal_twin.faults import hardware, sky
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.uncatalogued import JovianBursts, MainsHum
from lbacal_twin.nuisances import REALISTIC
from validation.frozen.data_sets import TEN, BandCurve, DataSet, StationSpectra

DAY = (6.0, 18.0)
EVENING = (18.0, 23.0)
NUISANCES = replace(REALISTIC, noisy_stations=("CS002",), dead_antennas=1)

CAUSES: tuple[DataSet, ...] = (
    StationSpectra("adc_jitter", 700_001, (hardware.AdcJitter(size=0.1),)),
    StationSpectra("adc_noise_step", 700_002, (hardware.AdcNoiseStep(size=0.02451, date="2014-09-27"),)),
    StationSpectra(
        "cable_length",
        700_003,
        (hardware.CableLength(size=12.0, where=Where(antennas=(0,))),),
        antennas=TEN,
        events=150,
    ),
    StationSpectra(
        "cable_reflection",
        700_004,
        (hardware.CableReflection(size=0.01393, where=Where(antennas=(9,)), delay_us=0.4, phase_rad=3.5),),
        antennas=TEN,
        events=150,
    ),
    StationSpectra("cable_temperature", 700_005, (hardware.CableTemperature(size=0.005047),)),
    StationSpectra(
        "compression", 700_006, (hardware.Compression(size=0.4268, where=Where(antennas=(0,), dipoles=("X",))),)
    ),
    StationSpectra("dipole_azimuth", 700_007, (sky.DipoleAzimuth(size=10.17),)),
    StationSpectra("dipole_swap", 700_008, (sky.DipoleSwap(size=0.4096, where=Where(antennas=(4,))),)),
    StationSpectra("filter_shift", 700_009, (hardware.FilterShift(size=0.00094, date="2014-06-07"),)),
    StationSpectra("gain_drift", 700_010, (hardware.GainDrift(size=0.05492, where=Where(cables=("50",))),)),
    StationSpectra(
        "gain_step", 700_011, (hardware.GainStep(size=0.04968, where=Where(antennas=(10,)), date="2014-09-19"),)
    ),
    StationSpectra(
        "gain_temperature",
        700_012,
        (hardware.GainTemperature(size=0.03269, where=Where(antennas=(3,), dipoles=("Y",))),),
    ),
    StationSpectra("ionospheric_absorption", 700_013, (sky.IonosphericAbsorption(size=0.07001),)),
    StationSpectra("isotropic_level", 700_014, (sky.IsotropicLevel(size=0.3),)),
    StationSpectra("lna_noise_slope", 700_015, (hardware.LnaNoiseSlope(size=0.2032),)),
    StationSpectra(
        "lna_noise_temperature", 700_016, (hardware.LnaNoiseTemperature(size=0.07199, where=Where(antennas=(4,))),)
    ),
    StationSpectra("lst_offset", 700_017, (sky.LstOffset(size=0.2327),)),
    StationSpectra("missing_noise", 700_018, (hardware.MissingNoise(size=1e-16, stage="lna"),)),
    StationSpectra("pattern_width", 700_019, (sky.PatternWidth(size=0.09849),)),
    StationSpectra("point_source", 700_020, (sky.ExtraSource(size=3.583, source="cyg-a"),)),
    StationSpectra(
        "resonance_shift", 700_021, (hardware.ResonanceShift(size=0.0383, follows="rain", is_circuit=False),)
    ),
    StationSpectra(
        "resonance_width", 700_022, (hardware.ResonanceWidth(size=0.004095, follows="season", is_circuit=False),)
    ),
    StationSpectra("rfi_broadband", 700_023, (sky.RfiBroadband(size=0.006637, index=-3.0),)),
    StationSpectra(
        "rfi_line",
        700_024,
        (sky.RfiLine(size=0.1066, where=Where(antennas=(1,)), line_mhz=66.8, width_mhz=0.5, hours=DAY),),
    ),
    StationSpectra("solar_emission", 700_025, (sky.SolarEmission(size=0.02631, index=2.0),)),
    StationSpectra("zenith_weighting", 700_026, (sky.ZenithWeighting(size=0.2414),)),
)
"""Every cause of the catalogue once, by its ID."""

OTHERS: tuple[DataSet, ...] = (
    StationSpectra("clean", 700_040),
    StationSpectra("clean-nuisances", 700_051, nuisances=NUISANCES),
    StationSpectra("clean-alike", 700_042, antennas=TEN, events=150),
    StationSpectra(
        "pair-antennas",
        700_027,
        (
            hardware.LnaNoiseTemperature(size=0.05004, where=Where(antennas=(3,))),
            hardware.ResonanceShift(size=0.02788, where=Where(antennas=(11,)), follows="season", is_circuit=False),
        ),
    ),
    StationSpectra(
        "pair-antenna-station",
        700_028,
        (
            sky.RfiLine(size=0.04304, where=Where(antennas=(0,)), width_mhz=2.0, hours=EVENING),
            sky.DipoleAzimuth(size=7.485),
        ),
    ),
    StationSpectra(
        "pair-station", 700_029, (hardware.LnaNoiseTemperature(size=0.02453), sky.SolarEmission(size=0.02021))
    ),
    StationSpectra("unknown-utc", 700_030, (MainsHum(size=0.01839),)),
    StationSpectra("unknown-bursts", 700_032, (JovianBursts(size=0.1168),)),
    StationSpectra("two-stations-clean", 700_043, stations=("CS002", "CS004")),
    StationSpectra(
        "two-stations-step",
        700_044,
        (hardware.GainStep(size=0.06, where=Where(stations=("CS004",), antennas=(4,)), date="2014-07-15"),),
        stations=("CS002", "CS004"),
    ),
    StationSpectra("own-sky-clean", 700_045, is_own_sky=True),
    StationSpectra("own-sky-filter", 700_046, (hardware.FilterShift(size=0.001, date="2014-06-07"),), is_own_sky=True),
    BandCurve("curve-measured"),
    BandCurve("curve-clean", 700_047),
    BandCurve("curve-exchanged-late", 700_048, is_exchanged=True, late_h=1.0),
    StationSpectra("unknown-temperature", 700_049, (hardware.GainTemperature(size=0.02),), unknown_temperature=100),
)
"""Nothing hidden, pairs, effects of no catalogue, two stations, the own sky, LST curves, and a covariate with a gap."""

DATA_SETS: dict[str, DataSet] = {one.name: one for one in (*CAUSES, *OTHERS)}
