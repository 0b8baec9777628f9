from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import ResonanceShift, ResonanceWidth
from lbacal_twin.faults.sky import LstOffset, PatternWidth, RfiLine
from validation.hidden.data_sets import DataSet, Planted, is_in_family
from validation.hidden.detection import fit_detection
from validation.hidden.held_out import hide_in_halves
from validation.hidden.sizes import planted_size, size_pull


@pytest.fixture(scope="module")
def data() -> DataSet:
    return DataSet(1)


def test_a_line_between_channels_counts_as_what_is_recorded_in_its_strongest(data):
    fault = RfiLine(size=0.01, line_mhz=66.8, width_mhz=0.5, hours=(6.0, 18.0), where=Where(antennas=(3,)))
    line = Planted("rfi_line", fault, "antenna", "antenna 3")
    assert is_in_family(line)
    # 0.2 MHz from the channel at 67 MHz, of a Gaussian of 0.5 MHz full width at half maximum; the mean that the fault
    # knows lacks the noise of the converter.
    in_channel = 0.01 * 0.5 ** ((0.2 / 0.25) ** 2)
    stages, scene = data.detector.station.stages, data.scene
    before = np.broadcast_to(stages.power_at_converter(), (6, 2, data.events, 51))
    own = before[scene.antennas == 3][..., scene.frequency_mhz == 67.0].mean(axis=2)
    adc = np.broadcast_to(stages.adc_noise, before.shape)[scene.antennas == 3][..., 67 - 30].mean()
    assert planted_size(data, line) == pytest.approx(in_channel * np.mean(own / (own + adc)), rel=1e-3)


def test_a_curve_that_slides_or_widens_has_the_size_that_was_planted(data):
    for fault in (ResonanceShift(size=0.02, follows="season"), ResonanceWidth(size=0.01, follows="temperature")):
        planted = Planted("", fault, "station", "station")
        # A size of 1 % is ln(1.01) of a width, and half-power points are no Lorentz curve's.
        assert planted_size(data, planted) == pytest.approx(fault.size, rel=0.025)
        exact = Planted("", type(fault)(size=fault.size, follows=fault.follows, is_circuit=False), "station", "station")
        assert planted_size(data, exact) == fault.size


def test_what_follows_rain_is_compared_in_the_mean_rain_whatever_the_law(data):
    rain = data.scene.rain_mm_h
    fault = ResonanceShift(size=0.02, follows="soaked", is_circuit=False)
    planted = Planted("resonance_shift", fault, "station", "station")
    mean = 0.02 * np.tanh(rain[rain > 0]).mean()
    assert planted_size(data, planted) == pytest.approx(mean)
    wet = {"parameters": {"wetness": "flag"}, "size": {"value": mean + 0.003, "sigma": 0.001}}
    assert size_pull(data, planted, wet) == pytest.approx(3.0)
    per_mm = {"parameters": {"wetness": "linear"}, "size": {"value": mean / rain[rain > 0].mean(), "sigma": 0.001}}
    assert size_pull(data, planted, per_mm) == pytest.approx(0.0, abs=1e-9)
    statement = {"size": {"value": 1.0, "sigma": None}, "parameters": {}}
    assert size_pull(data, planted, statement) is None, "exchanged letters ended a block of a proof"


def test_a_law_that_the_catalogue_does_not_document_is_beside_the_family() -> None:
    laws = (PatternWidth(size=0.1), LstOffset(size=0.1), ResonanceShift(size=0.1, is_circuit=True))
    assert [is_in_family(Planted("cause", law, "station", "station")) for law in laws] == [False, True, False]


def test_the_curve_of_detection_finds_what_drew_the_trials():
    rng = np.random.default_rng(1)
    snr = np.repeat([4.0, 5.0, 5.5, 6.0, 7.5, 10.0], 300)
    detected = (rng.random(snr.size) < norm.cdf((snr - 5.4) / 1.1)).astype(float)
    curve = fit_detection(snr, detected, draws=60)
    for share in (0.5, 0.95):
        middle, (low, high) = curve.snr_at(share), curve.bounds(share, 0.95)
        assert low < middle < high
        # 1800 trials know the curve to some 0.05; four times that.
        assert middle == pytest.approx(5.4 + 1.1 * norm.ppf(share), abs=0.2)


def test_what_a_deaf_path_recorded_is_divided_by_nothing() -> None:
    """A compression of this size leaves one path without the sky: the search leaves it out, and the model lacks it."""
    row = hide_in_halves(1_356_142)
    assert row["named"] == ["compression"]
    assert row["after"] < row["before"]
