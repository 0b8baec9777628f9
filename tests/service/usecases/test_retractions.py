"""Most events of a year are flagged: nothing stands behind the C that they gave."""

from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.curves.validity import Scope
from lbacal_core.spectra.spectra import Spectra
from service.errors import NotInEffectError
from service.factory import Factory
from service.storage.alarms import OPEN, AlarmsAsked
from service.usecases.calibrations import InEffect
from service.wire.bodies import PromotionBody
from tests.service.conftest import instant, night

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
