from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.station import (
    BAND_SPREAD,
    SHARE,
    SHARE_SPREAD,
    AnyReceiver,
    AuditedStation,
    Seen,
    SeriesLikelihood,
    make_series,
)


def draw_sky(likelihood: SeriesLikelihood, seed: int) -> Seen:
    """Some change of the sky with time in every band, and three models that differ in it."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * likelihood.series.lst_hours / 24
    shape = likelihood.series.power.shape[:2]
    change = 0.2 * np.cos(angle - rng.uniform(0, 6, (*shape, 1)))
    return Seen(change, 0.02 * np.cos(angle - rng.uniform(0, 6, (3, *shape, 1))))


def test_series_has_mean_one_and_keeps_the_order_of_instants(station: AuditedStation) -> None:
    series = make_series(station, np.arange(6))
    np.testing.assert_allclose(series.power.mean(axis=-1), 1.0)
    np.testing.assert_allclose(series.lst_hours, station.lst_hours)


def test_likelihood_is_that_of_the_dense_normal_distribution(station: AuditedStation) -> None:
    likelihood = SeriesLikelihood(make_series(station, np.arange(6)))
    covariance = likelihood.covariance
    values = likelihood.series.power.ravel() - 1.0

    def dense(seen: Seen) -> float:
        change = seen.change.reshape(8, -1)
        columns = np.zeros((values.size, 8))
        for k in range(8):
            columns[k * change.shape[1] : (k + 1) * change.shape[1], k] = change[k]
        whole = covariance + columns @ (BAND_SPREAD**2 * np.eye(8) + SHARE_SPREAD**2) @ columns.T
        differences = SHARE * (seen.differences * likelihood.follows.reshape(2, 4, 1)).reshape(3, -1).T
        whole += differences @ differences.T
        rest = values - SHARE * columns.sum(axis=1)
        return float(-rest @ np.linalg.solve(whole, rest) / 2 - np.linalg.slogdet(whole)[1] / 2)

    one, other = draw_sky(likelihood, 1), draw_sky(likelihood, 2)
    expected = dense(one) - dense(other)
    assert likelihood.log_likelihood(one) - likelihood.log_likelihood(other) == pytest.approx(expected, rel=1e-6)


def test_bands_follow_the_common_change_by_their_share_of_the_sky(station: AuditedStation) -> None:
    series = make_series(station, np.arange(6))
    power = series.power.copy()
    power[:, 3] = 1.0 + 0.5 * (power[:, 0] - 1.0)
    follows = SeriesLikelihood(replace(series, power=power)).follows.reshape(2, 4)
    np.testing.assert_allclose(follows[:, 3], 0.5 * follows[:, 0])


def test_share_of_the_sky_is_found_beside_what_models_differ_by(station: AuditedStation) -> None:
    likelihood = SeriesLikelihood(make_series(station, np.arange(6)))
    sky = draw_sky(likelihood, 3)
    seen = 0.4 * sky.change + SHARE * sky.differences[1] * likelihood.follows.reshape(2, 4, 1)
    likelihood.rest = likelihood.whiten @ seen.ravel()
    assert likelihood.share(sky)[0] == pytest.approx(0.4, abs=0.01)


def test_an_instant_in_which_one_band_departs_is_noise(station: AuditedStation) -> None:
    quiet = make_series(station, np.arange(6)).noise
    power = station.power.copy()
    power[..., :13] *= np.random.default_rng(1).normal(1.0, 0.03, (station.power.shape[2], 1))
    noise = make_series(replace(station, power=power), np.arange(6)).noise
    assert noise[:, 0].min() > 0.01 > quiet.max()


def test_a_receiver_whose_colour_changes_is_described_and_another_sky_is_not(station: AuditedStation) -> None:
    series = make_series(station, np.arange(6))
    sky = draw_sky(SeriesLikelihood(series), 4)
    drift = 0.03 * np.cos(4 * np.pi / 24 * series.lst_hours) * np.array([-1.0, -0.3, 0.3, 1.0])[:, None]
    seen = replace(series, power=1.0 + SHARE * sky.change + drift)
    gain = [one.log_likelihood(sky) for one in (AnyReceiver(seen, 6), SeriesLikelihood(seen))]
    assert gain[0] > gain[1] + 50
    assert AnyReceiver(seen, 6).fits(sky)
    noisy = replace(seen, power=seen.power + np.random.default_rng(1).normal(0.0, 0.1, seen.power.shape))
    assert not AnyReceiver(noisy, 6).fits(sky)
