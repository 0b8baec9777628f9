"""Chains in Python."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u

import lbacal
from lbacal_core.errors import BadInputError

NU = np.array([50.0, 60.0, 80.0])


def chain_of(*stages):
    return lbacal.Chain([
        lbacal.Stage("lna", 25 * u.dB, noise=150 * u.K, error=15),
        lbacal.Stage("cable"),
        lambda nu: 1 / (1 + (nu / 70) ** 12),
        lbacal.Stage("amplifier", 30 * u.dB, noise="free", name="amp"),
        lbacal.Stage("adc", noise="free"),
        *stages,
    ], cable=-4 * u.dB)  # fmt: skip


def test_stages_that_say_their_noise_are_those_of_the_instrument_file(tmp_path):
    site, antenna = lbacal.Site(52.9, 6.9), lbacal.Antenna("short-dipole", {"A": 0}, gain=2.0, gain_source="a table")
    made = lbacal.Instrument("mine", site, antenna, chain_of(), NU * u.MHz)
    kinds = [(stage.name, stage.kind) for stage in made.core.stages]
    assert kinds == [("lna", "lna"), ("cable", "cable"), ("gain 2", "filter"), ("amp", "amplifier"), ("adc", "adc")]
    np.testing.assert_allclose(made.core.receiver_gain, 1000 / (1 + (NU / 70) ** 12))
    np.testing.assert_allclose(made.core.cables["all"], 10**-0.4)
    made.save(tmp_path / "mine.json")
    assert lbacal.Instrument.load(tmp_path / "mine.json").core.digest() == made.core.digest()


def test_a_noise_temperature_is_a_number_or_a_table_and_a_cable_may_have_a_gain_of_its_own():
    table = ([40, 90] * u.MHz, [100, 200] * u.K)
    chain = lbacal.Chain([
        lbacal.Stage("load", noise=table), lbacal.Stage("cable", 0.5), lbacal.Stage("adc", noise="free")
    ])  # fmt: skip
    np.testing.assert_allclose(chain.core_stages(NU)[0].noise_k, [120, 140, 180])
    np.testing.assert_allclose(chain.cable_loss(NU), 0.5)


def test_bare_gains_alone_make_the_chain_of_the_paper():
    assert lbacal.Chain([20 * u.dB, 0.5]).core_stages(NU) == ()


def test_a_list_that_is_no_chain_is_refused_as_in_a_file():
    with pytest.raises(BadInputError, match="the adc as the last stage"):
        chain_of(lbacal.Stage("amplifier", 2.0)).core_stages(NU)


def test_a_touchstone_file_is_a_gain(tmp_path):
    pytest.importorskip("skrf")
    (tmp_path / "f.s2p").write_text("# MHz S DB R 50\n40 -20 0 -20 0 -60 0 -20 0\n90 -20 0 -20 0 -60 0 -20 0\n")
    np.testing.assert_allclose(lbacal.Chain([str(tmp_path / "f.s2p")]).receiver_gain(NU), 0.01)
