"""The fit reaches the Fisher bound and states its errors right, on many independent data sets of one path.

A data set is 900 events of a year with P_sky given: gamma radiometer noise, a gain of the path and one common to the
array in each event. The forward simulation and the bound are written out here and share nothing with the chain and
the fit. Errors are almost fully correlated along frequency, so a data set counts as one draw.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves import CONVERGED
from lbacal_core.data.tables import read_table
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument, load_instrument
from lbacal_core.sidereal import local_sidereal_time
from lbacal_core.skypower.table import SkyPower, read_sky_power
from lbacal_core.spectra import Spectra, read_spectra

EXAMPLES = Path(__file__).parents[2] / "shared" / "examples"
EVENTS = 900
RADIOMETER, PATH_GAIN, COMMON_GAIN = 0.045, 0.03, 0.02
YEAR_START, YEAR_S = 1_388_534_400.0, 365.25 * 86_400.0
NAMES = ("n_lna", "n_rcu", "n_adc")
LARGEST_RATIO, LARGEST_MEAN, SPREAD = 1.1, 0.1, (0.9, 1.1)


@dataclass(frozen=True)
class Scene:
    """The inputs of the fit and the truth behind the spectra: slope s (freq,) and the three noise constants."""

    name: str
    instrument: Instrument
    sky_power: SkyPower
    slope: Floats
    noise: tuple[float, float, float]

    def mean_power(self, sky: Floats) -> Floats:
        """Noiseless recorded power for P_sky, shape (event, freq)."""
        n_lna, n_rcu, n_adc = self.noise
        return self.slope * (sky + n_lna) + n_rcu * self.instrument.receiver_gain + n_adc

    def true_c(self) -> Floats:
        """C = (A L_coax G_RCU S)^-1/2, shape (freq,)."""
        return np.sqrt(self.instrument.antenna_gain / self.slope)

    def sky_at(self, lst_hours: Floats) -> Floats:
        """P_sky of the X dipole, shape (event, freq): its Fourier series, term by term."""
        table, grid = self.sky_power.power["X"], self.sky_power.lst_hours
        sky = np.tile(table.mean(axis=0), (lst_hours.size, 1))
        for m in range(1, (grid.size + 1) // 2):
            phase, at = 2 * np.pi * m * grid / 24, 2 * np.pi * m * lst_hours / 24
            sky += 2 / grid.size * np.outer(np.cos(at), np.cos(phase) @ table)
            sky += 2 / grid.size * np.outer(np.sin(at), np.sin(phase) @ table)
        return sky

    def draw(self, rng: np.random.Generator) -> tuple[Spectra, Floats]:
        """The spectra of one path over a year and P_sky at its events."""
        time_unix = YEAR_START + np.sort(rng.uniform(0, YEAR_S, EVENTS))
        sky = self.sky_at(local_sidereal_time(time_unix, self.instrument.longitude_deg))
        gain = 1 + PATH_GAIN * rng.standard_normal((EVENTS, 1)) + COMMON_GAIN * rng.standard_normal((EVENTS, 1))
        radiometer = rng.gamma(RADIOMETER**-2, RADIOMETER**2, sky.shape)
        antenna = self.instrument.antennas[0]
        spectra = Spectra(
            frequency_mhz=self.instrument.frequency_mhz,
            power=self.mean_power(sky) * gain * radiometer,
            event_id=np.array([f"E{k:05d}" for k in range(EVENTS)]),
            time_unix=time_unix,
            station=np.full(EVENTS, antenna.station),
            antenna=np.full(EVENTS, antenna.antenna),
            dipole=np.full(EVENTS, "X"),
            blocks=np.full(EVENTS, 100),
        )
        return spectra, sky

    def smallest_errors(self, sky: Floats) -> Floats:
        """Fisher bound on the relative error of C in each channel and of the noise constants, shape (freq + 3,).

        The sum over events of J^T Cov^-1 J with the true covariance of ln P and all parameters (ln A per channel, the
        logarithms of the noise constants). A gamma variate of known shape says 1/sigma^2 about the logarithm of its
        mean and no more, so no term for the dependence of the covariance on the parameters is missing.
        """
        n_lna, n_rcu, n_adc = self.noise
        channels = self.slope.size
        covariance = RADIOMETER**2 * np.eye(channels) + (PATH_GAIN**2 + COMMON_GAIN**2)
        inverse = np.linalg.inv(covariance)
        information = np.zeros((channels + 3, channels + 3))
        for sky_of_event, power in zip(sky, self.mean_power(sky), strict=True):
            jacobian = np.column_stack(
                [
                    np.diag(self.slope * (sky_of_event + n_lna) / power),
                    self.slope * n_lna / power,
                    self.instrument.receiver_gain * n_rcu / power,
                    n_adc / power,
                ]
            )
            information += jacobian.T @ inverse @ jacobian
        sigma = np.sqrt(np.diag(np.linalg.inv(information)))
        # C goes with A^-1/2
        return np.concatenate([sigma[:channels] / 2, sigma[channels:]])


@dataclass(frozen=True)
class Outcome:
    """Results of data sets, shape (data set, freq + 3): relative errors of C and the constants, pulls, bounds."""

    error: Floats
    pull: Floats
    bound: Floats
    chi2_per_dof: Floats


def scene_of_example(instrument: Instrument, sky_power: SkyPower, spectra: Spectra) -> Scene:
    """The slope and the noise constants that a fit of example spectra finds for their mean X dipole."""
    curve = fit_calibration(spectra, instrument, sky_power, "array").curves[0]
    assert curve.c is not None, f"the example gave no curve: {curve.status}"  # noqa: S101
    n_lna, n_rcu, n_adc = (curve.parameters[name].value for name in NAMES)
    return Scene("example", instrument, sky_power, instrument.antenna_gain / curve.c**2, (n_lna, n_rcu, n_adc))


def scene_of_noise_terms(instrument: Instrument, sky_power: SkyPower) -> Scene:
    """The published shares of sky, LNA, RCU and ADC at the chain input, as constants of the chain (N_ADC = 1).

    There the ADC's share of the sky's is N_ADC / (s P_sky), which gives s; the RCU's of the ADC's N_RCU G_RCU / N_ADC.
    """
    table = read_table("noise_terms")
    at = {name: np.interp(instrument.frequency_mhz, table["mhz"], table[name]) for name in ("sky", "lna", "rcu", "adc")}
    mean_sky = sky_power.power["X"].mean(axis=0)
    n_lna = float(np.median(at["lna"] / at["sky"] * mean_sky))
    n_rcu = float(np.median(at["rcu"] / at["adc"] / instrument.receiver_gain))
    return Scene("noise_terms.csv", instrument, sky_power, at["sky"] / at["adc"] / mean_sky, (n_lna, n_rcu, 1.0))


def fit_data_sets(scene: Scene, data_sets: int, seed: int) -> Outcome:
    """Draw and fit independent data sets."""
    results = []
    for rng in np.random.default_rng(seed).spawn(data_sets):
        spectra, sky = scene.draw(rng)
        curve = fit_calibration(spectra, scene.instrument, scene.sky_power).curves[0]
        assert curve.status == CONVERGED, curve.status  # noqa: S101
        assert curve.c is not None  # noqa: S101
        assert curve.c_sigma_stat is not None  # noqa: S101
        fitted = [curve.parameters[name] for name in NAMES]
        truth = np.concatenate([scene.true_c(), scene.noise])
        error = np.concatenate([curve.c, [p.value for p in fitted]]) - truth
        sigma = np.concatenate([curve.c_sigma_stat, [p.sigma for p in fitted]])
        results.append((error / truth, error / sigma, scene.smallest_errors(sky), [curve.chi2_per_dof]))
    return Outcome(*(np.array(part) for part in zip(*results, strict=True)))


def judge(outcome: Outcome) -> tuple[bool, list[str]]:
    """Whether the claims hold, and the figures."""
    n = len(outcome.error)
    channels = outcome.error.shape[1] - len(NAMES)
    ratio = np.sqrt(np.mean((outcome.error / outcome.bound) ** 2, axis=0))
    mean, spread = outcome.pull.mean(axis=0), outcome.pull.std(axis=0, ddof=1)
    # factors of the 95 % interval of a standard deviation, and its half-width for a mean of pulls
    low, high = np.sqrt(n / chi2.ppf([0.975, 0.025], n))
    of_mean = 1.96 / np.sqrt(n)
    c = slice(0, channels)
    per_dof = outcome.chi2_per_dof
    lines = [
        "| | bound % | RMS error / bound | mean of pulls | their standard deviation |",
        "|---|---|---|---|---|",
    ]
    worst = int(np.argmax(ratio[c])), int(np.argmax(np.abs(mean[c]))), int(np.argmax(np.abs(spread[c] - 1)))
    rows = [("C, channel farthest off", worst)] + [(name.upper(), (k, k, k)) for k, name in enumerate(NAMES, channels)]
    for name, (r, m, s) in rows:
        cells = (
            name,
            f"{100 * outcome.bound[:, r].mean():.2f}",
            f"{ratio[r]:.3f} ({ratio[r] * low:.3f}-{ratio[r] * high:.3f})",
            f"{mean[m]:+.3f} +- {of_mean:.3f}",
            f"{spread[s]:.3f} ({spread[s] * low:.3f}-{spread[s] * high:.3f})",
        )
        lines.append(f"| {' | '.join(cells)} |")
    bound = 100 * np.median(outcome.bound[:, c])
    lines.append(
        f"| C, all channels | {bound:.2f} | {ratio[c].mean():.3f} | {mean[c].mean():+.3f} | {spread[c].mean():.3f} |"
    )
    of_chi2 = 1.96 * per_dof.std(ddof=1) / np.sqrt(n)
    median = 100 * np.median(np.abs(outcome.error[:, c]))
    lines += ["", f"Median |error| of C {median:.3f} %; chi2_per_dof {per_dof.mean():.3f} +- {of_chi2:.3f}."]
    is_efficient = bool(np.all(ratio[c] <= LARGEST_RATIO))
    is_centred = bool(np.all(np.abs(mean) <= LARGEST_MEAN))
    is_calibrated = bool(np.all((spread >= SPREAD[0]) & (spread <= SPREAD[1])))
    return is_efficient and is_centred and is_calibrated, lines


def load_scenes(instrument: str | None, sky_power: Path | None, spectra: Path | None) -> list[Scene]:
    """The scenes of named files, of the examples where they exist, or of the package's own sky."""
    if instrument is None and EXAMPLES.is_dir():
        instrument = str(EXAMPLES / "instrument.json")
        sky_power, spectra = sky_power or EXAMPLES / "sky_power.json", spectra or EXAMPLES / "spectra.h5"
    loaded = load_instrument(instrument or "lofar-superterp")
    if sky_power is None:
        from lbacal_core.skypower.model import compute_sky_power

        sky = compute_sky_power(loaded)
    else:
        sky = read_sky_power(sky_power)
    scenes = [scene_of_noise_terms(loaded, sky)]
    return [scene_of_example(loaded, sky, read_spectra(spectra)), *scenes] if spectra else scenes


def prove(arguments: Sequence[str]) -> tuple[bool, list[str]]:
    parser = argparse.ArgumentParser(prog="./dev prove fit", description=__doc__)
    parser.add_argument("--data-sets", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=20_141_101)
    parser.add_argument("--instrument", help="name or file; the examples beside the project unless given")
    parser.add_argument("--sky-power", type=Path, help="file; computed where it is not given")
    parser.add_argument("--spectra", type=Path, help="file: its fitted noise constants are a scene of their own")
    options = parser.parse_args(arguments)
    figures, is_proven = [], True
    for scene in load_scenes(options.instrument, options.sky_power, options.spectra):
        holds, lines = judge(fit_data_sets(scene, options.data_sets, options.seed))
        is_proven &= holds
        title = f"**Noise of {scene.name}**, {options.data_sets} data sets: {'holds' if holds else 'DOES NOT HOLD'}"
        figures += ["", title, "", *lines]
    asked = f"RMS error of C within {LARGEST_RATIO} of the bound in every channel, mean of pulls within {LARGEST_MEAN}"
    asked += f" and their standard deviation {SPREAD[0]}-{SPREAD[1]} for every channel and constant"
    return is_proven, [f"One path, {EVENTS} events a data set. Asked: {asked}. 95 % intervals.", *figures]
