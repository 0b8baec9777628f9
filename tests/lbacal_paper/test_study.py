from __future__ import annotations

import csv
import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from lbacal.pages.chart import COLOURS
from lbacal_core.data.lofar import DIPOLES
from lbacal_paper.budget import Budget, measure_electronics, spread_with_cables
from lbacal_paper.figures import MARKERS, Panel, PaperFigure, Series, draw, make_chain_figures, make_shower_figures
from lbacal_paper.reference_source import CELL, CHAMBER
from lbacal_paper.shower_study import FITTED, RIGHT, TOTAL, ShowerStudy, describe_terms
from lbacal_paper.study import Study


def test_the_array_fit_finds_what_was_planted(study: Study) -> None:
    for dipole in "XY":
        curve = study.mean_curve(dipole)
        assert curve.c is not None
        # 36 paths and 900 events: a tenth of a per cent, one station's sky gain in common
        assert np.median(np.abs(curve.c / study.campaign.truth.curve(dipole) - 1)) < 0.02


def test_exchanged_letters_fit_the_measured_curve_better(study: Study) -> None:
    chi2 = [sum(one.of(d, has_noise=True).chi2 for d in "XY") for one in (study.comparison, study.exchanged)]
    assert chi2[1] < chi2[0] / 3


def test_a_brighter_sky_scales_c_by_its_root_in_every_channel(budget: Budget) -> None:
    # the noise terms scale with the sky, so half the difference of ln C is exact
    for dipole in DIPOLES:
        assert budget.terms["sky"][dipole] == pytest.approx(np.full(51, budget.sky_fraction / 2), rel=1e-6)


def test_todays_budgets_are_those_of_lbacal_budget(budget: Budget) -> None:
    assert list(budget.today) == ["models", "measured"]
    for one in budget.today.values():
        assert {"antenna pattern", "level of the sky"} <= {term.name for term in one.terms}


def test_a_wider_pattern_changes_c_more_when_the_event_gain_is_weighted(budget: Budget) -> None:
    assert budget.largest("antenna") > 1.5 * budget.largest("antenna, bins weighted alike") > 0.01


def test_the_spread_of_antennas_is_the_gain_spread_that_was_planted(study: Study) -> None:
    # 4 % of power gain is 2 % of C; with 36 paths a polarisation the spread is known to 12 %
    for dipole, spread in measure_electronics(study).items():
        gains = [np.log(one.path_gain[:, DIPOLES.index(dipole)]) for one in study.campaign.truth.stations]
        planted = np.sqrt(np.mean([np.var(one, ddof=1) for one in gains])) / 2
        # errors of C are correlated along frequency, so that the spread is known no better than from 30 numbers
        assert np.median(spread) == pytest.approx(planted, rel=0.35)


def test_cables_left_in_spread_c_far_more_than_the_gains_do(study: Study) -> None:
    assert spread_with_cables(study, "X").max() > 3 * measure_electronics(study)["X"].max()


def test_wrong_calibrations_leave_the_diagonal_and_the_right_one_does_not(showers: ShowerStudy) -> None:
    moved = showers.displacements
    assert abs(moved[RIGHT].significance) < 3
    for name in (CHAMBER, CELL, "+1 sigma: antenna", "+1 sigma: index of the sky", "no dependence on frequency"):
        assert abs(moved[name].difference) > 5 * moved[name].difference_sigma, name
    # a level changes no slope
    assert moved["+1 sigma: sky"].difference == pytest.approx(moved[RIGHT].difference)
    assert abs(moved[FITTED].difference) < 0.5


def test_every_term_of_todays_budgets_moves_the_slopes_by_something_said(showers: ShowerStudy) -> None:
    for terms in showers.terms.values():
        # a level changes no slope, a pattern does, and an error of G_ant is none of a field
        assert terms["antenna pattern"][2] > 0.2
        assert "shape of the antenna gain" not in terms
        parts = [sizes for name, sizes in terms.items() if name != TOTAL]
        assert terms[TOTAL] == pytest.approx(np.linalg.norm(parts, axis=0))
    assert showers.terms["models"]["level of the sky"] == pytest.approx(np.zeros(3), abs=0.01)
    assert len(describe_terms(showers)) == sum(len(terms) for terms in showers.terms.values())


def read(figure: PaperFigure) -> list[dict[str, str]]:
    return list(csv.DictReader(line for line in figure.as_csv().splitlines() if not line.startswith("#")))


def test_a_csv_holds_every_number_that_is_drawn() -> None:
    x = np.array([1.0, 2.0])
    series = Series("a, b", x, x**2, low=x, high=np.array([np.nan, 5.0]), kind="points")
    rows = read(PaperFigure(1, "title", "caption", [Panel("nu", "C", [series])]))
    assert [row["y"] for row in rows] == ["1", "4"]
    assert [row["high"] for row in rows] == ["", "5"]
    assert rows[0]["series"] == "a, b"


def test_a_series_with_unequal_lengths_is_refused() -> None:
    with pytest.raises(ValueError, match="short"):
        Series("short", np.zeros(3), np.zeros(2))


@pytest.fixture(scope="module")
def figures(study: Study, budget: Budget, showers: ShowerStudy) -> list[PaperFigure]:
    return [*make_chain_figures(study, budget, None), *make_shower_figures(study, budget, showers)]


def test_figures_1_to_6_have_published_numbers_beside_ours(figures: list[PaperFigure]) -> None:
    assert [figure.number for figure in figures[:6]] == [1, 2, 3, 4, 5, 6]
    for figure in figures[1:6]:
        origins = {one.origin for panel in figure.panels for one in panel.series}
        assert {"ours", "published"} <= origins, figure.title
        assert all(np.all(np.isfinite(one.y)) for panel in figure.panels for one in panel.series)


def test_figures_7_to_9_call_the_stand_in_a_stand_in(figures: list[PaperFigure]) -> None:
    assert [figure.number for figure in figures[6:]] == [7, 8, 9]
    for figure in figures[6:]:
        assert "stand-in" in figure.caption
        assert "not public" in figure.caption
        assert all(np.all(np.isfinite(one.y)) for panel in figure.panels for one in panel.series)


# Machado, Oliveira & Fernandes 2009, severity 1.0, linear RGB
BLIND = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
SMALLEST_DISTANCE = 8.0
"""In CIELAB; 2.3 is just noticeable side by side, and every series has a marker of its own besides."""


def linear(colour: str) -> np.ndarray:
    rgb = np.array(to_rgb(colour))
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ np.clip(rgb, 0, 1)
    t = xyz / np.array([0.9505, 1.0, 1.089])
    f = np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def looks(figure: Figure) -> list[list[tuple[object, ...]]]:
    """What tells the entries of each legend apart without colour: marker, dashes, and whether a line or a band."""
    found = []
    for axes in figure.axes:
        handles, names = axes.get_legend_handles_labels()
        looks_of = []
        for handle, name in zip(handles, names, strict=True):
            line = handle[0] if hasattr(handle, "has_xerr") else handle
            if hasattr(line, "get_marker"):
                looks_of.append((name, line.get_marker(), str(line.get_linestyle()), str(line._dash_pattern)))
            else:
                looks_of.append((name, "band", str(handle.get_hatch()), ""))
        found.append(looks_of)
    return found


def test_no_two_series_of_a_panel_are_told_by_colour_alone(figures: list[PaperFigure]) -> None:
    assert len(figures) == 9
    for content in figures:
        for panel in looks(draw(content)):
            for one, other in itertools.combinations(panel, 2):
                assert one[1:] != other[1:], f"figure {content.number}: {one[0]} and {other[0]}"


def test_a_panel_has_no_more_groups_than_there_are_markers(figures: list[PaperFigure]) -> None:
    assert len(COLOURS) == len(MARKERS)
    for content in figures:
        for panel in content.panels:
            groups = {one.group or one.name for one in panel.series if one.kind != "boxes"}
            assert len(groups) <= len(MARKERS), content.title


@pytest.mark.parametrize("kind", BLIND)
def test_colours_differ_for_the_colour_blind(kind: str) -> None:
    seen = [lab(np.array(BLIND[kind]) @ linear(colour)) for colour in COLOURS]
    closest = min(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(seen, 2))
    assert closest > SMALLEST_DISTANCE
