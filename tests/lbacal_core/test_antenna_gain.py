from __future__ import annotations

import json
from typing import Any

import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import parse_instrument


def make_content() -> dict[str, Any]:
    """The smallest instrument with a hardware change."""
    return {
        "name": "two antennas",
        "latitude_deg": 52.9,
        "longitude_deg": 6.9,
        "height_m": 49,
        "frequency_mhz": [30, 50, 80],
        "dipoles": {"X": {"azimuth_deg": 45}, "Y": {"azimuth_deg": 135}},
        "antenna_gain": [0.1, 0.5, 0.2],
        "receiver_gain": [1, 1, 0.3],
        "cables": {"50 m": [0.6, 0.5, 0.4], "80 m": [0.4, 0.3, 0.2]},
        "antennas": [
            {"station": "CS002", "antenna": 0, "cable": "50 m", "until": "2013-05-01"},
            {"station": "CS002", "antenna": 0, "cable": "80 m", "since": "2013-05-01T00:00:00Z"},
            {"station": "CS002", "antenna": 1, "cable": "80 m"},
        ],
    }


PROVENANCE = {"kind": "absolute", "source": "NEC", "shape_error": [0.1, 0.02, 0.2], "scale_error": 0.05}


def test_an_instrument_says_what_its_antenna_gain_is() -> None:
    content = make_content() | {"antenna": "hamaker", "sky": "gsm", "antenna_gain_provenance": PROVENANCE}
    instrument = parse_instrument(content, "i.json")
    assert (instrument.antenna, instrument.sky) == ("hamaker", "gsm")
    assert instrument.antenna_gain_note == (
        "absolute: NEC; error of ln G_ant 20 % (shape, at most), 5 % (common factor)"
    )
    assert parse_instrument(json.loads(json.dumps(instrument.as_dict())), "i.json").as_dict() == instrument.as_dict()


def test_an_instrument_that_does_not_say_is_read_and_said_to_be_unchecked() -> None:
    assert parse_instrument(make_content(), "i.json").antenna_gain_note.startswith("unchecked")


def test_an_error_of_one_number_holds_in_every_channel() -> None:
    content = make_content() | {"antenna_gain_provenance": {"kind": "relative", "source": "x", "shape_error": 0.1}}
    gain = parse_instrument(content, "i.json").gain_provenance
    assert gain is not None
    assert gain.shape_error is not None
    assert gain.shape_error.tolist() == [0.1, 0.1, 0.1]


def test_words_about_the_antenna_gain_do_not_change_the_digest() -> None:
    content = make_content() | {"antenna": "hamaker", "antenna_gain_provenance": PROVENANCE}
    assert parse_instrument(content, "i.json").digest() == parse_instrument(make_content(), "i.json").digest()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"kind": "measured"}, "kind: expected absolute or relative"),
        ({"source": None}, "source: expected a name"),
        ({"shape_error": [0.1, 0.2]}, "shape_error: expected a number a channel"),
        ({"shape_error": [0.1, "x", 0.2]}, "expected a finite number"),
        ({"scale_error": -0.1}, "expected errors >= 0"),
    ],
)
def test_a_provenance_that_says_nothing_sensible_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInputError, match=said):
        parse_instrument(make_content() | {"antenna_gain_provenance": PROVENANCE | change}, "i.json")
