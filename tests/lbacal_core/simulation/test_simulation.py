import ast
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.model import PLAIN, AdoptedCause, Model
from lbacal_core.curves.curves import CalibrationCurve, Parameter
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.antennas import AntennaRecord, GainProvenance
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.stages import Stage
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower
from tests.oracles import chain_power

A, SCALE, N_LNA, N_RCU, N_ADC = 0.7, 3.0e9, 0.3, 2.0e-10, 0.1
WARM = AdoptedCause("gain_temperature", "CS002", "station", 0.1, 0.01)


@pytest.fixture
def simulation(low_band: Instrument, two_waves: SkyPower) -> Simulation:
    return Simulation(low_band, two_waves)


@pytest.fixture
def curve(low_band: Instrument) -> CalibrationCurve:
    """A path whose constants are known, by eq. cal_equation."""
    c = (A * low_band.cables["80"] * low_band.receiver_gain * SCALE) ** -0.5
    levels = {"n_lna": N_LNA, "n_rcu": N_RCU * SCALE, "n_adc": N_ADC}
    parameters = {name: Parameter(value, 0.0) for name, value in levels.items()}
    nu = low_band.frequency_mhz
    return CalibrationCurve("CS002", 1, "X", "converged", 900, nu, c, 0.01 * c, None, 1.0, 1.0, parameters)


def test_power_is_that_of_the_chain_written_out(simulation, curve):
    lst, instrument = np.array([2.0, 19.5]), simulation.instrument
    sky = simulation.sky_power.at("X", lst)
    known = {
        "antenna_gain": instrument.antenna_gain,
        "correction": np.full(instrument.frequency_mhz.size, A),
        "cable_loss": instrument.cables["80"],
        "receiver_gain": instrument.receiver_gain,
        "scale": SCALE,
        "n_lna": N_LNA,
        "n_rcu": N_RCU,
        "n_adc": N_ADC,
    }
    expected = chain_power(sky, **known)
    np.testing.assert_allclose(simulation.background(curve, lst), expected, rtol=1e-12)
    np.testing.assert_allclose(simulation.electronics(curve), chain_power(0.0 * sky, **known)[0], rtol=1e-12)
    signal, behind = simulation.split_power([curve, curve], sky)
    np.testing.assert_allclose(signal[1] + behind[1], expected, rtol=1e-12)
    with pytest.raises(BadInputError, match="one polarisation"):
        simulation.background(replace(curve, dipole=None, antenna=None), lst)
    with pytest.raises(ValueError, match="no curve"):
        simulation.power(replace(curve, status="too_few_events", c=None, c_sigma_stat=None), sky)


def test_on_some_channels_it_is_that_of_an_instrument_with_these_alone():
    whole = Simulation.load("lofar-superterp")
    nu = whole.instrument.frequency_mhz
    kept = ~np.isin(nu, [40.0, 41.0, 70.0])
    ours = whole.on_channels(nu[kept])
    fewer = compute_sky_power(ours.instrument)
    assert ours.is_own_sky
    assert whole.on_channels(nu) is whole
    assert whole.on_channels(nu[:20]) is whole
    assert whole.on_channels(nu[kept] + 0.5) is whole
    for letter, values in ours.sky_power.power.items():
        np.testing.assert_allclose(values, fewer.power[letter], rtol=1e-12)
    assert ours.sky_power.digest() != whole.sky_power.digest()
    given = replace(whole, given=whole.sky_power, is_own_sky=False).on_channels(nu[kept])
    assert not given.is_own_sky
    assert given.sky_power.digest() == ours.sky_power.digest()


def test_every_table_of_an_instrument_has_the_channels_that_are_kept():
    nu, values = np.array([30.0, 40.0, 50.0, 60.0]), np.array([0.1, 0.2, 0.3, 0.4])
    stages = (Stage("lna", "lna", gain=values, noise_k=100 * values, is_free=True), Stage("adc", "adc", is_free=True))
    provenance = GainProvenance("absolute", "a table", shape_error=values)
    whole = Instrument(
        "mine", 50.0, 6.0, 0.0, nu, {"X": 45.0}, 3.0 * values, np.ones(4), {"50 m": values},
        [AntennaRecord("S1", 0, "50 m")], gain_provenance=provenance, stages=stages,
    )  # fmt: skip
    whole = replace(whole, alternatives={"colder": [replace(whole, antenna_gain=2.0 * values)]})
    ours, at = whole.on_channels(nu[[0, 2, 3]]), [0, 2, 3]
    (colder,) = ours.alternatives["colder"]
    found = [
        ours.antenna_gain / 3.0, ours.cables["50 m"], ours.gain_provenance.shape_error, ours.stages[0].gain,
        ours.stages[0].noise_k / 100, colder.antenna_gain / 2.0,
    ]  # fmt: skip
    for one in found:
        np.testing.assert_allclose(one, values[at], rtol=1e-12)
    assert ours.stages[1] == stages[1]


def test_the_own_sky_may_be_wrong_and_one_that_is_given_is_taken_at_its_word(simulation):
    assert not simulation.is_own_sky
    assert simulation.prior is None
    assert simulation.differences is None
    own = Simulation.load("lofar-superterp")
    assert own.is_own_sky
    assert set(own.prior.modes) == set(own.differences.shape) == {"X", "Y"}
    assert own.at_its_word().prior is None
    assert own.at_its_word().sky_power is own.sky_power


def test_other_causes_keep_what_was_computed_and_have_another_digest(simulation):
    noise, changed = simulation.noise, simulation.with_causes(Model((WARM,)))
    assert changed.noise is noise
    assert changed.made is simulation.made
    assert (simulation.causes, changed.causes) == (PLAIN, Model((WARM,)))
    trusted = replace(simulation, is_own_sky=True)
    assert len({one.digest for one in (simulation, changed, trusted)}) == 3
    assert replace(simulation).digest == simulation.digest


def test_every_fit_of_a_worker_computed_the_freedom_of_its_own_sky_again():
    """A fit asks a copy with the causes of its station, and what a copy computed was lost with it: a second a fit."""
    own = Simulation.load("lofar-superterp")
    first, second = own.with_causes(Model((WARM,))), own.with_causes(Model())
    assert first.prior is not None
    assert second.prior is first.prior
    assert second.differences is first.differences
    assert replace(own).prior is not first.prior


def test_another_instrument_or_sky_does_not_take_over_what_was_computed(simulation):
    """Fits of single paths are kept by their spectra alone: a replaced sky would have had those of the first."""
    simulation.made.get(("single paths", "spectra", 1.0), lambda: "of the first")
    brighter = {dipole: 2.0 * power for dipole, power in simulation.sky_power.power.items()}
    other = replace(simulation, given=replace(simulation.sky_power, power=brighter))
    assert other.made.get(("single paths", "spectra", 1.0), lambda: "of the other") == "of the other"
    assert other.at_station("CS002").made is not other.made


def test_events_leave_the_simulation_as_it_is_and_hours_smear_its_sky(simulation, two_stations):
    assert simulation.smeared(two_stations) is simulation
    rows = len(two_stations)
    for own in (False, True):
        long = replace(simulation, is_own_sky=own).smeared(replace(two_stations, duration_s=np.full(rows, 3 * 3590.17)))
        assert long.is_own_sky is own
        np.testing.assert_allclose(long.sky_power.power["X"], simulation.sky_power.smeared(3.0).power["X"], rtol=1e-6)
    # without durations a file counts blocks of 5.12 us
    by_blocks = replace(two_stations, blocks=np.full(rows, round(3 * 3590.17 / 5.12e-6)))
    assert simulation.smeared(by_blocks).sky_power.power["X"] == pytest.approx(long.sky_power.power["X"])


def test_durations_that_are_unlike_are_refused_and_a_few_shorter_ones_are_not(simulation, two_stations):
    rows = len(two_stations)
    hours = np.full(rows, 2.0)
    hours[:2] = 1.0
    simulation.smeared(replace(two_stations, duration_s=3600 * hours))
    hours[: rows // 2] = 0.25
    with pytest.raises(BadInputError, match=r"duration_s: expected durations that are alike.*found 0\.25 to 2 h"):
        simulation.smeared(replace(two_stations, duration_s=3600 * hours))


def test_blocks_that_are_more_than_a_day_were_told_as_durations_that_are_unlike(simulation, two_stations):
    many = replace(two_stations, blocks=np.full(len(two_stations), 10**15))
    with pytest.raises(
        BadInputError, match=r"blocks: expected at most a day in a spectrum in blocks.*found 1\.4e\+06 h"
    ):
        simulation.smeared(many)
    with pytest.raises(BadInputError, match=r"duration_s: expected at most a day in a spectrum, found 28 h"):
        simulation.smeared(replace(many, duration_s=np.full(len(two_stations), 1e5)))


def test_a_sky_power_on_other_channels_or_of_another_instrument_is_refused(simulation):
    some = simulation.instrument
    fewer = replace(
        simulation.sky_power, frequency_mhz=some.frequency_mhz[1:],
        power={dipole: power[:, 1:] for dipole, power in simulation.sky_power.power.items()},
    )  # fmt: skip
    with pytest.raises(BadInputError, match="frequency_mhz"):
        Simulation(some, fewer)
    with pytest.raises(BadInputError, match="that of the fit"):
        Simulation(replace(some, name="another"), Simulation.load("lofar-superterp").sky_power)


def test_instrument_and_sky_power_travel_as_one(repository):
    """They stood side by side in 57 files."""
    below = ("sky", "lstcurve", "simulation")
    together = []
    for room in ("lbacal_core", "service/usecases"):
        for path in sorted((repository / room).rglob("*.py")):
            if set(path.parts) & set(below):
                continue
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.FunctionDef | ast.ClassDef):
                    names = {one.arg for one in ast.walk(node) if isinstance(one, ast.arg)}
                    if {"instrument", "sky_power"} <= names:
                        together.append(f"{path}:{node.name}")
    assert together == []
