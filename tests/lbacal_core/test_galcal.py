from __future__ import annotations

from typing import Any

from lbacal_core.curves.galcal import FORMAT, describe_made_with, make_head, name_path
from lbacal_core.instrument.instrument import load_instrument


def test_a_head_holds_every_covariance_by_its_path_and_the_budgets(calibrations: dict[str, Any]) -> None:
    head = make_head(calibrations | {"provenance": {"inputs": {}}})
    assert head["format"] == FORMAT
    assert list(head["covariances"]) == ["CS002 4 X", "CS002 4 Y", "CS002 17 X", "CS002 17 Y"]
    assert head["budgets"] == calibrations["budgets"]
    assert (head["at"], head["as_of"], head["provenance"]) == (
        calibrations["at"],
        calibrations["as_of"],
        {"inputs": {}},
    )


def test_a_path_is_named_by_what_it_has() -> None:
    assert name_path({"station": "CS002", "antenna": None, "dipole": "X"}) == "CS002 X"
    assert name_path({"station": "", "antenna": -1, "dipole": "Y"}) == "Y"


def test_a_head_says_where_the_antennas_stand_how_their_arms_point_and_which_models_were_used() -> None:
    instrument = load_instrument("lofar-superterp")
    made = describe_made_with(instrument, {"sky": "gsm", "antenna": "hamaker", "dipoles": {}})
    assert made["instrument"]["dipoles"] == {"X": {"azimuth_deg": 45.0}, "Y": {"azimuth_deg": 135.0}}
    assert made["instrument"]["sha256"] == instrument.digest()
    assert made["models"] == {"sky": "gsm", "antenna": "hamaker"}
    assert "sites" not in made["instrument"]
    assert "models" not in describe_made_with(instrument, None)
