"""Every value refuses, when it is made, what it cannot be, and says what was expected and what was found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from lbacal_core.antenna.model import JonesTable
from lbacal_core.causes.model import AdoptedCause
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.instrument.stages import parse_stages
from lbacal_core.sky.model import SkyModel
from lbacal_core.sky.names import load_sky
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import MAX_COVARIATES, Spectra

MHZ = np.array([30.0, 55.0, 80.0])
ANGLES = {"zenith_deg": np.array([0.0, 30.0, 60.0, 90.0]), "azimuth_deg": np.arange(8) * 45.0}
FIELD = np.ones((3, 4, 8), dtype=complex)
TABLE = JonesTable("a", MHZ, **ANGLES, theta=FIELD, phi=FIELD)
POWER = SkyPower(MHZ, np.arange(24.0), {"X": np.ones((24, 3)), "Y": np.ones((24, 3))}, "P.json")
CAUSE = AdoptedCause("gain_temperature", "CS002", "station", 0.05, 0.01, {"delay_h": 0.0})
SPECTRA = Spectra(
    MHZ, np.ones((2, 3)), np.array(["e0", "e1"]), np.array([1.4e9, 1.5e9]), np.array(["CS002"] * 2), np.zeros(2, int),
    np.array(["X", "X"]), np.full(2, 100), origin="S.h5",
)  # fmt: skip


@cache
def instrument() -> Instrument:
    return load_instrument("lofar-superterp")


@cache
def sky() -> SkyModel:
    return load_sky("gsm")


def changed(values: Any, index: Any, value: Any) -> Any:
    """A copy of an array with one other value."""
    other = np.array(values)
    other[index] = value
    return other


def stages(*content: Any) -> Any:
    return parse_stages(content[0] if len(content) == 1 else list(content), MHZ, "I.json: stages", None)


LNA = {"name": "lna", "kind": "lna", "gain": 100.0}
FREE = {"name": "adc", "kind": "adc", "noise_temperature_k": "free"}
TABLES = {
    "zenith_deg: expected at least 4 angles rising from 0 to 85 or more, found [ 0. 30. 60. 80.]": {
        "zenith_deg": np.array([0.0, 30.0, 60.0, 80.0])},
    "azimuth_deg: expected 8 or more even steps from 0 to below 360, found [ 0. 45. 90. 135. 180. 225. 270. 300.]": {
        "azimuth_deg": changed(ANGLES["azimuth_deg"], 7, 300.0)},
    "theta: expected shape (3, 4, 8) (freq, zenith, azimuth), found (3, 4, 7)": {"theta": FIELD[..., 1:]},
    "phi, row [1 2 3]: expected finite numbers, found another": {"phi": changed(FIELD, (1, 2, 3), np.nan)},
    "a: expected a response at zenith at every frequency, found none": {
        "theta": changed(FIELD, (1, 0), 0.0), "phi": changed(FIELD, (1, 0), 0.0)},
}  # fmt: skip
POWERS = {
    "lst_hours: expected a list of at least 3 instants, found shape (2,)": {"lst_hours": np.arange(2.0)},
    "lst_hours, row 5: expected 24 h / 24 = 1 h after the row before, found 1.5 h after it": {
        "lst_hours": changed(np.arange(24.0), 5, 5.5)},
    "P.json: expected P_sky of one dipole or more, under its letter, found none": {"power": {}},
    "Y: expected shape (24, 3) (lst, freq), found (23, 3)": {"power": {"Y": np.ones((23, 3))}},
    "Y, row 4, channel 1: expected finite power > 0, found 0.0": {"power": {"Y": changed(np.ones((24, 3)), (4, 1), 0)}},
    "stations.CS002: expected the same dipoles and channels, found others": {
        "stations": {"CS002": SkyPower(MHZ, np.arange(24.0), {"X": np.ones((24, 3))})}},
}  # fmt: skip
OF_SPECTRA = {
    "antenna: expected 2 rows as in event_id, found 1": {"antenna": np.zeros(1, int)},
    "power: expected 3 channels, found (2, 2)": {"power": np.ones((2, 2))},
    "resistance_ohm: expected Ohm > 0, found -50": {"resistance_ohm": -50},
    "power, row 1: expected finite power > 0, found": {"power": changed(np.ones((2, 3)), (1, 2), -1.0)},
    "flag: expected 2 texts, one a row, found shape (1,)": {"flag": np.array(["storm"])},
    "width_mhz: expected 3 numbers, found shape (2,)": {"width_mhz": np.ones(2)},
    "duration_s, entry 1: expected a finite number > 0, found 0.0": {"duration_s": np.array([1.0, 0.0])},
    "env: expected names such as rain_mm_h (40 characters), found 'Rain'": {"environment": {"Rain": np.ones(2)}},
    "env/rain: expected 2 numbers, one a row, found (3,)": {"environment": {"rain": np.ones(3)}},
    f"env, row 1: expected at most {MAX_COVARIATES} covariates, found {MAX_COVARIATES + 1}": {
        "environment": {f"c{k}": np.array([np.nan, 1.0]) for k in range(MAX_COVARIATES + 1)}},
}  # fmt: skip
CAUSES = {
    "gain_temperature: target: expected a name, found ''": {"target": ""},
    "gain_temperature: size: expected a finite number, found nan": {"size": float("nan")},
    "gain_temperature: sigma: expected a standard deviation > 0, found 0.0": {"sigma": 0.0},
    "gain_temperature: until: expected an instant after since": {"since_unix": 1.5e9, "until_unix": 1.4e9},
    "gain_temperature: date_unix: expected an instant, s UTC, found True": {"parameters": {"date_unix": True}},
}
GROUND, COAX = {"name": "g", "kind": "ground"}, {"name": "coax", "kind": "cable"}
STAGES = {
    "stages: expected a list of one stage or more, found dict": LNA,
    "stages: expected a list of one stage or more, found an empty one": [],
    "noise_temperature_k: expected 'free', or kelvin as ": [{**LNA, "noise_temperature_k": "Free"}],
    "row 0: expected a stage with name and kind, found {'name': 'lna'}": [{"name": "lna"}],
    "row 0: expected the fields name, ": [{**LNA, "gian": 3}],
    "row 0: expected a gain, found none": [{"name": "lna", "kind": "lna"}],
    "expected no gain of what the antenna sees (ground), found one": [{"name": "g", "kind": "ground", "gain": 1.0}],
    "an error >= 0 of a known noise temperature": [{**LNA, "noise_temperature_error_k": 3.0}],
    "solid_angle_sr: expected 0 to 4 pi sr, the sphere, found 90": [{**GROUND, "solid_angle_sr": 90}],
    "row 0: gain: expected a power factor <= 1 of a cable (dB <= 0), found 2": [{**COAX, "gain": 2}],
    "stages: expected a name for each stage, found 'lna' twice": [LNA, LNA],
    "before what the signal passes, found lna, ground": [LNA, {"name": "g", "kind": "ground"}],
    "stages: expected the adc as the last stage, found adc, lna": [FREE, LNA],
    "stages: expected one lna, found 2": [LNA, {**LNA, "name": "other"}, FREE],
    "no noise temperature of the cable": [LNA, {"name": "coax", "kind": "cable", "noise_temperature_k": "free"}],
    "one stage at least whose noise_temperature_k is free, or has an error, found none": [LNA],
}
INSTRUMENTS: dict[str, Callable[[], dict[str, Any]]] = {
    "dipoles.X.azimuth_deg: expected -360 to 360, found nan": lambda: {
        "dipole_azimuth_deg": {"X": float("nan"), "Y": 135.0}},
    "dipoles.X.tilt_deg: expected -90 to 90, found 91": lambda: {"dipole_tilt_deg": {"X": 91}},
    "dipoles: expected one dipole or more, found none": lambda: {"dipole_azimuth_deg": {}},
    "alternatives.S11: expected one or more, on the same channels": lambda: {"alternatives": {"S11": ()}},
}  # fmt: skip
SKIES: dict[str, Callable[[], dict[str, Any]]] = {
    "level: expected": lambda: {"level": sky().level[1:]},
    "multipoles: expected shape (": lambda: {"multipoles": sky().multipoles[:, 1:]},
    "sky gsm: expected finite numbers and levels > 0, found others": lambda: {"level": -sky().level},
}
CASES: list[tuple[str, Callable[[], object]]] = [
    *((said, lambda more=more: replace(TABLE, **more)) for said, more in TABLES.items()),
    *((said, lambda more=more: replace(POWER, **more)) for said, more in POWERS.items()),
    *((said, lambda more=more: replace(SPECTRA, **more)) for said, more in OF_SPECTRA.items()),
    *((said, lambda more=more: replace(CAUSE, **more)) for said, more in CAUSES.items()),
    *((said, lambda content=content: stages(content)) for said, content in STAGES.items()),
    *((said, lambda make=make: replace(instrument(), **make())) for said, make in INSTRUMENTS.items()),
    *((said, lambda make=make: replace(sky(), **make())) for said, make in SKIES.items()),
]


@pytest.mark.parametrize(("said", "make"), CASES, ids=[said[:60] for said, _ in CASES])
def test_a_value_refuses_what_it_cannot_be(said: str, make: Callable[[], object]) -> None:
    with pytest.raises(BadInputError) as refused:
        make()
    assert said in " ".join(str(refused.value).split())


def test_a_stage_is_what_the_list_says() -> None:
    lna, adc = stages(LNA, FREE)
    assert (lna.kind, lna.gain.tolist(), lna.has_noise, adc.is_free) == ("lna", [100.0] * 3, False, True)
