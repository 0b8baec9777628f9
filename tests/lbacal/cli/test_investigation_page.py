from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal.cli.investigation_page import draw_scores, draw_structure, write_investigation_page
from lbacal_core.discovery.report import investigate
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.antenna import GainStep
from lbacal_twin.faults.cable import CableReflection
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.uncatalogued import FieldGradient, FrostAndHeat
from lbacal_twin.settings import TwinSettings

SETTINGS = TwinSettings(stations=("CS002",), antennas=6, events_per_year=250)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The page of a station in which one path stepped, and which follows the square of the temperature besides."""
    chain = load_instrument("lofar-superterp")
    sky = compute_sky_power(chain)
    faults = [
        GainStep(size=0.08, where=Where(antennas=(2,), dipoles=("Y",)), date="2014-08-07"),
        FrostAndHeat(size=0.09),
    ]
    spectra = simulate_campaign(SETTINGS, chain, sky, np.random.default_rng(8), faults).spectra
    content, reports = investigate(spectra, chain, sky)
    path = tmp_path_factory.mktemp("page") / "r.html"
    write_investigation_page(content, reports, path)
    return content, path.read_text(), reports


@pytest.mark.long
def test_a_finding_has_its_signature_its_maps_and_its_change_of_c(written):
    content, page, _ = written
    assert [finding["cause"] for finding in content["findings"]] == ["gain_step"]
    for words in ("signature of gain_step", "residual maps before and after", "change of C"):
        assert words in page


def test_structure_that_no_cause_explains_is_drawn_along_its_axis(written):
    content, page, _ = written
    assert content["verdict"] == "unexplained"
    assert "Residual structure that no cause explains" in page


def test_every_picture_is_inside_the_page(written):
    _, page, _ = written
    assert page.count("<img") == page.count("data:image/png;base64,") == 9
    assert "http" not in page


def test_the_sentence_the_gain_and_what_it_changes_in_c_are_said(written):
    content, page, _ = written
    for words in (
        content["findings"][0]["sentence"],
        "gain on held-out events",
        "indistinguishable from",
        "in the median",
    ):
        assert words in page


def test_labels_of_scores_stood_at_bars_of_other_causes(written):
    (report,) = written[2]
    causes = [score.cause.identifier for score in (*report.scores, *report.antenna_scores)]
    assert len(set(causes)) < len(causes), "a cause has a score for each cable name"
    (axes,) = draw_scores(report).axes
    bars = [(bar.get_y() + bar.get_height() / 2, bar.get_width()) for bar in axes.patches]
    labels = [(label.get_position()[1], label.get_position()[0]) for label in axes.texts]
    np.testing.assert_allclose(bars, labels)
    assert [tick.get_text() for tick in axes.get_yticklabels()] == causes[::-1]


@pytest.mark.long
def test_a_static_cause_is_drawn_as_an_antenna_against_the_others(tmp_path):
    chain = load_instrument("lofar-superterp")
    sky = compute_sky_power(chain)
    settings = TwinSettings(stations=("CS002",), antennas=10, events_per_year=150)
    reflection = CableReflection(size=0.1, delay_us=0.62, phase_rad=2.2, where=Where(antennas=(7,)))
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(8), [reflection]).spectra
    content, reports = investigate(spectra, chain, sky)
    (finding,) = content["findings"]
    assert (finding["cause"], finding["where"]["antennas"]) == ("cable_reflection", [7])
    # The delay is known modulo 1 us, and channels of 1 MHz damp it.
    assert finding["parameters"]["delay_us"] == pytest.approx(0.38, abs=0.01)
    assert finding["parameters"]["or_delay_us"] == pytest.approx(0.62, abs=0.01)
    seen = 0.1 * np.sinc(0.62) / np.sinc(0.38)
    assert abs(finding["size"]["value"] - seen) < 4 * finding["size"]["sigma"]
    assert {"cable_length", "cable_reflection"} <= {score["cause"] for score in content["scores"]["CS002"]}
    write_investigation_page(content, reports, tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text()
    assert "antenna 7 against the others of its cable" in page
    assert "with an amplitude of" in page


@pytest.mark.long
def test_what_all_paths_show_together_is_told_path_by_path(tmp_path):
    """A gradient over the field read as if one path had it: its amounts show that it grows from antenna to antenna."""
    chain = load_instrument("lofar-superterp")
    sky = compute_sky_power(chain)
    settings = replace(SETTINGS, antennas=10)
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(8), [FieldGradient(size=0.06)]).spectra
    # One antenna died after a third of the year: it is compared with the others and has no amount.
    died = (spectra.antenna == 4) & (spectra.time_unix > np.quantile(spectra.time_unix, 1 / 3))
    spectra = spectra.select(~died)
    content, reports = investigate(spectra, chain, sky)
    told = content["unexplained"]
    assert (told["where"]["axis"], content["findings"]) == ("lst", [])
    assert " in 18 paths of CS002 together, each by its own amount and most in antenna" in told["description"]
    antennas = [int(path.split()[1]) for path in told["paths"]]
    assert (len(antennas), 4 in antennas) == (18, False)
    values = [amount["value"] for amount in told["paths"].values()]
    assert abs(np.corrcoef(antennas, values)[0, 1]) > 0.8
    assert told["paths"][told["where"]["target"]]["value"] == pytest.approx(1.0)
    panels = draw_structure(reports[0], reports[0].structure).axes
    assert [panel.get_xlabel() for panel in panels] == ["local sidereal time (h)", "frequency (MHz)", "antenna"]
    drawn = [line.get_ydata() for line in panels[2].lines if line.get_marker() == "o"]
    assert np.isfinite(np.concatenate(drawn)).sum() == 18
    write_investigation_page(content, reports, tmp_path / "r.html")
    assert told["description"] in (tmp_path / "r.html").read_text()
