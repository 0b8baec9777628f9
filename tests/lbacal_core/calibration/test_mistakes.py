from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.calibration import fit
from lbacal_core.calibration.chain_test import LARGEST_GAIN, UNDESCRIBED, Tried, describe_mistakes, name_mistakes
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.instrument.antennas import GainProvenance
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.instrument.stages import Stage
from lbacal_core.simulation.prior import Mistake, list_mistakes, list_other_antennas, sky_prior
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.differences import LST_HOURS
from lbacal_core.sky.power import compute_sky_power
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

LOFAR = load_instrument("lofar-superterp")
HALF_HOURS = np.arange(48) / 2.0


@pytest.fixture(scope="module")
def power():
    return compute_sky_power(LOFAR, lst_hours=HALF_HOURS).power


@pytest.fixture(scope="module")
def mistakes(power):
    return {one.name: one for one in list_mistakes(LOFAR, power, HALF_HOURS)}


def test_each_mistake_leads_to_what_p_sky_would_be_without_it(power, mistakes):
    exchanged = mistakes["dipoles X and Y exchanged"]
    assert power["X"] * np.exp(exchanged.change["X"]) == pytest.approx(power["Y"])
    # local summer time taken for UTC: the sky is what it was two hours before
    late = mistakes["times 2 h too late"]
    assert (power["Y"] * np.exp(late.change["Y"]))[4:] == pytest.approx(power["Y"][:-4])


def test_of_another_antenna_the_data_show_its_form_along_lst_and_not_its_level(mistakes):
    other = mistakes["the antenna is like short-dipole"]
    assert other.antenna == "short-dipole"
    assert other.change["X"].mean(axis=0)[-1] == pytest.approx(0.83, abs=0.02)
    assert np.abs(other.shown("X").mean(axis=0)).max() < 1e-12
    assert "the antenna is like hamaker" not in mistakes


def test_an_instrument_with_one_arm_has_no_letters_to_exchange():
    one_arm = replace(LOFAR, dipole_azimuth_deg={"A": 20.0}, antenna="short-dipole", gain_provenance=None)
    power = compute_sky_power(one_arm, lst_hours=HALF_HOURS).power
    names = [one.name for one in list_mistakes(one_arm, power, HALF_HOURS)]
    assert not any("exchanged" in name for name in names)
    assert "the antenna is like hamaker" in names
    assert "the antenna is like short-dipole" not in names


def test_a_receiver_of_little_noise_does_not_show_another_antenna_by_the_gains_of_its_events(monkeypatch):
    """What P_sky does to lines was taken at measured slopes, whose noise is that of the lines: gains of 5 to 10."""
    one = np.ones(LOFAR.frequency_mhz.size)
    stages = (
        Stage("lna", "lna", gain=10.0 * one, noise_k=150.0 * one, error_k=15.0),
        Stage("coax", "cable"),
        Stage("filter", "filter", gain=LOFAR.receiver_gain),
        Stage("amplifier", "amplifier", gain=one, is_free=True),
        Stage("adc", "adc", is_free=True),
    )
    absolute = replace(
        LOFAR, stages=stages, kelvin_error=0.01, gain_provenance=GainProvenance("absolute", "a test"),
        antennas=[record for record in LOFAR.antennas if record.station == "CS002"],
    )  # fmt: skip
    simulation, tried = Simulation(absolute), []

    def keep(found, mistakes):
        at = [mistake.name for mistake in mistakes].index("the antenna is like quarter-wave")
        tried.extend(gain[at] for _, (gain, _) in found)
        return name_mistakes(found, mistakes)

    monkeypatch.setattr(fit, "name_mistakes", keep)
    settings = TwinSettings(events_per_year=300, antennas=4, stations=("CS002",))
    campaign = simulate_campaign(settings, absolute, simulation.sky_power, np.random.default_rng(1))
    report = fit.fit_calibration(campaign.spectra, simulation)
    assert len(tried) == 8
    assert np.mean(tried) < 0.0
    assert np.max(tried) < 2.0
    assert {curve.status for curve in report.curves} == {"converged"}


def curve(antenna, dipole):
    return CalibrationCurve(
        "CS002", antenna, dipole, "too_few_events", 3, np.array([50.0]), None, None, None, None, 0.1, {}
    )


def test_the_dipoles_of_an_antenna_share_a_mistake():
    mistakes = [Mistake(name, {}) for name in ("a", "b")]
    half, both = np.array([-5.0, 0.6 * LARGEST_GAIN]), np.array([True, True])
    gains = {(1, "X"): half, (1, "Y"): half, (2, "X"): half, (3, "X"): 3 * half[::-1]}
    found = [(curve(*path), Tried(gain, both)) for path, gain in gains.items()]
    mistaken = name_mistakes(found, mistakes)
    assert mistaken == {("CS002", 1): "b", ("CS002", 3): "a"}
    # the best mistake must describe the data of both dipoles: a wave along LST was named another antenna
    found[1] = (found[1][0], Tried(half, np.array([True, False])))
    assert name_mistakes(found, mistakes) == {("CS002", 1): UNDESCRIBED, ("CS002", 3): "a"}
    assert describe_mistakes({**mistaken, ("CS002", 4): "b"}) == "b (CS002 antenna 1 and 1 more); a (CS002 antenna 3)"


def test_dipoles_of_all_heights_are_tried_and_not_one():
    """One height stood for all: a dipole 0.1 m lower passed for LOFAR's antenna, and C was off by 0.35."""
    own = compute_sky_power(LOFAR, lst_hours=LST_HOURS).power
    others = {one.name: one.change for one in list_other_antennas(LOFAR, own, LST_HOURS)}
    assert "hamaker" not in others
    assert "quarter-wave" in others
    of_dipoles = [change["X"] for name, change in others.items() if name.startswith("a short dipole")]
    levels = np.array([change.mean(axis=0)[-1] for change in of_dipoles])
    # from less power than LOFAR's antenna gets, relative to the zenith, to ten times as much
    assert levels[0] < 0.0
    assert levels[-1] > 2.0
    assert np.all(np.diff(levels) > 0.0)
    # any height between 0.6 and 1.7 m is near one of them
    for height in (0.66, 1.01, 1.37, 1.61):
        true = compute_sky_power(LOFAR, antenna=ShortDipole(height), lst_hours=LST_HOURS).power["X"] / own["X"]
        # between neighbours that differ by 0.8 at 80 MHz
        assert min(np.abs(np.log(true) - change).max() for change in of_dipoles) < 0.4


def test_an_instrument_elsewhere_is_asked_for_other_heights_and_for_the_lba():
    dipole = replace(LOFAR, antenna="short-dipole", gain_provenance=None)
    own = compute_sky_power(dipole, lst_hours=LST_HOURS).power
    others = list_other_antennas(dipole, own, LST_HOURS)
    names = [one.name for one in others]
    assert names[:2] == ["hamaker", "quarter-wave"]
    assert [one.share for one in others[:2]] == pytest.approx([1 / 3, 1 / 3])
    assert sum(one.share for one in others) == pytest.approx(1.0)
    assert len(names) > 10
    assert "a short dipole at 1.43 m" in names


def test_heights_follow_the_band():
    low = replace(
        LOFAR,
        frequency_mhz=LOFAR.frequency_mhz[:20],
        **{name: getattr(LOFAR, name)[:20] for name in ("antenna_gain", "receiver_gain")},
        cables={name: loss[:20] for name, loss in LOFAR.cables.items()},
        gain_provenance=None,
    )
    own = compute_sky_power(low, lst_hours=LST_HOURS).power
    names = [one.name for one in list_other_antennas(low, own, LST_HOURS)]
    assert names[-1] == "a short dipole at 2.92 m"
    assert pytest.approx(3.0, abs=0.01) == 2 * np.pi * 49e6 * 2.92 / 299792458.0


@pytest.mark.parametrize("name", ["gsm408", "lfsm", "haslam", "maeda"])
def test_another_sky_is_about_one_standard_deviation_away(name):
    freedom, own = sky_prior(LOFAR), compute_sky_power(LOFAR, lst_hours=LST_HOURS)
    other = compute_sky_power(LOFAR, sky=name, lst_hours=LST_HOURS)
    for dipole, modes in freedom.modes.items():
        change = np.log(other.power[dipole] / own.power[dipole]).ravel()
        flat = modes.reshape(len(modes), -1)
        # the most probable amplitudes for a change that is known to 0.3 %
        amplitude = np.linalg.solve(flat @ flat.T + 0.003**2 * np.eye(len(flat)), flat @ change)
        assert np.sum(amplitude**2) < 3.0
        assert np.sqrt(np.mean((change - amplitude @ flat) ** 2)) < 0.002


def test_the_digest_names_what_it_was_made_from():
    elsewhere = replace(LOFAR, latitude_deg=40.0)
    assert sky_prior(LOFAR).digest == sky_prior(LOFAR).digest
    assert sky_prior(LOFAR).digest != sky_prior(elsewhere).digest
