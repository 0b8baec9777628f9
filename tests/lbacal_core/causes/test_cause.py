from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.catalogue import CAUSES, DESCRIPTIONS
from lbacal_core.causes.cause import SCOPES, SizeRange, Template, signature
from lbacal_core.causes.sky import CLEAR_MHZ
from lbacal_twin.faults.catalogue import catalogue_faults

NAMED = {cause.identifier: cause for cause in CAUSES}


def test_the_catalogue_is_what_the_twin_can_plant():
    named = [one.identifier for one in DESCRIPTIONS]
    assert len(named) == len(set(named))
    assert set(named) == set(catalogue_faults())


def test_noise_is_missing_only_where_it_is_known_beforehand(terms, conditions):
    cause = NAMED["missing_noise"]
    assert cause.templates(replace(conditions, known_noise=None)) == []
    assert "LST curve" in cause.needs
    (template,) = cause.templates(conditions)
    assert cause.sizes_of(template).lowest == -0.4  # less noise than none is impossible
    added = cause.apply(terms, conditions, Template(), 0.3).power() - terms.power()
    np.testing.assert_allclose(added, np.broadcast_to(0.3 * terms.front, added.shape))
    # 1 of its range is the mean sky power, weighed as the channels are recorded.
    weight = terms.front[0, 0] / terms.front[0, 0].sum()
    assert cause.scale(terms) == pytest.approx((terms.sky.mean(axis=1) @ weight).mean())


def test_an_exchange_acts_on_what_earlier_causes_made_of_the_other_polarisation(terms, conditions):
    brighter = NAMED["isotropic_level"].apply(terms, conditions, Template(), 0.5)
    swapped = NAMED["dipole_swap"].apply(brighter, conditions, Template(), 1.0)
    np.testing.assert_allclose(swapped.sky, brighter.sky[::-1])
    # A cable of which only X is here knows the other polarisation as the simulation has it.
    alone = replace(conditions, cables=["80", "50"])
    np.testing.assert_allclose(NAMED["dipole_swap"].apply(brighter, alone, Template(), 1.0).sky, terms.sky[::-1])


def test_only_the_end_of_what_is_believed_counts_as_an_edge():
    width, swap = NAMED["pattern_width"].sizes, NAMED["dipole_swap"].sizes
    assert [width.is_at_edge(0.35), width.is_at_edge(0.34)] == [True, False]
    assert [swap.is_at_edge(1.0), swap.is_at_edge(0.0)] == [False, True]
    assert not SizeRange().is_at_edge(1e9)


@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.identifier)
def test_a_cause_of_size_zero_changes_nothing_and_a_small_one_acts_in_proportion(cause, terms, conditions):
    templates = cause.templates(conditions)
    assert templates, "these conditions show every cause"
    assert set(cause.scopes) <= set(SCOPES)
    plain = terms.power()
    for template in (templates[0], templates[-1]):
        np.testing.assert_allclose(cause.apply(terms, conditions, template, 0.0).power(), plain, rtol=1e-12)
        slope = signature(cause, terms, conditions, template)
        assert slope.shape == plain.shape
        assert np.max(np.abs(slope)) > 1e-6
        step = cause.step
        changed = cause.apply(terms, conditions, template, step).power() / plain - 1.0
        # second order in a step made small for that
        assert np.linalg.norm(changed - step * slope) < 0.03 * np.linalg.norm(changed)


@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.identifier)
def test_causes_act_one_after_the_other(cause, terms, conditions):
    moved = NAMED["gain_drift"].apply(terms, conditions, Template(), 0.02)
    both = cause.apply(moved, conditions, cause.templates(conditions)[0], cause.step).power()
    alone = cause.apply(terms, conditions, cause.templates(conditions)[0], cause.step).power()
    # the drift is 1 % at the ends of the year, so what the cause does changes by about as much
    change, first = both / moved.power() - 1.0, alone / terms.power() - 1.0
    assert np.linalg.norm(change - first) < 0.1 * np.linalg.norm(first)


def test_without_temperature_and_rain_their_causes_say_what_is_missing(conditions):
    bare = replace(conditions, covariates={}, time_unix=conditions.time_unix[:1] + np.arange(200.0))
    for cause in CAUSES:
        if cause.identifier in ("gain_temperature", "cable_temperature", "lna_noise_temperature"):
            assert cause.templates(bare) == []
            assert "temperature" in cause.needs
        if cause.identifier in ("resonance_shift", "resonance_width"):
            assert cause.templates(bare) == []
            assert "static" in cause.needs


@pytest.mark.parametrize(
    ("cause", "size", "sigma", "is_allowed"),
    [
        # Negative powers of interference and slopes of N_LNA of -11.8 per 25 MHz were named.
        ("rfi_broadband", -0.016, 0.019, False),
        ("lna_noise_slope", -11.8, 1.0, False),
        ("rfi_broadband", 0.016, 0.003, True),
        ("gain_step", -0.01, 0.001, True),
        # An exchange of dipoles is 1, and is measured as a little more as often as a little less.
        ("dipole_swap", 1.02, 0.01, True),
        ("dipole_swap", 1.05, 0.01, False),
        ("dipole_swap", -0.26, 0.05, False),
    ],
)
def test_a_size_is_within_its_physical_range_or_beyond_it_by_its_error(cause, size, sigma, is_allowed):
    assert NAMED[cause].sizes.allows(size, sigma) == is_allowed


DATED = {"date_unix": 1.4e9}, {"date_unix": 1.5e9}
OTHERS = {
    "gain_step": DATED,
    "adc_noise_step": DATED,
    "filter_shift": DATED,
    "point_source": ({"source": "cas-a"}, {"source": "cyg-a"}),
    "rfi_line": ({"frequency_mhz": 40.0}, {"frequency_mhz": 40.1 + CLEAR_MHZ}),
    "dipole_swap": ({"between": "X Y"}, {"between": "X Z"}),
}


@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.identifier)
def test_two_of_a_cause_are_in_one_target_where_date_source_line_or_pair_is_another(cause):
    one, other = (Template(part) for part in OTHERS.get(cause.identifier, DATED))
    assert not cause.is_another(one, one)
    assert cause.is_another(one, other) == (cause.identifier in OTHERS)
    assert cause.is_another(other, one) == (cause.identifier in OTHERS)


def test_two_lines_that_run_into_each_other_are_one():
    line = NAMED["rfi_line"]
    near, far = (Template({"frequency_mhz": 40.0 + distance}) for distance in (0.9 * CLEAR_MHZ, 1.1 * CLEAR_MHZ))
    assert not line.is_another(near, Template({"frequency_mhz": 40.0}))
    assert line.is_another(far, Template({"frequency_mhz": 40.0}))
