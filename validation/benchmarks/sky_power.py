"""Speed of P_sky(LST, nu), as ratios measured in one run: .venv/bin/python -m validation.benchmarks.sky_power.

96 LST x 51 channels, one dipole, embedded sky: the Fourier series against the plain sum over pixels (nside 64), and
a new beam or a new sky against the full evaluation.
"""

from __future__ import annotations

import numpy as np

from lbacal_core.antenna.lofar import load_hamaker
from lbacal_core.antenna.varied import VariedAntenna
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.sky.model import DATA_EPOCH, precess_multipoles
from lbacal_core.sky.modes import beam_multipoles, combine, sky_power_at, sky_power_modes
from lbacal_core.sky.names import load_sky
from validation.benchmarks.timing import processor_times, time_once
from validation.pixels import sum_over_pixels

ARM_DEG = 45.0


def main() -> None:
    instrument = load_instrument("lofar-superterp")
    nu, latitude = instrument.frequency_mhz, instrument.latitude_deg
    sky, antenna = load_sky("gsm"), load_hamaker()
    lst = np.arange(96) / 4
    temperature = precess_multipoles(sky.temperature(nu), DATA_EPOCH)
    beam = beam_multipoles(antenna, nu, sky.lmax)
    varied = VariedAntenna(antenna, zenith_gain=0.05)
    scaled = sky.changed(scale=1.1, spectral_index=0.05)

    def new_beam() -> object:
        changed = beam_multipoles(varied, nu, sky.lmax)
        return sky_power_at(combine(temperature, changed, ARM_DEG, latitude, nu), lst)

    def new_azimuth() -> object:
        return sky_power_at(combine(temperature, beam, ARM_DEG + 1.0, latitude, nu), lst)

    def new_sky() -> object:
        changed = precess_multipoles(scaled.temperature(nu), DATA_EPOCH)
        return sky_power_at(combine(changed, beam, ARM_DEG, latitude, nu), lst)

    def everything() -> object:
        return sky_power_at(sky_power_modes(sky, antenna, ARM_DEG, latitude, nu), lst)

    works = {"new beam shape": new_beam, "new azimuth": new_azimuth, "new sky parameters": new_sky}
    full, *news = processor_times({"everything": everything, **works}, 5).values()
    # Four of the 96 LST: the plain sum does nothing once for all, so its time is proportional.
    plain = 24 * time_once(lambda: sum_over_pixels(sky, antenna, ARM_DEG, latitude, lst[::24], nu))[2]
    print(f"plain sum, beam evaluated at each LST: {plain:.1f} s (4 of 96 LST measured)")
    print(f"Fourier series, everything: {full * 1e3:.1f} ms, {plain / full:.0f} times faster")
    for name, duration in zip(works, news, strict=True):
        print(
            f"{name}: {duration * 1e3:.1f} ms, {full / duration:.1f} x everything, {plain / duration:.0f} x plain sum"
        )


if __name__ == "__main__":
    main()
