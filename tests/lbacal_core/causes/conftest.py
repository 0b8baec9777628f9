"""Conditions that show every cause, and the chain of two classes under them."""

from functools import partial

import numpy as np
import pytest

from lbacal_core.causes.cause import Conditions
from lbacal_core.instrument.chain import ChainTerms


@pytest.fixture(scope="module")
def conditions() -> Conditions:
    rng = np.random.default_rng(1)
    frequency = np.arange(30.0, 81.0)
    events = 200
    time_unix = np.sort(1.39e9 + rng.uniform(0, 3.2e7, events))
    lst = rng.uniform(0, 24, events)
    rain = np.where(rng.random(events) < 0.2, rng.exponential(2.0, events), 0.0)

    def sky_at(hours):
        relative = (frequency / 55.0) ** -0.5
        phases = (0.0, 1.2)
        return np.stack([(1 + 0.3 * np.sin(np.pi * hours / 12 + p))[:, None] * relative for p in phases])

    def ratio(phase, amount):
        return 1.0 + amount * 0.1 * np.sin(np.outer(lst, np.ones(51)) + phase) * np.ones((2, 1, 1))

    sky = sky_at(lst)
    keys = ("dipole_azimuth", "zenith_weighting", "pattern_width", "Cas A", "Cyg A", "Tau A", "Vir A")
    return Conditions(
        frequency_mhz=frequency,
        time_unix=time_unix,
        lst_hours=lst,
        utc_hours=(time_unix / 3600) % 24,
        sun_altitude=rng.uniform(-1, 1, events),
        sun_azimuth=rng.uniform(0, 6, events),
        covariates={"temperature_c": 10 + 8 * rng.standard_normal(events), "rain_mm_h": rain},
        dipoles=["X", "Y"],
        cables=["80", "80"],
        mean_sky=sky.mean(axis=1),
        sky_of={"X": sky[0], "Y": sky[1]},
        sky_at=sky_at,
        antenna_gain=0.01 + 1 / (1 + ((frequency - 58) / 4) ** 2),
        receiver_gain=1.1 / (1 + np.exp((frequency - 78) / 2)),
        cable_log_loss=np.stack([-0.12 * np.sqrt(frequency)] * 2),
        sky_ratio={key: partial(ratio, k) for k, key in enumerate(keys)},
        sun_response=np.ones((2, events, 51)),
        known_noise=0.4,
    )


@pytest.fixture(scope="module")
def terms(conditions) -> ChainTerms:
    front = (conditions.antenna_gain * conditions.receiver_gain * 1000)[None, None, :]
    return ChainTerms(
        sky=conditions.sky_at(conditions.lst_hours),
        n_lna=np.array(0.2),
        front=front,
        receiver_noise=5.0 * conditions.receiver_gain,
        adc_noise=np.array(3.0),
    )
