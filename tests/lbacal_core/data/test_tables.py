import numpy as np
import pytest

from lbacal_core.data.tables import read_prior
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.differences import LST_HOURS, SMALLEST_WAVE, waves_at


def test_every_number_has_a_source_and_is_read_by_the_product(repository):
    text = "".join(path.read_text() for path in sorted((repository / "lbacal_core").rglob("*.py")))
    for name, row in read_prior().items():
        assert len(row.of) > 0
        assert len(row.source) > 0
        assert all(size > 0 for size in row.sizes)
        assert f'"{name}"' in text, f"{name} is read by nothing"
    assert read_prior()["zenith_gain"].size == 0.1
    with pytest.raises(ValueError, match="unpack"):
        _ = read_prior()["waves"].size


def test_the_chain_test_frees_the_sky_as_the_search_does_with_waves_of_half_the_size():
    """A fit allowed a slope of 0.3 %, an investigation 0.8 %: data were converged, a misfit and unexplained."""
    simulation = Simulation(load_instrument("lofar-superterp"))
    differences, modes = simulation.differences, simulation.prior.modes["X"]
    searched = [one.changes for one in waves_at(simulation.instrument.frequency_mhz, LST_HOURS, is_search=True)]
    freed = np.concatenate([differences.shape["X"], 0.5 * searched[0], 0.5 * searched[1]])
    flat = modes.reshape(len(modes), -1)
    # a wave below 3e-4 is left out of either
    for change in freed[np.abs(freed).max(axis=(1, 2)) >= SMALLEST_WAVE]:
        assert np.min(np.abs(flat - change.ravel()).max(axis=1)) < 1e-12
    level = differences.level_modes()
    assert all(np.any(np.all(np.isclose(modes[:, 0], one), axis=1)) for one in level)


@pytest.mark.shared
def test_surveys_of_a_published_sky_depart_by_what_the_prior_says(shared):
    """The contrast of LFSM at each survey, over a horizontal plane, against the line between those beside it."""
    row, sky = read_prior()["survey_contrast"], np.load(shared / "data/sky/lfsm-5.1deg.npz")
    at = np.flatnonzero(np.isin(sky["freqs"], row.at_mhz))
    brightness, angle = sky["maps"] @ sky["comps"][at].T, np.arange(24)[:, None] * np.pi / 12 - sky["ra"]
    latitude, dec = np.radians(52.9), sky["dec"]
    up = np.maximum(np.sin(latitude) * np.sin(dec) + np.cos(latitude) * np.cos(dec) * np.cos(angle), 0.0)
    course = np.log(up @ brightness)
    course -= course.mean(axis=0)
    typical = course.mean(axis=1)
    contrast = typical @ course / (typical @ typical)
    between = [
        np.interp(row.at_mhz[k], row.at_mhz[k - 1 : k + 2 : 2], contrast[k - 1 : k + 2 : 2]) for k in range(1, 5)
    ]
    departure = contrast[1:-1] / between - 1.0
    np.testing.assert_allclose(departure, [-0.10, 0.03, 0.02, -0.02], atol=0.006)
    np.testing.assert_allclose(row.sizes, np.sqrt(np.mean(departure**2)), rtol=0.15)
