"""The fit reaches the Fisher bound and states its errors right, on many independent data sets of one path.

A data set is 900 events of a year with P_sky given: gamma radiometer noise, a gain of the path and one common to the
array in each event. The forward simulation and the bound are written out here and share nothing with the chain and
the fit. Errors are almost fully correlated along frequency, so a data set counts as one draw.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from matplotlib.figure import Figure

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import CONVERGED
from lbacal_core.data.tables import read_table
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import SkyPower, read_sky_power
from lbacal_core.spectra.spectra import Spectra, read_spectra
from validation.machinery.claims import Found, mean_of, rate_of, spread_interval, spread_of, worst_of
from validation.machinery.parts import SHARED, Part, Row
from validation.superterp import power_of, superterp

EXAMPLES = SHARED / "examples"
EVENTS = 900
RADIOMETER, PATH_GAIN, COMMON_GAIN = 0.045, 0.03, 0.02
YEAR_START, YEAR_S = 1_388_534_400.0, 365.25 * 86_400.0
NAMES = ("n_lna", "n_rcu", "n_adc")
AT_MHZ = np.arange(30.0, 81.0, 5.0)
"""Channels that are kept of every data set; errors are almost fully correlated along frequency."""
LARGEST_RATIO, SPREAD = 1.1, (0.9, 1.1)


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


def scene_of_example(instrument: Instrument, sky_power: SkyPower, spectra: Spectra) -> Scene:
    """The slope and the noise constants that a fit of example spectra finds for their mean X dipole."""
    curve = fit_calibration(spectra, Simulation(instrument, sky_power), "array").curves[0]
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


def fit_one(scene: Scene, rng: np.random.Generator) -> Row:
    """Draw and fit a data set: errors over the Fisher bound and pulls of C at `AT_MHZ` and of the noise constants."""
    spectra, sky = scene.draw(rng)
    curve = fit_calibration(spectra, Simulation(scene.instrument, scene.sky_power)).curves[0]
    if curve.status != CONVERGED or curve.c is None or curve.c_sigma_stat is None or curve.chi2_per_dof is None:
        return {"status": curve.status}
    fitted = [curve.parameters[name] for name in NAMES]
    truth = np.concatenate([scene.true_c(), scene.noise])
    error = np.concatenate([curve.c, [p.value for p in fitted]]) - truth
    sigma = np.concatenate([curve.c_sigma_stat, [p.sigma for p in fitted]])
    bound = scene.smallest_errors(sky)
    at = np.concatenate([np.isin(scene.instrument.frequency_mhz, AT_MHZ), np.ones(len(NAMES), dtype=bool)])
    return {
        "status": curve.status,
        "error_over_bound": np.round((error / truth / bound)[at], 4).tolist(),
        "pull": np.round((error / sigma)[at], 4).tolist(),
        "median_error": float(np.median(np.abs(error / truth)[: -len(NAMES)])),
        "median_bound": float(np.median(bound[: -len(NAMES)])),
        "chi2_per_dof": round(curve.chi2_per_dof, 5),
    }


def judge(rows: Sequence[Row]) -> list[Found]:
    good = [row for row in rows if row["status"] == CONVERGED]
    ratio, pull = (np.array([row[name] for row in good]) for name in ("error_over_bound", "pull"))
    rms, n = np.sqrt(np.mean(ratio**2, axis=0)), len(good)
    return [
        rate_of("converged", n, len(rows)),
        worst_of([spread_of("efficiency", float(r), n) for r in rms], n),
        worst_of([mean_of("bias", p) for p in pull.T], n),
        worst_of([spread_of("errors", float(s), n) for s in pull.std(axis=0, ddof=1)], n),
        mean_of("chi2", np.array([row["chi2_per_dof"] for row in good])),
        mean_of("error", np.array([row["median_error"] for row in good]), "%"),
    ]


@cache
def example_scene() -> Scene:
    """The example beside the project: its instrument, sky power and the noise that a fit of its spectra finds."""
    instrument = load_instrument(str(EXAMPLES / "instrument.json"))
    return scene_of_example(
        instrument, read_sky_power(EXAMPLES / "sky_power.json"), read_spectra(EXAMPLES / "spectra.h5")
    )


@cache
def published_noise_scene() -> Scene:
    return scene_of_noise_terms(superterp(), power_of())


def fit_example(seed: int) -> Row:
    return fit_one(example_scene(), np.random.default_rng([20_141_101, seed]))


def fit_published_noise(seed: int) -> Row:
    return fit_one(published_noise_scene(), np.random.default_rng([20_141_102, seed]))


PARTS = (
    Part("published-noise", fit_published_noise, judge, 2000, headlines=("efficiency",), has_figure=True),
    Part("example", fit_example, judge, 1000, needs_shared=True, has_figure=True),
)
IMAGES = {"fit.png": "Error of the fit over the Fisher bound, and spread of its pulls"}


def draw(rows: Mapping[str, Sequence[Row]]) -> dict[str, Figure]:
    """Errors over the bound and spread of the pulls, channel by channel, of every scene."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    panels = dict(zip(("error_over_bound", "pull"), figure.subplots(1, 2, sharey=True), strict=True))
    names = [*(f"C at {mhz:g} MHz" for mhz in AT_MHZ), *(name.upper() for name in NAMES)]
    for k, (part, trials) in enumerate(sorted(rows.items())):
        good = [row for row in trials if row["status"] == CONVERGED]
        for name, axes in panels.items():
            rms = np.sqrt(np.mean(np.array([row[name] for row in good]) ** 2, axis=0))
            ends = np.array([spread_interval(one, len(good)) for one in rms])
            place = np.arange(len(names)) + 0.15 * (2 * k - 1)
            axes.errorbar(rms, place, xerr=np.abs(ends.T - rms), fmt="o", ms=3, label=f"{part}, {len(good)} data sets")
    for axes, (low, high) in zip(panels.values(), ((0.9, LARGEST_RATIO), SPREAD), strict=True):
        axes.axvspan(low, high, color="0.9", zorder=0)
        axes.axvline(1.0, color="0.6", lw=1)
    panels["error_over_bound"].set(
        xlabel="r.m.s. error / Fisher bound", yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.5, -0.5)
    )
    panels["pull"].set(xlabel="r.m.s. pull")
    figure.legend(*panels["pull"].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return {"fit.png": figure}
