"""Make lbacal_core/data/instruments/lofar-superterp.json from published tables and measured files.

    .venv/bin/python validation/scripts/make_superterp.py ../shared/data

Position: phase centre of the LBA field of station CS002 in ETRS, (3826577.462, 461022.624, 5064892.526) m, as in the
LOFAR antenna field files and in the clock files of pulsar timing (TEMPO, PINT); geodetic on the ellipsoid of GRS80.

Dipoles: the X arm lies NE-SW, azimuth 45 deg, the Y arm SE-NW, azimuth 135 deg. Two independent sources: EveryBeam
turns its X dipole to 5/4 pi in (east, north), which is SW; the LOFAR detector table of NuRadioMC orients
LOFAR_LBA_X at 225 deg and LOFAR_LBA_Y at 135 deg from east through north. The letters of data are another matter:
docs/decisions/dipole-letters.md.

Cables: the antennas 48-95 of the outer field are connected to the input LBL of RCUs 2n and 2n+1 (AntennaSet.conf of
LOFAR: LBA_OUTER is input "l"; PyCRTools reads the column LBL for LBA_OUTER). Both RCUs of an antenna agree in all six
stations but for CS002, RCU 84 (80 m) and 85 (115 m). The station's gain table of that mode shows a delay of 145 ns
left over at RCU 84 beside 6 ns at its neighbours, and the two lengths differ by 138.6 ns: the cable is 115 m, and
the script finds that by itself.

G_ant: N_ADC and C are published, so G_ant is proportional to C^2 / N_ADC,in (N_ADC referred to the chain's input,
eq. full_chain with eq. cal_equation). Against the simulated antenna this is right to 2 % at 40-70 MHz, +10 % at 30,
-17 % at 80. The scale, in m^2 for P_sky with R_r = 50 ohm, is that with which four measured traces (CS011,
2011-07-19), the published C and the published share of the sky agree with our P_sky. It is 0.68 of the simulated
antenna's: C is that of the paper, and is not to be combined with another antenna's height. C/|H| is free of all this.
"""

from __future__ import annotations

import json
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from astropy import units
from astropy.coordinates import EarthLocation

from lbacal_core.antenna.names import load_antenna
from lbacal_core.data.tables import read_columns
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.sky.modes import sky_power_at, sky_power_modes
from lbacal_core.sky.names import load_sky

TARGET = Path(__file__).parents[2] / "lbacal_core" / "data" / "instruments" / "lofar-superterp.json"
STATIONS = [f"CS00{number}" for number in range(2, 8)]
AZIMUTH_DEG = {"X": 45.0, "Y": 135.0}
GAIN_SOURCE = (
    "made from the published C(nu) and N_ADC of Mulrey et al. 2019, scaled with four traces of CS011 and P_sky of gsm: "
    "a fit of data like the paper's gives the published C by construction"
)
SHAPE_ERROR = ((30.0, 40.0, 70.0, 80.0), (0.10, 0.02, 0.02, 0.17))
"""MHz, and the departure of G_ant from the simulated antenna once their levels agree."""
SCALE_ERROR = 0.39
"""G_ant is 0.68 of that of the simulated antenna at 40-65 MHz, |ln 0.68|; the traces alone fix it within 0.2."""
TRACE_TIME = datetime(2011, 7, 19, 11, 5, 41, tzinfo=UTC)


def residual_delay_ns(data: Path, station: str, rcu: int) -> float:
    """Delay that the station's gain table of mode 1 corrects beyond the recorded cables, against RCU 0."""
    gains = np.frombuffer((data / f"caltables/CalTable_{station[2:]}_mode1.dat").read_bytes(), dtype="<c16")
    gains = gains.reshape(512, 96)
    frequency_mhz = np.arange(512) * 100 / 512
    band = (frequency_mhz > 40) & (frequency_mhz < 70)
    phase = np.unwrap(np.angle(gains[band, rcu] * gains[band, 0].conj()))
    return float(np.polyfit(frequency_mhz[band], phase, 1)[0] / (2 * np.pi) * 1e3)


def cables(data: Path, station: str) -> list[str]:
    """Cable name of antennas 0-47 of the outer field: column LBL of RCUs 2n and 2n+1."""
    text = (data / f"caltables/{station}-CableDelays.conf").read_text()
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    length = {int(row[0]): row[1] for row in rows}
    delay = {row[1]: float(row[2]) for row in rows}
    names = []
    for antenna in range(48):
        pair = [length[2 * antenna], length[2 * antenna + 1]]
        if pair[0] != pair[1]:
            left = [residual_delay_ns(data, station, 2 * antenna + side) for side in (0, 1)]
            wrong = int(np.argmax(np.abs(left)))
            print(f"{station} antenna {antenna}: RCUs say {pair} m, delays left {left} ns,", end=" ")
            print(f"lengths differ by {delay[pair[1 - wrong]] - delay[pair[wrong]]:.1f} ns: {pair[1 - wrong]} m taken")
            pair[wrong] = pair[1 - wrong]
        names.append(pair[0])
    return names


def measured_power(path: Path, frequency_mhz: np.ndarray) -> np.ndarray:
    """One-sided power of a raw trace per channel, ADC^2/ohm/MHz at R_r = 50 ohm, by the median over blocks."""
    frames = np.fromfile(path, np.uint8).reshape(-1, 2140)
    samples = frames[:, 88 : 88 + 2048].copy().view("<i2").astype(float).reshape(-1, 1024)
    window = np.hanning(1024)
    window /= np.sqrt(np.mean(window**2))
    spectrum = np.abs(np.fft.rfft((samples - samples.mean(axis=1, keepdims=True)) * window)) ** 2
    power = np.median(spectrum, axis=0) / np.log(2) * 2 / 1024**2 / 50.0 / (200 / 1024)
    grid = np.arange(513) * 200 / 1024
    return np.array([np.median(power[np.abs(grid - nu) < 0.5]) for nu in frequency_mhz])


def main(folder: str) -> None:
    data = Path(folder)
    place = EarthLocation.from_geocentric(3826577.462, 461022.624, 5064892.526, unit=units.m).to_geodetic("GRS80")
    latitude, longitude = round(place.lat.deg, 5), round(place.lon.deg, 5)
    names = ("receiver_gain", "noise_terms", "published_calibration", "cable_attenuation")
    receiver, noise, published, coax = (read_columns(data / f"{name}.csv") for name in names)
    frequency_mhz = receiver["mhz"]
    shape = published["c"] ** 2 / noise["adc"]

    sky, antenna = load_sky("gsm"), load_antenna("hamaker")
    lst = local_sidereal_time(np.array([TRACE_TIME.timestamp()]), longitude)
    modes = [sky_power_modes(sky, antenna, arm, latitude, frequency_mhz) for arm in AZIMUTH_DEG.values()]
    sky_power = np.mean([sky_power_at(m, lst)[0] for m in modes], axis=0)
    measured = np.mean([measured_power(path, frequency_mhz) for path in sorted((data / "tbb").glob("*.dat"))], axis=0)
    gain = published["c"] ** 2 * measured * noise["sky"] / noise["total_system"] / sky_power
    band = (frequency_mhz >= 40) & (frequency_mhz <= 70)
    ratio = gain / shape
    scale = float(np.median(ratio[band]))
    print("G_ant by traces over its shape, 40-70 MHz, 16-84 %:", np.percentile(ratio[band] / scale, [16, 84]).round(3))

    antennas = [
        {"station": station, "antenna": number, "cable": cable}
        for station in STATIONS
        for number, cable in enumerate(cables(data, station))
    ]
    content = {
        "name": "lofar-superterp",
        "latitude_deg": latitude,
        "longitude_deg": longitude,
        "height_m": round(place.height.to_value("m"), 1),
        "frequency_mhz": frequency_mhz.tolist(),
        "dipoles": {name: {"azimuth_deg": azimuth} for name, azimuth in AZIMUTH_DEG.items()},
        "antenna": "hamaker",
        "sky": "gsm",
        "antenna_gain_provenance": {
            "kind": "relative",
            "source": GAIN_SOURCE,
            "shape_error": np.interp(frequency_mhz, *SHAPE_ERROR).round(3).tolist(),
            "scale_error": SCALE_ERROR,
        },
        "antenna_gain": [float(f"{value:.5g}") for value in scale * shape],
        "receiver_gain": [float(f"{value:.6g}") for value in 10 ** (receiver["gain_db"] / 10)],
        "cables": {
            name: [float(f"{value:.6g}") for value in 10 ** (-coax[f"loss_{name}m_db"] / 10)]
            for name in ("50", "80", "115")
        },
        "antennas": antennas,
    }
    head = ",\n".join(f'"{key}": {json.dumps(value)}' for key, value in content.items() if key != "antennas")
    rows = ",\n".join(json.dumps(record) for record in antennas)
    TARGET.write_text(f'{{\n{head},\n"antennas": [\n{rows}\n]\n}}\n')


if __name__ == "__main__":
    main(sys.argv[1])
