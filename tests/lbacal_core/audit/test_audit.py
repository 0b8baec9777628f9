from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.audit import EVENTS, audit, audit_quickly
from lbacal_core.audit.verdict import ALIKE
from lbacal_core.calibration.chain_test import LIKELY_MISTAKE
from lbacal_core.curves.curves import FitReport
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.pipeline import calibrate
from lbacal_core.provenance import Provenance
from lbacal_core.readers.open import choose_channels, open_source
from lbacal_core.readers.source import average
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.spectra.spectra import Spectra, join_spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from tests import short_dipole


def test_a_healthy_station_is_said_to_be_healthy_and_its_power_is_accepted(spectra, low_band):
    report = audit(spectra, low_band, antenna="hamaker")
    assert report.is_healthy
    assert report.as_dict()["stations"] == [
        {"station": "CS002", "antennas": 6, "spectra": 6 * 2 * 24, "hours": pytest.approx(24.0)}
    ]
    found = audit_quickly(spectra, low_band)
    assert found.sentence == "nothing wrong between 6 antennas (paths, cables, letters of single antennas, steps, unit)"
    found.require_power("s.h5")


def exchange(spectra, rows):
    return replace(spectra, dipole=np.where(rows, np.where(spectra.dipole == "X", "Y", "X"), spectra.dipole))


def kill(spectra, rows):
    return replace(spectra, power=np.where(rows[:, None], 1e-3, 1.0) * spectra.power)


def in_long_cables(spectra, low_band):
    """Cables of four times the length on record, and the power that they leave."""
    lossy = replace(low_band, cables={name: loss**4 for name, loss in low_band.cables.items()})
    loss = np.array([low_band.cables[low_band.cable_of("CS002", int(a), 1.4e9)] for a in spectra.antenna])
    return lossy, spectra.power * loss**3


def test_two_faults_are_both_named(spectra, low_band):
    exchanged = exchange(spectra, spectra.antenna == 1)
    dead = kill(exchanged, (spectra.antenna == 4) & (exchanged.dipole == "X"))
    report = audit(dead, low_band, antenna="hamaker")
    wrong = {(line.check, line.antennas) for line in report.lines if line.verdict == "wrong"}
    assert wrong == {("exchange", (1,)), ("dead", (4,))}


@pytest.mark.parametrize(("antennas", "exchanged"), [(2, ()), (2, (1,)), (3, ()), (3, (2,)), (3, (0, 2)), (2, (0, 1))])
def test_of_two_or_three_antennas_the_sky_tells_which_are_exchanged(antennas, exchanged, spectra, low_band):
    """One of two was "X and Y are mixed, or an arm is turned" of the whole station."""
    few = exchange(few := spectra.select(spectra.antenna < antennas), np.isin(few.antenna, exchanged))
    report = audit(few, low_band, antenna="hamaker")
    wrong = [(line.kind, line.antennas) for line in report.lines if line.verdict == "wrong"]
    whole = len(exchanged) == antennas
    assert wrong == ([("exchange", () if whole else exchanged)] if exchanged else [])


def test_one_antenna_is_asked_what_it_saw_of_the_sky(spectra, low_band):
    """A single dipole, as EDGES or MIST, was refused whole: nothing is there to compare it with, but a sky is."""
    one = spectra.select(spectra.antenna == 2)
    healthy = {line.check: line.verdict for line in audit(one, low_band).lines}
    assert healthy == {"antennas": "undecided", "clock": "right", "arms": "right"}
    late = audit(replace(one, time_unix=one.time_unix + 3 * 3600.0), low_band)
    assert [line.check for line in late.lines if line.verdict == "wrong"] == ["clock"]


@pytest.mark.parametrize("place", [(52.9, 6.9), (79.4, -90.8), (-26.7, 116.6)])
@pytest.mark.parametrize("seed", [1, 2])
def test_daily_means_at_one_sidereal_time_say_nothing_of_clock_place_and_arms(place, seed):
    """82 days counted as 1940 hours: a clock off by 4-8 h was called wrong, or right, at one sidereal time."""
    instrument = short_dipole.make_instrument(*place)
    means = short_dipole.daily_means(instrument, np.random.default_rng(seed))
    report = audit(means, instrument)
    assert {line.verdict for line in report.lines} == {"undecided"}
    assert {line.check for line in report.lines} == {"antennas", "clock", "arms"}
    assert any("min of sidereal time do not determine clock and place" in line.sentence for line in report.lines)


@pytest.mark.parametrize("place", [(52.9, 6.9), (79.4, -90.8), (-26.7, 116.6)])
@pytest.mark.parametrize("antenna", ["short-dipole", "quarter-wave", "inverted-v"])
def test_a_receiver_that_follows_the_hour_is_no_wrong_clock(place, antenna):
    """3 % of colour in 24 h, one antenna: another wrong clock with each antenna model, at ln odds of 67 to 248."""
    instrument = short_dipole.make_instrument(*place)
    day = short_dipole.one_day(instrument, np.random.default_rng(9))
    phase = np.pi / 12 * (day.time_unix % 86_400 / 3600 - 14)
    colour = 1 + 0.03 * np.cos(phase)[:, None] * np.linspace(-1, 1, day.frequency_mhz.size)
    report = audit(replace(day, power=day.power * colour), instrument, antenna=antenna)
    assert not [line.sentence for line in report.lines if line.verdict == "wrong"]


def test_two_hours_in_which_no_other_unit_describes_the_cables_are_audited(spectra, low_band):
    lossy, power = in_long_cables(spectra, low_band)
    some = spectra.time_unix < np.sort(np.unique(spectra.time_unix))[3]
    short = replace(spectra, power=1e6 * power).select(some)
    assert {line.verdict for line in audit(short, lossy, antenna="hamaker").lines} == {"undecided"}


def test_a_clock_that_is_off_is_named_by_one_dipole_of_a_day():
    instrument = short_dipole.make_instrument()
    day = short_dipole.one_day(instrument, np.random.default_rng(9))
    late = audit(replace(day, time_unix=day.time_unix - 5 * 3600.0), instrument)
    ((check, value),) = [(line.check, line.value) for line in late.lines if line.verdict == "wrong"]
    assert (check, value) == ("clock", pytest.approx(5.0, abs=1.0))


def test_half_a_station_exchanged_is_the_half_that_the_sky_contradicts(spectra, low_band):
    report = audit(exchange(spectra, spectra.antenna % 2 == 0), low_band, antenna="hamaker")
    assert [line.antennas for line in report.lines if line.check == "exchange"] == [(0, 2, 4)]


@pytest.mark.long
@pytest.mark.shared
@pytest.mark.filterwarnings("ignore")  # pyuvdata's own, about the header of the file
def test_hera_antennas_of_one_snapshot_are_compared_and_no_clock_is_claimed(shared):
    source = open_source(shared / "data" / "other" / "hera_2459122.25108_autos.uvh5")
    spectra = average(source, 60.0, choose_channels(source, band_mhz=(50, 110), width_mhz=1.0)).spectra
    flat = np.ones(spectra.frequency_mhz.size)
    instrument = Instrument(
        "HERA", -30.7215, 21.4283, 1052.0, spectra.frequency_mhz, {"X": 0.0, "Y": 90.0}, flat, flat, {"none": flat},
        [AntennaRecord("HERA", int(a), "none") for a in np.unique(spectra.antenna)],
    )  # fmt: skip
    report = audit(spectra, instrument, antenna="hamaker")
    assert {line.verdict for line in report.lines if line.check in ("clock", "arms")} == {"undecided"}
    wrong = {(line.check, line.antennas) for line in report.lines if line.verdict == "wrong"}
    assert wrong == {("dead", (93,)), ("dead", (123,))}  # a hundredth of the others' power, in the file itself


@pytest.mark.shared
def test_eda2_at_one_frequency_shows_three_antennas_that_hardly_receive(shared):
    table = (shared / "data" / "other" / "eda2_autos_78mhz.csv").read_text().splitlines()
    values = [line.split(",") for line in table if line[0].isdigit()]
    paths = [(int(a), d, float(p)) for a, *both in values for d, p in zip("XY", both, strict=True) if float(p) > 0]
    one = np.ones(1)
    spectra = Spectra(
        np.array([78.125]), np.array([[power] for *_, power in paths]), np.full(len(paths), "e"),
        np.full(len(paths), 1_639_180_800.0), np.full(len(paths), "EDA2"), np.array([a for a, *_ in paths]),
        np.array([d for _, d, _ in paths]), np.ones(len(paths), dtype=np.int64),
    )  # fmt: skip
    instrument = Instrument(
        "EDA2", -26.7, 116.7, 370.0, np.array([78.125]), {"X": 90.0, "Y": 0.0}, one, one, {"none": one},
        [AntennaRecord("EDA2", antenna, "none") for antenna in range(256)],
    )  # fmt: skip
    lines = audit(spectra, instrument, antenna="hamaker").lines
    assert {a for line in lines if line.verdict == "wrong" for a in line.antennas} == {81, 129, 130}
    assert {line.verdict for line in lines if line.check in ("clock", "arms", "unit", "exchange")} == {"undecided"}


def test_a_dead_path_is_named_and_does_not_stop_the_work(spectra, low_band):
    found = audit_quickly(kill(spectra, (spectra.antenna == 4) & (spectra.dipole == "X")), low_band)
    assert found.sentence.startswith("1 wrong in 6 antennas (lbacal audit tells more): CS002: antenna 4 X is dead")
    found.require_power("s.h5")


def test_decibels_are_refused(spectra, low_band):
    lossy, power = in_long_cables(spectra, low_band)
    found = audit_quickly(replace(spectra, power=200.0 + 10 * np.log10(power)), lossy)
    with pytest.raises(BadInputError, match=r"s.h5: power: expected power per MHz .*the power is in decibels"):
        found.require_power("s.h5")


SUPERTERP = load_instrument("lofar-superterp")


def draw(antennas, events, seed, instrument=SUPERTERP):
    settings = TwinSettings(stations=("CS002",), antennas=antennas, events_per_year=events)
    return simulate_campaign(settings, instrument, compute_sky_power(instrument), np.random.default_rng(seed)).spectra


@pytest.fixture(scope="module")
def year() -> Spectra:
    return draw(6, 200, 3)


def test_half_of_the_antennas_by_6_db_are_no_decibels(year):
    """`fit` refused the file as decibels, ln odds 10; decibels described it no better than power did."""
    louder = replace(year, power=np.where(year.antenna[:, None] < 3, 4.0, 1.0) * year.power)
    found = audit_quickly(louder, SUPERTERP)
    found.require_power("s.h5")
    assert "antennas with the cable 115 lie -4.8 dB from what loss and others say" in found.sentence


@pytest.mark.long
@pytest.mark.parametrize("antenna", [0, 2, 5])
def test_an_antenna_whose_gain_doubles_for_a_quarter_of_the_year_is_not_exchanged(year, antenna):
    """Its step was the strongest change of ln P_X - ln P_Y, which the others ran against."""
    late = (year.time_unix > np.quantile(year.time_unix, 0.75)) & (year.antenna == antenna) & (year.dipole == "X")
    stepped = replace(year, power=np.where(late[:, None], 2.0, 1.0) * year.power)
    assert audit_quickly(stepped, SUPERTERP).sentence.startswith("nothing wrong")


def test_power_times_four_in_the_first_half_of_the_year_is_a_misfit_and_two_chains(year):
    """It was `converged`, and nothing was wrong: C stood for neither half."""
    first = year.time_unix[:, None] < np.median(year.time_unix)
    stepped = replace(year, power=np.where(first, 4.0, 1.0) * year.power)
    found = audit_quickly(stepped, SUPERTERP)
    assert "the power of all paths steps by -6.1 dB about 2014-07-01" in found.sentence
    assert {curve.status for curve in found.mark(calibrate(stepped, Simulation(SUPERTERP))).curves} == {"misfit"}
    assert audit_quickly(year, SUPERTERP).sentence.startswith("nothing wrong")


def test_nothing_is_not_wrong_under_a_fit_that_names_a_mistake(spectra, low_band):
    """`likely mistake: dipoles X and Y exchanged`, then `audit: nothing wrong (... exchanged letters ...)`."""
    found = audit_quickly(spectra, low_band)
    fitted = FitReport((), Provenance({}))
    assert found.mark(fitted).provenance.notes["audit"] == found.sentence
    named = replace(fitted, provenance=fitted.provenance.with_note(LIKELY_MISTAKE, "dipoles X and Y exchanged"))
    assert "audit" not in found.mark(named).provenance.notes
    dead = audit_quickly(kill(spectra, spectra.antenna == 4), low_band)
    assert "antenna 4 X is dead" in dead.mark(named).provenance.notes["audit"]


def test_volts_of_five_antennas_passed_where_cables_alone_do_not_tell():
    recorded = draw(5, 60, 2)
    audit_quickly(recorded, SUPERTERP).require_power("s.h5")
    with pytest.raises(BadInputError, match=r"an amplitude \(volts\), not its square"):
        audit_quickly(replace(recorded, power=recorded.power**0.5), SUPERTERP).require_power("s.h5")


def test_another_unit_behind_cables_of_one_name_is_told_and_not_found_right():
    """Decibels and amplitudes were `nothing wrong (... unit)`, without a line."""
    of_one = replace(SUPERTERP, antennas=[replace(record, cable="80") for record in SUPERTERP.antennas])
    power = draw(5, 60, 2, of_one)
    found = audit_quickly(power, of_one).sentence
    assert found == "nothing wrong between 5 antennas (paths, cables, letters of single antennas, steps)"
    assert all(line.log_odds < ALIKE for line in audit(power, of_one).lines if line.check == "unit")
    for values, named in ((10 * np.log10(power.power) + 60, "in decibels"), (power.power**0.5, "an amplitude")):
        recorded = replace(power, power=values)
        assert f"steps); CS002: perhaps the power is {named}" in audit_quickly(recorded, of_one).sentence
        (line,) = [line for line in audit(recorded, of_one).lines if line.check == "unit"]
        assert named in line.sentence


def test_no_spectra_are_left_to_what_comes_after(spectra, low_band):
    assert audit_quickly(spectra.select(np.zeros(0, dtype=np.int64)), low_band).report.stations == ()


def test_three_antennas_are_not_compared(spectra, low_band):
    found = audit_quickly(spectra.select(spectra.antenna < 3), low_band)
    assert found.sentence == "none: no station has 4 antennas to compare; `lbacal audit` asks the sky"
    found.require_power("s.h5")


def test_a_long_campaign_costs_no_more_than_a_hundred_events(spectra, low_band):
    copies = 3 * EVENTS // 24
    copied = [
        replace(spectra, event_id=np.char.add(spectra.event_id, f"-{k}"), time_unix=spectra.time_unix + 86_400.0 * k)
        for k in range(copies)
    ]
    many = join_spectra(copied)
    report = audit_quickly(many, low_band).report
    assert report is not None
    assert report.stations[0].time_unix.size == EVENTS


def test_one_channel_is_refused_before_a_fit_of_it_ends_in_a_traceback(spectra, low_band):
    one = replace(spectra, frequency_mhz=spectra.frequency_mhz[:1], power=spectra.power[:, :1])
    with pytest.raises(BadInputError, match=r"channels: expected at least 5 to fit a chain .*found 1"):
        audit_quickly(one, low_band)
