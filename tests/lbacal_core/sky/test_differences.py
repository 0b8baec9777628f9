from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.sky.differences import (
    LST_HOURS,
    DifferenceModels,
    ModelDifferences,
    compute_model_differences,
    model_difference_modes,
    waves_at,
)
from lbacal_core.sky.power import compute_sky_power, vary_sky_power


@pytest.fixture(scope="module")
def differences(chain: Instrument) -> ModelDifferences:
    return compute_model_differences(chain)


def change_of(dipole, other, default):
    """Ln of the power of another sky power over that of the default one, less its mean over LST."""
    change = np.log(other.power[dipole] / default.power[dipole])
    return change - change.mean(axis=0)


def left_by(basis: np.ndarray, change: np.ndarray) -> tuple[float, np.ndarray]:
    """Rms that vectors leave of a change, and their amounts."""
    columns = basis.reshape(len(basis), -1).T
    amount = np.linalg.lstsq(columns, change.ravel(), rcond=None)[0]
    return float(np.std(change.ravel() - columns @ amount)), amount


def test_shapes_come_strongest_first_are_a_few_percent_and_have_no_mean_over_lst(differences):
    for shape in differences.shape.values():
        assert shape.mean(axis=1) == pytest.approx(0.0, abs=1e-15)
        size = shape.std(axis=(1, 2))
        assert np.all(np.diff(size) < 0)
        assert 0.02 < size[0] < 0.05


def test_the_shapes_may_be_asked_at_single_events(differences):
    shapes = differences.changes_at("Y", np.array([3.3, 3.3, 17.0]))
    assert shapes[:, 0] == pytest.approx(shapes[:, 1])
    assert shapes[:, 2] == pytest.approx(differences.shape["Y"][:, 34])


def test_levels_of_real_models_differ_by_ten_to_thirty_percent_alike_in_both_dipoles(differences):
    spread = np.array([np.sqrt(np.sum(values**2, axis=0)) for values in differences.level.values()])
    assert np.all((spread > 0.08) & (spread < 0.5))
    assert differences.level["X"] == pytest.approx(differences.level["Y"], abs=0.015)


def test_the_level_modes_describe_every_exchange_within_their_prior(differences):
    for level in differences.level["X"]:
        left, amount = left_by(differences.level_modes(), level)
        assert left < 0.007, "0.6 % of power, of the Low Frequency Sky Model"
        assert np.all(np.abs(amount) < 1.1)


def test_frequencies_beyond_the_models_have_the_differences_of_their_edge(chain):
    wide = replace(chain, frequency_mhz=np.linspace(5.0, 125.0, 51))
    shape = compute_model_differences(wide).shape["X"]
    assert shape[..., 0] == pytest.approx(shape[..., 1], abs=1e-9)  # 5 and 7.4 MHz, both below 10


def test_an_arm_and_not_a_letter_has_a_shape(chain, differences):
    exchanged = compute_model_differences(replace(chain, dipole_azimuth_deg={"X": 315.0, "Y": 225.0}))
    for one, other in ("XY", "YX"):
        for shape in exchanged.shape[one]:
            assert left_by(differences.shape[other], shape)[0] < 2e-4, "the modes left out; of 0.04"


def test_each_dipole_has_the_shapes_of_its_own_arm(chain, differences):
    other, default = compute_sky_power(chain, "lfsm"), compute_sky_power(chain)
    for own, across in ("XY", "YX"):
        change = change_of(own, other, default)
        assert left_by(differences.changes_at(own, other.lst_hours), change)[0] < 3e-4
        assert left_by(differences.changes_at(across, other.lst_hours), change)[0] > 1e-3


def test_an_instrument_elsewhere_gets_the_differences_of_its_own_site(chain):
    """They were those of the Superterp everywhere."""
    south = replace(chain, latitude_deg=-35.2)
    other, default = compute_sky_power(south, "lfsm"), compute_sky_power(south)
    change = change_of("X", other, default)
    assert left_by(model_difference_modes(south, other.lst_hours)["X"], change)[0] < 3e-4
    assert left_by(model_difference_modes(chain, other.lst_hours)["X"], change)[0] > 5e-3


def test_waves_are_a_few_percent_and_smaller_at_higher_harmonics_and_degrees(chain):
    together, own = waves_at(chain.frequency_mhz, LST_HOURS)
    assert together.changes.std(axis=(1, 2)) == pytest.approx(0.01 / 2**0.5)
    size = np.abs(np.fft.rfft(own.changes, axis=1)).max(axis=2) / 24
    harmonic = size.argmax(axis=1)
    assert set(harmonic.tolist()) == {1, 2, 3, 4, 5}
    strongest = [size[harmonic == k].max() for k in range(1, 6)]
    assert np.all(np.diff(strongest) < 0)
    assert strongest[0] == pytest.approx(0.004)
    wide, wider = waves_at(chain.frequency_mhz, LST_HOURS, is_search=True)
    np.testing.assert_allclose(wide.changes, 2.0 * together.changes)
    assert np.abs(wider.changes).max() == pytest.approx(2.0 * np.abs(own.changes).max())


def test_waves_describe_what_the_other_models_leave_of_one(chain):
    """What a model leaves of another is some tenths of a percent; with the waves within three of their sigma, less."""
    true, default = compute_sky_power(chain, "lfsm", "inverted-v-wet"), compute_sky_power(chain)
    change = np.log(true.at("X", LST_HOURS) / default.at("X", LST_HOURS))
    change -= change.mean(axis=0)
    known = compute_model_differences(chain, DifferenceModels(("gsm408",), ("inverted-v",))).shape["X"]
    _, waves = waves_at(chain.frequency_mhz, LST_HOURS, is_search=True)
    left, _ = left_by(known, change)
    beside, amount = left_by(np.concatenate([known, waves.changes]), change)
    assert left > 3e-3
    assert beside < 0.1 * left
    assert np.sqrt(np.mean(amount[len(known) :] ** 2)) < 3


def test_models_left_out_do_not_count(chain):
    other, default = compute_sky_power(chain, "lfsm"), compute_sky_power(chain)
    change = np.log(other.at("X", LST_HOURS) / default.at("X", LST_HOURS))
    change -= change.mean(axis=0)
    without = compute_model_differences(chain, DifferenceModels(skies=("gsm408",)))
    assert left_by(without.shape["X"], change)[0] > 5e-3
    assert len(without.level["X"]) == 3 + 4


def test_isotropic_brightness_changes_the_minimum_of_the_sky_most(differences):
    sky = compute_sky_power(load_instrument("lofar-superterp")).at("X", LST_HOURS)
    order = np.argsort(sky[:, 25])
    assert np.all(np.diff(differences.isotropic["X"][order, 25]) < 0)
    assert 0.1 < differences.isotropic["X"].mean() < 0.3


@pytest.mark.shared
@pytest.mark.parametrize("sky", ["gsm-408locked", "lfsm-5.1deg"])
@pytest.mark.parametrize("antenna", ["hamaker", "lba_vout"])
def test_the_shapes_span_every_exchange_of_the_full_models(shared, differences, chain, sky, antenna):
    beam = antenna if antenna == "hamaker" else str(shared / "data/antenna/lba_vout.npz")
    other = compute_sky_power(chain, str(shared / f"data/sky/{sky}.npz"), beam)
    default = compute_sky_power(chain)
    for dipole in "XY":
        shapes = differences.changes_at(dipole, other.lst_hours)
        left, amount = left_by(shapes, change_of(dipole, other, default))
        # 3e-4: the modes left out, and the nodes of the table; 3 % to begin with.
        assert left < 3e-4
        assert np.all(np.abs(amount) < 2.0), "within the prior"


def test_the_pattern_of_lofar_stood_in_for_that_of_every_instrument():
    """Differences are taken about the antenna that an instrument names, and beyond 120 MHz about the wide sky."""
    lofar = load_instrument("lofar-superterp")
    wide = np.array([60.0, 150.0, 300.0])
    other = replace(
        lofar, frequency_mhz=wide, antenna_gain=np.ones(3), receiver_gain=np.ones(3), antenna="quarter-wave",
        cables={name: np.ones(3) for name in lofar.cables}, dipole_azimuth_deg={"A": 20.0}, gain_provenance=None,
        sky=None,
    )  # fmt: skip
    differences = compute_model_differences(other)
    own = compute_sky_power(other)
    hotter = compute_sky_power(other, "lfsm-wide")
    varied = vary_sky_power(other, zenith_gain_fraction=0.1)
    gain = 1.1  # what it adds at zenith: P_sky of the differences has D = 1 there
    for exchange, changed in zip((0, 1), (varied.power["A"] / gain, hotter.power["A"]), strict=True):
        mean = np.log(changed / own.power["A"]).mean(axis=0)
        np.testing.assert_allclose(differences.level["A"][exchange], mean, atol=1e-9)
