from collections import Counter

import numpy as np
import pytest

from lbacal_core.data.lofar import DIPOLES, LOFAR_DEG, LOFAR_RADIUS_DEG
from lbacal_core.instrument.instrument import load_instrument


def test_the_superterp_has_six_stations_of_48_antennas():
    instrument = load_instrument("lofar-superterp")
    assert Counter(record.station for record in instrument.antennas) == {f"CS00{n}": 48 for n in range(2, 8)}
    assert {record.cable for record in instrument.antennas} == {"50", "80", "115"}


def test_the_doubtful_cable_of_cs002_is_the_one_that_the_gain_table_shows():
    assert load_instrument("lofar-superterp").cable_of("CS002", 42, 1.4e9) == "115"


def test_the_antenna_resonates_near_58_mhz():
    instrument = load_instrument("lofar-superterp")
    assert 57 <= instrument.frequency_mhz[instrument.antenna_gain.argmax()] <= 60


@pytest.mark.shared
def test_g_ant_is_the_simulated_one_within_its_documented_error(shared):
    table = np.load(shared / "data/antenna/lba_vout.npz")
    simulated = (np.abs(table["v_theta"]) ** 2 + np.abs(table["v_phi"]) ** 2)[20:71, 0].mean(axis=1)
    instrument = load_instrument("lofar-superterp")
    ratio = instrument.antenna_gain / simulated
    band = (instrument.frequency_mhz >= 40) & (instrument.frequency_mhz <= 70)
    ratio /= np.median(ratio[band])
    assert np.std(ratio[band]) < 0.03  # 2 % and the reading of a figure
    assert ratio[0] == pytest.approx(1.10, abs=0.03)
    assert ratio[-1] == pytest.approx(0.83, abs=0.03)


def test_the_shipped_superterp_has_these_letters_and_stands_there():
    superterp = load_instrument("lofar-superterp")
    assert superterp.dipoles == DIPOLES
    assert abs(superterp.latitude_deg - LOFAR_DEG[0]) < LOFAR_RADIUS_DEG
    assert abs(superterp.longitude_deg - LOFAR_DEG[1]) < LOFAR_RADIUS_DEG
