from __future__ import annotations

import numpy as np

from validation.anywhere import investigate_drawn


def test_a_rival_that_describes_these_data_better_is_listed_though_more_templates_were_tried():
    """A step seen at 8.0 sigma, and at 7.9 as a drift, was a drift alone: a date is scanned and a rate is not."""
    row = investigate_drawn(25)
    assert row["named"], row["said"]
    assert row["others"] == 0


def test_a_rival_that_the_data_exclude_is_not_listed(world):
    """Effects of 40 sigma: templates alike to 0.99 leave 6 of them, and noise adds none."""
    look = world.look()
    template = look.template("gain_step", date_unix=float(np.median(look.data.conditions.time_unix)))
    assert "gain_drift" in look.similar_to("gain_step", template, 5.0, "antenna 1")
    assert "gain_drift" not in look.similar_to("gain_step", template, 40.0, "antenna 1")
