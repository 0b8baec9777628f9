from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import pytest

from lbacal_core.curves.validity import Scope
from service.storage.changes import DISMISSED, IN_FORCE
from service.wire.bodies import DecisionBody, ReasonBody
from validation.life_states import BY, Life, live
from validation.life_world import standing_in
from validation.machinery.records import verdicts_of


@pytest.fixture
def life() -> Iterator[Life]:
    """A service without spectra, which at the end is held against one that is made anew."""
    with standing_in():
        made = Life()
        yield made
        made.teardown()


def decide(life: Life, antenna: int, decision: str) -> None:
    """Decide about the changes of an antenna, and let the nights follow."""
    body = DecisionBody.model_validate({"decision": decision, "reason": "test"})

    def act() -> None:
        for one in life.open_changes():
            if antenna in one.change.antennas:
                life.factory.changes.decide(one.number, body, "test")

    life.do(decision, act, is_night=True)


def test_a_change_in_a_year_without_spectra_left_the_years_around_it_joined(life: Life) -> None:
    """Years are not joined over a change, but only a change within a year made that year due."""
    life.begin({2014, 2016}, set())
    life.enter({0}, "2015-06-20", None, is_night=True)
    decide(life, 0, DISMISSED)


def test_a_change_at_the_turn_of_a_year_left_the_years_joined(life: Life) -> None:
    life.begin({2014, 2015}, {4, 5, 6, 7, 8, 9, 10, 11})
    life.enter({0}, "2015-01-01", None, is_night=True)


def test_a_version_that_was_confirmed_did_not_come_back_when_a_decision_was_undone(life: Life) -> None:
    """Months that were no news had confirmed it; the fit that was made again had another name."""
    life.begin({2014}, {1, 2, 3})
    life.enter({0}, "2014-09-20", None, is_night=True)
    for month in (1, 2, 3):
        life.do(f"late {month}", partial(life.add, [(2014, month)]), is_night=True)
    for decision in (DISMISSED, IN_FORCE) * 2:
        decide(life, 0, decision)


def late(life: Life, *months: tuple[int, int]) -> None:
    """Months that arrive late, each before a night."""
    for month in months:
        life.do(f"late {month}", partial(life.add, [month]), is_night=True)


def test_a_year_read_what_another_lent_before_that_was_made_anew(life: Life) -> None:
    """A month of 2014 lends to 2015, and its C comes from there: it was fitted while 2015 waited for its own fit."""
    life.begin({2015}, set())
    late(life, (2014, 11))
    life.enter({1}, "2014-09-20", -0.05, is_night=True)


def test_two_fits_of_the_same_spectra_had_one_name_though_a_change_parted_one_from_other_years(life: Life) -> None:
    life.begin({2016}, {2, 5, 6, 10, 11})
    late(life, (2015, 6), (2016, 2), (2014, 10), (2015, 11), (2014, 7), (2014, 12))


def test_a_path_lent_other_years_its_lines_without_the_month_that_had_moved_its_own_c(life: Life) -> None:
    life.begin({2016}, {9})
    late(life, (2015, 11), (2015, 10), (2015, 3), (2015, 8), (2014, 2), (2015, 12))


def test_a_mean_has_no_curve_of_a_dipole_whose_antennas_all_left_it(life: Life) -> None:
    life.begin({2015}, {6})
    life.enter({1, 2}, "2015-06-20", None, is_night=True)


def test_a_change_that_was_found_in_a_path_stays_when_c_of_the_path_is_withdrawn(life: Life) -> None:
    """Nothing was left to measure its drift against: the change was gone, and the refit undid the withdrawal."""
    life.begin({2015}, set())
    life.enter({0}, "2015-06-20", None, is_night=True)
    for dipole in "XY":
        life.take_away(Scope("CS002", 1, dipole), 2015, is_night=True)


@pytest.mark.parametrize("end", ["12-31", "06-30"])
def test_a_month_that_was_news_undid_what_a_person_had_withdrawn(life: Life, end: str) -> None:
    life.begin({2015}, {3, 5, 11})
    life.take_away(Scope("CS002", 1, "X"), 2015, end, is_night=False)
    late(life, (2015, 3), (2015, 5), (2015, 11))
    life.enter({1}, "2015-06-20", None, is_night=True)


def test_entering_a_change_of_two_antennas_put_one_of_two_that_were_dismissed_in_force(life: Life) -> None:
    life.begin({2014}, set())
    for antenna in (0, 2):
        life.enter({antenna}, "2014-09-20", None, is_night=False)
        decide(life, antenna, DISMISSED)
    life.enter({0, 2}, "2014-09-20", None, is_night=False)


def test_a_version_of_the_year_answered_behind_a_change_after_which_nothing_is_recorded(life: Life) -> None:
    """Its piece before the change has the same spectra, and so the same name: it was left in effect for the year."""
    life.begin({2015, 2016}, {11, 12})
    life.enter({0}, "2016-12-20", None, is_night=True)
    decide(life, 0, DISMISSED)


def test_a_version_of_the_year_answered_before_a_change_before_which_nothing_is_recorded(life: Life) -> None:
    life.begin({2015}, set())
    life.enter({3}, "2015-06-20", None, is_night=True)


def test_a_version_that_is_hardly_another_stayed_when_the_decision_that_had_brought_it_was_undone(life: Life) -> None:
    life.begin({2014, 2015, 2016}, set())
    life.enter({0, 3}, "2015-01-01", None, is_night=True)
    decide(life, 0, DISMISSED)


def test_a_month_that_was_no_news_gave_the_fits_of_an_undone_decision_other_names(life: Life) -> None:
    """Windows over a change were in the names of fits to which they lend nothing."""
    life.begin({2014, 2015, 2016}, {2})
    late(life, (2016, 2))
    for decision in (DISMISSED, IN_FORCE):
        decide(life, 1, decision)


def test_a_night_withdrew_what_somebody_had_put_back_before_a_change(life: Life) -> None:
    """The antenna has no events before the change: the version of the year was withdrawn there, and rolled back."""
    life.begin({2015}, {1, 10, 11})
    life.enter({0, 2, 3}, "2015-06-20", None, is_night=True)
    with life.factory.database.read() as stores:
        newest = stores.ledger.newest_number()
        withdrawn = next(n for n in range(newest, 0, -1) if stores.ledger.act_of(n)[-1].calibration is None)
    plan = life.factory.promotions.plan_rollback(withdrawn, ReasonBody(reason="test"), BY)
    life.do("roll back", lambda: life._promote(plan), is_night=True)
    life.enter({1}, "2015-05-20", -0.05, is_night=True)


def test_two_months_that_were_no_news_of_their_year_moved_another_by_more_than_was_allowed(life: Life) -> None:
    """The years differ by a step that was dismissed: where a month counts in one, the mean of all moves."""
    life.begin({2014, 2015, 2016}, {1, 2, 5, 9, 12})
    decide(life, 1, DISMISSED)
    late(life, (2016, 1), (2016, 2))


def test_nights_and_decisions_leave_what_follows_from_the_last_state() -> None:
    """The suite's small instance of `./dev prove life_states`."""
    row = live(0, sequences=1, steps=4)
    assert row["failures"] == []
    assert row["compared"] > 0


def test_300_sequences_show_that_fewer_than_one_in_fifty_leaves_a_state() -> None:
    whole, broken = {"sequences": 25, "failures": []}, {"sequences": 25, "failures": ["off"]}
    for rows, verdict in (([whole] * 12, "shown"), ([whole] * 3, "undecided"), ([broken] * 12, "refuted")):
        assert verdicts_of("life_states", "stand-in", rows) == {"broken": verdict}
