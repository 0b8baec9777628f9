"""Mistakes that a person makes while describing an instrument: one sentence each, in the words of Python."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from astropy import units as u

import lbacal
from lbacal_core.errors import BadInputError

SITE, NU = lbacal.Site(-30.7, 21.4), np.arange(50, 80) * u.MHz
ANTENNA = lbacal.Antenna("short-dipole", {"E": 90, "N": 0}, gain=2.0)
KELVIN = lbacal.Chain([lbacal.Stage("lna", 20 * u.dB, noise=150, error=10), lbacal.Stage("adc", noise="free")])


def make(site: lbacal.Site = SITE, antenna: lbacal.Antenna = ANTENNA, chain: object = None, nu: object = NU) -> None:
    lbacal.Instrument("mine", site, antenna, chain or lbacal.Chain(), nu)


def stages(*these: lbacal.Stage) -> lbacal.Chain:
    return lbacal.Chain([*these, lbacal.Stage("adc", noise="free")])


DECIBELS = "or decibels such as -20 * u.dB, found"
MISTAKES: dict[str, tuple[Callable[[], None], str]] = {
    "Hz for MHz": (lambda: make(nu=np.arange(50, 80) * 1e6), "expected MHz, found 7.9e+07, which looks like Hz"),
    "GHz for MHz, and a table": (
        lambda: make(nu=np.arange(50, 80) / 1e3, chain=stages(lbacal.Stage("lna", ([40, 90], [2.0, 3.0])))),
        "expected MHz, found 0.079, which looks like GHz",
    ),
    "dB for a factor": (lambda: make(chain=stages(lbacal.Stage("lna", -20))), f"above 0, {DECIBELS} -20"),
    "a gain of 0": (lambda: make(chain=lbacal.Chain([0.0])), f"above 0, {DECIBELS} 0"),
    "dB for a cable": (lambda: make(chain=lbacal.Chain(cable=3)), f"above 0 and at most 1, {DECIBELS} 3"),
    "a function that falls to 0": (lambda: make(chain=lbacal.Chain([lambda nu: nu - 60])), f"{DECIBELS} -10"),
    "latitude for longitude": (
        lambda: make(site=lbacal.Site(116.76, -26.82)),
        "latitude_deg: expected -90 to 90, found 116.76; longitude is -26.82: are the two exchanged?",
    ),
    "LNA for lna": (lambda: make(chain=stages(lbacal.Stage("LNA", 10))), "stage 'LNA': kind: expected one of antenna,"),
    "no gain": (lambda: make(chain=stages(lbacal.Stage("lna", noise="free"))), "'lna': expected a gain, found none"),
    "a temperature below 0": (
        lambda: make(chain=stages(lbacal.Stage("load", noise=-5))),
        "stage 'load': noise temperature: expected numbers > 0, found -5.0",
    ),
    "an error of nothing": (
        lambda: make(chain=stages(lbacal.Stage("lna", 10, noise="free", error=5))),
        "expected an error >= 0 of a known noise temperature",
    ),
    "kelvin without m^2": (lambda: make(chain=KELVIN), "antenna: gain_source: expected where the G_ant of gain="),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_sentence(name: str) -> None:
    mistake, sentence = MISTAKES[name]
    with pytest.raises(BadInputError) as caught:
        mistake()
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "_k" not in str(caught.value).replace("_known", "")
