"""The empirical term: read from a report it is the structure that was found, and it carries over to other events."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.axes import describe_term, list_axes, read_term, smooth_functions
from lbacal_core.causes.model import Model
from lbacal_core.discovery.adopted import fit_adopted, measure_gains
from lbacal_core.discovery.refit import fit_chain
from lbacal_core.discovery.residual_structure import find_structure
from lbacal_core.discovery.search import put_into_words, search_station
from lbacal_core.discovery.station import gather_stations
from lbacal_core.errors import BadInputError
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.uncatalogued import MainsHum
from lbacal_twin.settings import YEAR_S, TwinSettings
from tests.lbacal_core.discovery.worlds import report_of

SETTINGS = TwinSettings(stations=("CS002",), antennas=6, events_per_year=300, years=2.0)


@pytest.fixture(scope="module")
def years(chain, sky):
    """Two years of a station whose gain swings twice a day, which no cause of the catalogue describes."""
    spectra = simulate_campaign(SETTINGS, chain, sky, np.random.default_rng(8), [MainsHum(size=0.03)]).spectra
    is_first = spectra.time_unix < SETTINGS.start_unix + YEAR_S
    return spectra.select(is_first), spectra.select(~is_first)


@pytest.fixture(scope="module")
def station(years, simulation):
    return gather_stations(years[0], simulation)[0]


@pytest.fixture(scope="module")
def report(station):
    return json.loads(json.dumps(report_of(put_into_words(search_station(station)))))


def test_the_term_of_a_report_is_the_structure_that_was_found(station):
    linear = fit_chain(station).linear
    found = find_structure(linear, np.random.default_rng(0), 0.002)
    letters = linear.residuals.polarisations.tolist()
    term = describe_term(station.conditions, found.axis.name, dict(zip(letters, found.coefficients, strict=True)))
    read = read_term(station.conditions, json.loads(json.dumps(term)))
    for letter, values in zip(station.conditions.dipoles, read, strict=True):
        np.testing.assert_allclose(values, found.term[letters.index(letter)], atol=1e-12)


def test_functions_of_other_data_are_the_same_functions(station):
    conditions = station.conditions
    for axis in list_axes(conditions):
        term = describe_term(conditions, axis.name, {"X": np.eye(2)})
        if term is None:
            assert axis.name == "date"
            continue
        frozen = smooth_functions(conditions, term["axis"], term.get("column"), term.get("range"))
        np.testing.assert_allclose(frozen, axis.basis(conditions), atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("cause", ["residual_structure", "sentence"])
def test_structure_without_a_name_is_adopted_as_what_it_is(report, years, simulation, cause):
    """It gains on the next year, and its size there is the one adopted: in words, or as smooth functions without."""
    assert report["verdict"] == "unexplained"
    assert report["unexplained"]["sentences"]
    kept = report["unexplained"]["sentences"] if cause == "sentence" else []
    model = Model.from_report({**report, "unexplained": {**report["unexplained"], "sentences": kept}}, "unexplained")
    assert Model.from_text(model.to_text()) == model
    (adopted,) = model.causes
    assert adopted.cause == cause
    assert adopted.size < 1.0
    (gain,) = measure_gains(years[1], simulation.with_causes(model))
    assert gain.gain > 10
    assert abs(gain.gain - gain.expected) < 4 * gain.expected_sigma
    (station,) = gather_stations(years[1], simulation)
    (size,) = fit_adopted(station, model).sizes
    assert size.value == pytest.approx(adopted.size, abs=4 * np.hypot(size.sigma, adopted.sigma))


@pytest.mark.long
def test_structure_that_does_not_recur_is_not_adopted(report):
    along_date = {**report["unexplained"], "sentences": [], "term": None}
    with pytest.raises(BadInputError, match="recurs"):
        Model.from_report({**report, "unexplained": along_date}, "unexplained")
    with pytest.raises(BadInputError, match="structure to adopt"):
        Model.from_report({**report, "unexplained": None}, "unexplained")


def test_a_term_of_a_column_needs_the_column(station):
    values = station.conditions.covariates["temperature_c"]
    conditions = station.conditions.with_covariates(humidity=values)
    term = describe_term(conditions, "humidity", {"X": np.full((6, 4), 0.01)})
    assert term["column"] == "humidity"
    hotter = replace(conditions, covariates={"humidity": values + 1000.0})
    ends = read_term(hotter, term)
    assert np.ptp(ends, axis=1).max() == 0.0, "beyond the range the term stays as it is at its end"
