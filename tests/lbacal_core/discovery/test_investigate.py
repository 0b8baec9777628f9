import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lbacal_core.causes.model import Model
from lbacal_core.discovery.hypothesis import Hypothesis
from lbacal_core.discovery.report import investigate
from lbacal_core.discovery.search import _adds_beside
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainDrift, GainStep
from lbacal_twin.faults.uncatalogued import WorkingWeek
from tests.lbacal_core.discovery.conftest import SEED, SETTINGS


def test_a_clean_station_is_consistent_and_says_what_it_could_never_show(clean, simulation):
    report, _ = investigate(clean, simulation)
    assert report["verdict"] == "consistent"
    assert report["findings"] == []
    assert report["unexplained"] is None
    assert "missing_noise" in {one["cause"] for one in report["unidentifiable"]}
    json.dumps(report, allow_nan=False)


PARTS = {
    "one path": lambda spectra: spectra.select((spectra.antenna == 2) & (spectra.dipole == "X")),
    "one antenna": lambda spectra: spectra.select(spectra.antenna == 2),
    "one dipole": lambda spectra: spectra.select(spectra.dipole == "X"),
    "no weather": lambda spectra: replace(spectra, environment={}),
}


@pytest.mark.long
@pytest.mark.parametrize("part", PARTS)
def test_data_with_little_to_compare_are_asked_what_they_can_show(part, clean, simulation):
    report, _ = investigate(PARTS[part](clean), simulation)
    assert report["verdict"] == "consistent"
    impossible = {one["cause"] for one in report["unidentifiable"]}
    assert ("gain_temperature" in impossible) == (part == "no weather")
    assert ("cable_length" in impossible) == (part in ("one path", "one antenna"))
    json.dumps(report, allow_nan=False)


@pytest.mark.long
def test_a_gain_step_of_one_path_is_named_with_its_date_size_and_antenna(spoil, simulation):
    step = GainStep(size=0.05, where=Where(antennas=(2,), dipoles=("Y",)), date="2014-08-07")
    spectra = spoil(step)
    report, _ = investigate(spectra, simulation)
    assert report["verdict"] == "explained"
    (finding,) = report["findings"]
    assert finding["cause"] == "gain_step"
    assert finding["where"]["antennas"] == [2]
    assert finding["where"]["dipoles"] == ["Y"]
    assert abs(finding["size"]["value"] - 0.05) < 3 * finding["size"]["sigma"]
    found = np.datetime64(finding["parameters"]["date"].rstrip("Z"))
    assert abs(found - np.datetime64("2014-08-07")) < np.timedelta64(25, "D")
    assert finding["gain"]["held_out_log_likelihood_gain"] > 0
    assert finding["gain"]["chi2_after"] < finding["gain"]["chi2_before"]


@pytest.mark.long
def test_exchanged_letters_are_a_dipole_swap_of_one(clean, simulation):
    letters = np.where(clean.dipole == "X", "Y", "X")
    report, _ = investigate(replace(clean, dipole=letters), simulation)
    named = {finding["cause"]: finding for finding in report["findings"]}
    assert "dipole_swap" in named
    size = named["dipole_swap"]["size"]
    assert abs(size["value"] - 1.0) < 4 * size["sigma"]


@pytest.mark.long
def test_a_weekly_rhythm_is_unexplained_and_lives_along_the_date(spoil, simulation):
    report, _ = investigate(spoil(WorkingWeek(size=0.05)), simulation)
    assert report["verdict"] == "unexplained"
    assert report["unexplained"]["where"]["axis"].startswith("date")
    assert report["unexplained"]["where"]["target"] == "station"


def test_what_follows_a_column_that_nobody_knows_is_reported_along_it_by_its_name(clean, simulation):
    """A gain that falls off on either side of the middle of `humidity`, as no cause and no other axis does."""
    events, event = np.unique(clean.event_id, return_inverse=True)
    humidity = np.random.default_rng(5).uniform(0.0, 1.0, events.size)[event]
    power = clean.power * (1.0 - 0.25 * (humidity - 0.5) ** 2)[:, None]
    spectra = replace(clean, power=power, environment={**clean.environment, "humidity": humidity})
    report, _ = investigate(spectra, simulation)
    assert report["verdict"] == "unexplained"
    assert report["findings"] == []
    assert report["unexplained"]["where"]["axis"] == "humidity"
    assert report["unexplained"]["where"]["target"] == "station"
    json.dumps(report, allow_nan=False)


@pytest.mark.long
@pytest.mark.parametrize("is_known", [True, False])
def test_what_no_cause_explains_in_one_antenna_hides_nothing_in_another(is_known, clean, spoil, simulation):
    """A drift of 38 sigma was withdrawn beside two months of half the power in another antenna; a gain that followed
    the temperature of hours before was told nowhere."""
    spectra = spoil(GainDrift(size=-0.1, where=Where(antennas=(5,)))) if is_known else clean
    days = (clean.time_unix - clean.time_unix.min()) / 86400.0
    is_down = (clean.antenna == 3) & (clean.dipole == "X") & (days > 100) & (days < 160)
    humidity = np.random.default_rng(5).uniform(-1.0, 1.0, 1 + int(days.max()))[days.astype(int)]
    unknown = np.where((clean.antenna == 5) & (not is_known), 1.0 + 0.2 * humidity**2, 1.0)
    power = spectra.power * (np.where(is_down, 0.5, 1.0) * unknown)[:, None]
    environment = {**clean.environment, "humidity": humidity}
    report, _ = investigate(replace(spectra, power=power, environment=environment), simulation)
    left = report["unexplained"]
    assert left["where"]["target"] == "antenna 3 X"
    named = [(one["cause"], one["evidence"]["target"]) for one in report["findings"]]
    assert named == [("gain_drift", "antenna 5")] * is_known
    assert ("in_others" in left) != is_known
    if not is_known:
        assert left["in_others"]["where"]["target"].startswith("antenna 5")
        assert left["in_others"]["where"]["axis"] == "humidity"


@pytest.mark.long
def test_an_antenna_that_echoes_since_a_date_is_no_measure_of_others_and_no_finding_beside_the_echo(clean, simulation):
    """Of three antennas with one cable the second had a reflection: the mean of the others held the third's echo.

    In another world it was the noise of the digitiser and a line of interference beside the sentence that said it all.
    """
    days = (clean.time_unix - clean.time_unix.min()) / 86400.0
    echo = 1.0 + 0.25 * np.cos(2.0 * np.pi * (clean.frequency_mhz - 40.0) / 11.0)
    echoes = (clean.antenna == 5) & (days > 280)
    report, (found,) = investigate(replace(clean, power=clean.power * np.where(echoes[:, None], echo, 1.0)), simulation)
    assert report["findings"] == []
    assert "antenna 5, " in report["unexplained"]["in_words"]
    (score,) = [
        one for one in found.scores if (one.cause.identifier, one.target.label) == ("adc_noise_step", "antenna 5")
    ]
    size = 1.0 if score.z > 0 else -0.5
    said = SimpleNamespace(hypothesis=Hypothesis(score.cause, score.template, score.target, size), score=score)
    assert _adds_beside(said, [], found)
    assert not _adds_beside(said, [found.description.sentences[0].hypothesis], found)


@pytest.mark.long
def test_a_gain_step_of_one_board_is_named_for_its_group(spoil, chain, sky):
    board = (1, 2, 6)
    records = [replace(r, group="board 2" if r.antenna in board else "board 1") for r in chain.antennas]
    step = GainStep(size=0.03, where=Where(antennas=board), date="2014-08-07")
    report, _ = investigate(spoil(step), Simulation(replace(chain, antennas=records), sky))
    assert report["verdict"] == "explained"
    (finding,) = report["findings"]
    assert finding["cause"] == "gain_step"
    assert finding["where"]["antennas"] == sorted(board)
    assert finding["where"]["dipoles"] == ["X", "Y"]
    assert finding["evidence"]["target"] == "group board 2"
    assert "group board 2" in finding["sentence"]
    assert abs(finding["size"]["value"] - 0.03) < 3 * finding["size"]["sigma"]


@pytest.mark.long
def test_a_flat_receiver_ended_in_a_traceback_and_its_step_is_named(chain, sky):
    """All ones: the normal matrix of the noise constants was singular, scores were NaN, no report was written."""
    step = GainStep(size=0.05, where=Where(antennas=(2,), dipoles=("Y",)), date="2014-08-07")
    flat = replace(chain, receiver_gain=np.ones_like(chain.receiver_gain))
    spectra = simulate_campaign(SETTINGS, flat, sky, np.random.default_rng(SEED), [step]).spectra
    report, _ = investigate(spectra, Simulation(flat, sky))
    assert report["verdict"] == "explained"
    assert [finding["cause"] for finding in report["findings"]] == ["gain_step"]
    assert "filter_shift" in {one["cause"] for one in report["unidentifiable"]}
    json.dumps(report, allow_nan=False)


def investigate_under(sky, world, *faults):
    """Spectra under another sky than the own, which may be wrong as models differ."""
    return investigate(replace(world, sky=sky).spectra(*faults), replace(world.simulation, is_own_sky=True))[0]


@pytest.fixture(scope="module")
def other_sky(world):
    """The Low Frequency Sky Model: 15 % more power at 55 MHz, and another slope along frequency."""
    return compute_sky_power(world.instrument, "lfsm")


@pytest.mark.long
def test_the_level_of_another_sky_was_named_a_slope_of_the_noise_of_the_lna(world, other_sky):
    """The mean over LST of model differences was dropped, because A(nu) describes it; A multiplies N_LNA too."""
    level = {d: np.mean(other_sky.power[d] / world.sky.power[d], axis=0) for d in "XY"}
    only_level = replace(world.sky, power={d: world.sky.power[d] * level[d] for d in "XY"})
    for sky in (other_sky, only_level):
        report = investigate_under(sky, world)
        assert report["verdict"] == "consistent"


@pytest.mark.long
def test_what_sky_models_hide_is_listed_with_the_share_that_is_left(world):
    report = investigate_under(world.sky, world)
    reasons = {one["cause"]: one["why"] for one in report["unidentifiable"]}
    assert {"lna_noise_slope", "isotropic_level"} <= reasons.keys()
    assert "of its information is left" in reasons["lna_noise_slope"]
    assert not {"dipole_swap", "zenith_weighting", "point_source", "gain_step"} & reasons.keys()
    assert not {"lna_noise_slope", "isotropic_level"} & {
        score["cause"] for scores in report["scores"].values() for score in scores
    }
    # What the noise takes of them was a share of rounding errors, once -0.16.
    for noise in report["noise"].values():
        assert not {"lna_noise_slope", "isotropic_level"} & noise["taken"].keys()
        assert all(-1e-6 < share < 1 for share in noise["taken"].values())


def test_a_sky_power_at_its_word_hides_nothing(world):
    report, _ = investigate(world.spectra(), world.simulation)
    assert not {"lna_noise_slope", "isotropic_level"} & {one["cause"] for one in report["unidentifiable"]}


@pytest.mark.long
def test_a_gain_step_keeps_its_significance_under_another_sky(world, other_sky):
    step = GainStep(size=0.03, date="2014-07-01", where=Where(antennas=(1,)))
    told, _ = investigate(world.spectra(step), world.simulation)
    own = investigate_under(other_sky, world, step)
    (one,), (other,) = told["findings"], own["findings"]
    assert one["cause"] == other["cause"] == "gain_step"
    assert other["significance_sigma"] == pytest.approx(one["significance_sigma"], rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("harmonic", [1, 2, 3])
def test_a_wave_of_the_sky_that_no_model_has_gets_no_name(world, other_sky, harmonic):
    """It was named: a pattern that is too wide, a source, a line at the end of the band.

    Paths with long cables show less of the sky, and what of a wrong sky their deviations from the mean show had the
    form of a cause.
    """
    phase = 2 * np.pi * harmonic * other_sky.lst_hours / 24
    factor = 1 + 0.04 * np.cos(phase)[:, None] * np.linspace(1.2, 0.8, 51)
    sky = replace(other_sky, power={d: power * factor for d, power in other_sky.power.items()})
    report = investigate_under(sky, world)
    assert report["findings"] == []
    assert report["unexplained"] is None


@pytest.mark.long
@pytest.mark.parametrize("is_own_sky", [True, False])
def test_a_step_beside_a_wave_of_the_sky_is_named_with_its_size(world, is_own_sky):
    """Its size was 8 sigma off: with the wave a part of the step had been taken out of the data."""
    step = GainStep(size=0.03, date="2014-07-01", where=Where(antennas=(1,)))
    harmonics = [np.cos(2 * np.pi * (k * world.sky.lst_hours / 24 + 0.1 * k)) for k in (1, 2, 3)]
    factor = 1 + 0.03 * (2 / 3) ** 0.5 * np.sum(harmonics, axis=0)[:, None]
    sky = replace(world.sky, power={d: power * factor for d, power in world.sky.power.items()})
    simulation = replace(world.simulation, is_own_sky=is_own_sky)
    report, _ = investigate(replace(world, sky=sky).spectra(step), simulation)
    (found,) = report["findings"]
    assert (found["cause"], found["evidence"]["target"]) == ("gain_step", "antenna 1")
    assert abs(found["size"]["value"] - 0.03) < 3 * found["size"]["sigma"]
    assert (report["unexplained"] is None) == is_own_sky


@pytest.mark.long
@pytest.mark.parametrize("turn", [-35.0, 50.0])
def test_one_arm_that_the_audit_calls_turned_was_consistent_or_both_arms_turned_by_half(world, turn):
    arms = world.instrument.dipole_azimuth_deg
    truly = replace(world.instrument, dipole_azimuth_deg={**arms, "Y": arms["Y"] + turn})
    report = investigate_under(compute_sky_power(truly, antenna=world.instrument.antenna), world)
    assert report["verdict"] == "explained"
    (finding,) = report["findings"]
    assert (finding["cause"], finding["evidence"]["of_record"]) == ("dipole_azimuth", True)
    assert finding["where"]["dipoles"] == ["Y"]
    assert "the arm of Y alone is turned" in finding["sentence"]
    assert abs(finding["size"]["value"] - turn) < 3 * finding["size"]["sigma"]


@pytest.mark.long
@pytest.mark.parametrize("is_own_sky", [True, False])
@pytest.mark.parametrize("dipoles", [("X",), ("X", "Y")])
def test_a_step_of_one_dipole_of_all_antennas_was_a_drift_and_a_step_back_of_the_other(world, is_own_sky, dipoles):
    """No target had the paths: the station got a name, and each Y, which had not changed, another one."""
    spectra = world.spectra(GainStep(size=0.15, date="2014-07-01", where=Where(dipoles=dipoles)))
    known = replace(world.simulation, is_own_sky=is_own_sky)
    report, _ = investigate(spectra, known)
    (found,) = report["findings"]
    assert (found["cause"], found["where"]["dipoles"], report["verdict"]) == ("gain_step", [*dipoles], "explained")
    assert ("dipole X of all antennas" in found["sentence"]) == (dipoles == ("X",))
    assert abs(found["size"]["value"] - 0.15) < 3 * found["size"]["sigma"]
    adopted = Model.from_report(json.loads(json.dumps(report)))
    assert investigate(spectra, known.with_causes(adopted))[0]["verdict"] == "consistent"
