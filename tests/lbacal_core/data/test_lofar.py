from __future__ import annotations

from lbacal_core.data.lofar import DIPOLES, LOFAR_DEG, LOFAR_RADIUS_DEG
from lbacal_core.instrument.instrument import load_instrument


def test_the_shipped_superterp_has_these_letters_and_stands_there():
    superterp = load_instrument("lofar-superterp")
    assert superterp.dipoles == DIPOLES
    assert abs(superterp.latitude_deg - LOFAR_DEG[0]) < LOFAR_RADIUS_DEG
    assert abs(superterp.longitude_deg - LOFAR_DEG[1]) < LOFAR_RADIUS_DEG
