import numpy as np
import pytest

from lbacal_core.audit.station import AuditedStation, split_stations
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.spectra.spectra import Spectra

HOURS = 24
START = 1_400_000_000.0
SIDEREAL_HOUR_S = 3590.17


@pytest.fixture
def spectra(low_band: Instrument) -> Spectra:
    """A sidereal day of six antennas."""
    return make_spectra(low_band, START + SIDEREAL_HOUR_S * np.arange(HOURS))


def make_spectra(low_band: Instrument, time: Floats) -> Spectra:
    """Six antennas by the formula of the chain, without noise, but for gains of a per cent."""
    sky_power = compute_sky_power(low_band, antenna="hamaker")
    lst = local_sidereal_time(time, low_band.longitude_deg)
    rng = np.random.default_rng(4)
    gain = low_band.antenna_gain * low_band.receiver_gain
    rows, station = [], "CS002"
    for antenna in range(6):
        loss = low_band.cables[low_band.cable_of(station, antenna, START)]
        for dipole in ("X", "Y"):
            seen = sky_power.at(dipole, lst)
            rows.append((seen + 0.3 * seen.mean(axis=0)) * loss * gain * rng.normal(1.0, 0.01))
    paths = [(antenna, dipole) for antenna in range(6) for dipole in ("X", "Y")]
    return Spectra(
        frequency_mhz=low_band.frequency_mhz,
        power=np.concatenate(rows),
        event_id=np.tile([f"e{k}" for k in range(time.size)], len(paths)),
        time_unix=np.tile(time, len(paths)),
        station=np.full(time.size * len(paths), station),
        antenna=np.repeat([antenna for antenna, _ in paths], time.size),
        dipole=np.repeat([dipole for _, dipole in paths], time.size),
        blocks=np.full(time.size * len(paths), 100),
    )


@pytest.fixture
def station(spectra: Spectra, low_band: Instrument) -> AuditedStation:
    return next(split_stations(spectra, low_band))
