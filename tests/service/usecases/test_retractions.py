"""Most events of a year are flagged: nothing stands behind the C that they gave."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.curves.validity import Scope
from lbacal_core.spectra.spectra import Spectra
from service.errors import NotInEffectError
from service.factory import Factory
from service.storage.alarms import OPEN, AlarmsAsked
from service.usecases.calibrations import InEffect
from service.wire.bodies import PromotionBody
from tests.service.conftest import add_spectra, instant, night

PATH, AT = Scope("CS002", 0, "X"), instant("2015-06-01")


def flag(factory: Factory, names: list[str], flag: str | None) -> None:
    for name in names:
        factory.intake.set_flag(name, flag, reason="test", by="test")


def ask(factory: Factory, at: int = AT) -> InEffect:
    return factory.calibrations.in_effect(at, [PATH])


@pytest.mark.long
@pytest.mark.parametrize("left", [0, 4])
def test_c_of_a_year_whose_events_were_retracted_was_served_as_before_and_nothing_said_so(
    after_night: Factory, campaign: Spectra, left: int
) -> None:
    """With all of them flagged no work was due, and with four left what they gave waited at the gate."""
    night(after_night)
    before = str(ask(after_night).curves[0].promotion.calibration)
    other = ask(after_night, instant("2014-06-01")).curves[0].promotion.calibration
    body = {"calibration": before, "valid_from": "2017-01-01", "reason": "a pin"}
    promotions = after_night.promotions
    promotions.promote(promotions.plan(PromotionBody.model_validate(body), "a person"), lambda *_: None)
    names = np.unique(campaign.event_id[campaign.time_unix >= instant("2015-01-01") / 1e6]).tolist()
    flag(after_night, names[left:], "retracted")
    night(after_night)
    with pytest.raises(NotInEffectError, match=f"{len(names) - left} of its 380 events were flagged since"):
        ask(after_night)
    (pin,) = ask(after_night, instant("2018-01-01")).curves
    assert (pin.promotion.calibration, "events were flagged since" in str(pin.changed)) == (before, True)
    alarms = after_night.alarms.newest(AlarmsAsked((OPEN,), 20))
    told = {one.news.kind: one.news.sentence for one in alarms}
    assert told["lost_c"].startswith("8 paths of CS002, 2015-01-01 to 2016-01-01: no C is in effect; CS002 antenna 0 X")
    assert "2015-01-01 to 2016-01-01: events of 1 version in effect were flagged since" in told["retracted"]
    assert after_night.status.look().events == len(np.unique(campaign.event_id)) - len(names) + left
    flag(after_night, names[left:], None)
    night(after_night)
    assert [one.promotion.calibration for one in ask(after_night).curves] == [before]
    assert ask(after_night, instant("2014-06-01")).curves[0].promotion.calibration == other, "2015 lent to it"
    assert ask(after_night, instant("2018-01-01")).curves[0].changed is None
    assert not {"lost_c", "retracted"} & {one.news.kind for one in after_night.alarms.newest(AlarmsAsked((OPEN,), 20))}


@pytest.mark.long
def test_what_is_sent_again_under_other_names_is_ok_and_follows_what_was_corrected(
    after_night: Factory, campaign: Spectra
) -> None:
    """All paths stayed uncertain, though a fit had just confirmed them; the corrected antenna lost its own C."""
    paths = [Scope("CS002", antenna, "X") for antenna in (0, 1)]
    before = after_night.calibrations.in_effect(AT, paths).curves
    flag(after_night, np.unique(campaign.event_id).tolist(), "retracted")
    again = campaign.power * np.where(campaign.antenna == 0, 1.3, 1.0)[:, None]
    add_spectra(after_night, replace(campaign, event_id=np.char.add("v2-", campaign.event_id), power=again))
    night(after_night)
    night(after_night)
    after = after_night.calibrations.in_effect(AT, paths).curves
    moved = [float(np.mean(new.served.curve.c / old.served.curve.c)) for old, new in zip(before, after, strict=True)]
    assert moved == pytest.approx([1.3**-0.5, 1.0], abs=0.01)
    assert [(one.changed, one.promotion.scope) for one in after] == [(None, path) for path in paths]
    assert not {"lost_c", "retracted"} & {one.news.kind for one in after_night.alarms.newest(AlarmsAsked((OPEN,), 20))}


@pytest.mark.long
def test_a_corrected_year_that_differs_from_another_waits_and_says_so(after_night: Factory, campaign: Spectra) -> None:
    """What waited was over as soon as what it was measured against was withdrawn, and nothing said that it waits."""
    own = campaign.select(campaign.time_unix >= instant("2015-01-01") / 1e6)
    flag(after_night, np.unique(own.event_id).tolist(), "retracted")
    again = own.power * np.where(own.antenna == 0, 1.3, 1.0)[:, None]
    add_spectra(after_night, replace(own, event_id=np.char.add("v2-", own.event_id), power=again))
    night(after_night)
    (one,) = ask(after_night).curves
    assert one.promotion.scope == Scope("CS002")
    assert one.waiting is not None
    assert one.waiting.scope == PATH
    assert "mean C differs by -1" in str(one.changed)
    assert after_night.status.look().gated == 2
