from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.refit import fit_chain
from lbacal_core.discovery.station import model_modes
from lbacal_core.discovery.view import ChannelTemplates
from lbacal_core.skypower.differences import compute_model_differences


@pytest.fixture(scope="module")
def views(station, world):
    """The means of the paths with a free sky, and the paths of a class: two rows with waves, one row without."""
    model = fit_chain(station).linear
    model = replace(model, modes=model_modes(station, compute_model_differences(world.instrument)))
    return model.common, model.paths[0]


@pytest.mark.parametrize("k", [0, 1])
def test_information_of_the_free_vectors_is_that_of_each_written_out(views, k):
    view = views[k]
    size = view.slope.shape[0] * view.slope.shape[2]
    amounts = np.eye(len(view.prior_information))
    seen = view.see(view.described(amounts[[0, size - 1, size, -1]]))
    direct = view.sum(seen.along, view.weight)
    whole = view.information_of_free(view.weight)
    np.testing.assert_allclose(direct, np.swapaxes(whole[:, [0, size - 1, size, -1]], 0, 1), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(whole, np.swapaxes(whole, 1, 2), rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("k", [0, 1])
def test_templates_in_channels_are_the_same_templates_written_out(views, k):
    view, rng = views[k], np.random.default_rng(1)
    rows, events, channels = view.slope.shape
    spectra, factors = rng.uniform(0.5, 1.0, (rows, events, channels)), rng.standard_normal((3, channels))
    profiles = (np.arange(events) % 5 < np.array([[2], [4]])).astype(float)
    shares = np.vstack([np.eye(rows), np.full((1, rows), 0.5)])
    lines = ChannelTemplates(spectra, np.arange(rows), shares, factors)
    alone = spectra * shares[:, :, None, None] * factors[:, None, None, None]
    seen = view.see(alone)
    for quick, direct in zip(view.inner(lines, profiles), view.inner(seen, profiles), strict=True):
        np.testing.assert_allclose(quick, direct, rtol=1e-6, atol=1e-9 * np.abs(direct).max())
    np.testing.assert_allclose(view.score(lines, profiles), view.score(seen, profiles), rtol=1e-9, atol=1e-9)
