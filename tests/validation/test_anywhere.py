"""A small instance of `./dev prove anywhere`: drawn instruments are calibrated with the truth inside the errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.sky.power import compute_sky_power
from lbacal_twin.campaign import DrawnStation, draw_stations, expected_power
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainStep
from lbacal_twin.settings import TwinSettings
from validation.anywhere import WHAT, calibrate_drawn, draw_instrument, ideal_snr, investigate_drawn
from validation.machinery.parts import Row
from validation.machinery.records import claims_of, verdicts_of


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return [calibrate_drawn(seed) for seed in range(12)]


def test_curves_of_drawn_instruments_have_an_answer_with_the_truth_inside_its_errors(rows: list[Row]) -> None:
    assert {row["chain"] for row in rows} == {"flat", "shaped", "stages"}
    assert {row["arms"] for row in rows} == {1, 2, 3}
    statuses = [status for row in rows for status in row["statuses"]]
    # a curve that has no answer says so
    assert np.mean(np.array(statuses) == "converged") > 0.8
    pulls = np.concatenate([row["pulls"] for row in rows])
    assert np.abs(pulls).max() < 4.0
    # curves of a station share the gains of its events
    assert np.sqrt(np.mean(np.square(pulls))) < 1.5


def test_noise_constants_that_are_told_apart_have_the_truth_inside_their_errors(rows: list[Row]) -> None:
    pulls = np.concatenate([row["constants"] for row in rows])
    assert np.mean(np.abs(pulls) < 2.0) > 0.9
    assert np.abs(pulls).max() < 4.0


def test_constants_of_a_flat_receiver_are_merged(rows: list[Row]) -> None:
    flat = [row for row in rows if row["chain"] == "flat"]
    assert all(row["merged"] == len(row["pulls"]) for row in flat)


def test_the_judgement_refutes_errors_that_are_too_small(rows: list[Row]) -> None:
    boasting = [{**row, "pulls": [5.0 for _ in row["pulls"]], "merged": 0} for row in rows]
    verdicts = verdicts_of("anywhere", "chains", boasting)
    assert {key for key, verdict in verdicts.items() if verdict == "refuted"} >= {"stages_pulls", "flat_merged"}


def test_an_investigation_names_what_is_planted_with_its_size_and_nothing_where_nothing_is() -> None:
    rows = [investigate_drawn(seed) for seed in (600002, 600003, 600004, 600005)]
    assert [row["kind"] for row in rows] == ["nothing", "lst_offset", "nothing", "gain_step"]
    assert [row["named"] for row in rows] == [False, True, False, True]
    assert [row["others"] for row in rows] == [0, 0, 0, 0]
    assert all(abs(pull) < 3.0 for row in rows for pull in row["pulls"])
    boasting = [{**row, "named": False, "others": 1, "pulls": [], "snr": 12.0} for row in rows * 10]
    verdicts = verdicts_of("anywhere", "investigations", boasting)
    assert {key for key, verdict in verdicts.items() if verdict == "refuted"} == {
        "false",
        *(f"{k}_named" for k in WHAT),
    }
    assert set(verdicts.values()) == {"refuted", "measured"}


def test_an_effect_below_the_noise_is_asked_by_its_ideal_snr_and_still_counted() -> None:
    """A step of 10 % was to be named in 90 % of drawn instruments, of which half see it at less than six sigma."""
    seen = {"kind": "gain_step", "chain": "flat", "merged": False, "pulls": [], "others": 0}
    rows = [{**seen, "snr": snr, "named": snr > 6.0} for snr in np.linspace(2.0, 18.0, 160)]
    asked = claims_of("anywhere", "investigations", [*rows, {**rows[0], "kind": "lst_offset"}])
    claims = {claim.key: claim for claim in asked}
    assert (claims["gain_step_named"].found, claims["gain_step_named"].verdict) == (1.0, "shown")
    assert claims["gain_step_at_any_snr"].found == 0.75
    assert claims["gain_step_snr_50"].found == pytest.approx(6.0, abs=0.3)


SETTINGS = TwinSettings(events_per_year=40)
STEP = GainStep(size=0.1, where=Where(antennas=(1,)), date="2014-07-01")


@pytest.fixture(scope="module")
def station() -> DrawnStation:
    """Two antennas with few channels."""
    drawn = draw_instrument(np.random.default_rng(5))
    channels = np.arange(0, drawn.frequency_mhz.size, drawn.frequency_mhz.size // 6)
    few = replace(
        drawn,
        frequency_mhz=drawn.frequency_mhz[channels],
        antenna_gain=drawn.antenna_gain[channels],
        receiver_gain=drawn.receiver_gain[channels],
        cables={"long": drawn.cables["long"][channels]},
        antennas=tuple(AntennaRecord("S1", number, "long") for number in range(2)),
        stages=(),
    )
    rng = np.random.default_rng(6)
    return draw_stations(SETTINGS, few, compute_sky_power(few), rng)[0][0]


def test_the_ideal_snr_is_that_of_the_whole_covariance_matrix(station: DrawnStation) -> None:
    """Every event with its full covariance, every free vector written out."""
    power, stages = expected_power(station.stages, station.scene, ()), station.stages
    antennas, dipoles, events, channels = power.shape
    paths = antennas * dipoles
    block = np.kron(np.eye(paths), np.ones((channels, channels)))
    noise = SETTINGS.radiometer**2 * np.eye(paths * channels) + SETTINGS.event_gain_path**2 * block
    inverse = np.linalg.inv(noise + SETTINGS.event_gain_common**2)

    def of_events(values: np.ndarray) -> np.ndarray:
        """Relative change of every spectrum, shape (event, path and channel)."""
        wide = np.broadcast_to(values / power, power.shape).reshape(paths, events, channels)
        return np.moveaxis(wide, 0, 1).reshape(events, -1)

    slope = stages.gain * stages.antenna * stages.cable * stages.receiver
    free = []
    for path in range(paths):
        for parts in ((stages.lna_noise * slope,), (stages.rcu_noise * stages.receiver,), (stages.adc_noise,)):
            is_own = np.repeat(np.arange(paths) == path, channels)
            free.append(of_events(parts[0]) * is_own)
        for channel in range(channels):
            is_own = np.arange(paths * channels) == path * channels + channel
            free.append(of_events((stages.sky + stages.lna_noise) * slope) * is_own)
    template = of_events(expected_power(stages, station.scene, [STEP]) - power)
    weighed = [one @ inverse for one in free]
    normal = np.array([[np.sum(one * other) for other in free] for one in weighed])
    onto = np.array([np.sum(one * template) for one in weighed])
    size = np.sqrt(np.diag(normal))
    solved = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-10, hermitian=True) @ (onto / size)
    expected = np.sum(template @ inverse * template) - solved @ (onto / size)
    assert ideal_snr(station, [STEP], SETTINGS) == pytest.approx(np.sqrt(expected), rel=1e-6)


def test_a_gain_that_never_changes_has_no_snr(station: DrawnStation) -> None:
    """A step before the first event is one more factor on A(nu)."""
    always = replace(STEP, date="2013-01-01")
    assert ideal_snr(station, [always], SETTINGS) < 1e-3
