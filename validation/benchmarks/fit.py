"""A year of the whole array in one fit, against SciPy's general minimiser on one path of it.

Run: .venv/bin/python -m validation.benchmarks.fit

On two idle cores (three runs, commit 8f50095): 576 paths x 900 events x 51 channels in one call after loading in 0.93
to 1.00 s by the clock, 1.7 to 1.8 s of processor time, of it the digest of the input 0.21 s. SciPy's `least_squares`
for one path, times 576, takes 250 to 280 times as long; both find the same C to 1e-5 of its error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from threadpoolctl import threadpool_limits

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.lines import ChainForms, fit_lines
from lbacal_core.curves.curves import FitReport
from lbacal_core.grids import Floats
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.spectra.blocks import split_into_blocks
from lbacal_core.spectra.spectra import Spectra
from validation.benchmarks.timing import Result, time_once
from validation.fit import COMMON_GAIN, PATH_GAIN, RADIOMETER, YEAR_S, YEAR_START, Scene, scene_of_noise_terms
from validation.superterp import superterp

STATIONS, ANTENNAS, EVENTS = 6, 48, 900
REPEATS = 3


def make_scene(stations: int, antennas: int) -> Scene:
    """The Superterp's chain with any number of stations and antennas on one cable."""
    instrument = superterp()
    cable = instrument.antennas[0].cable
    records = [AntennaRecord(f"CS{k + 2:03d}", a, cable) for k in range(stations) for a in range(antennas)]
    instrument = replace(instrument, antennas=tuple(records))
    return scene_of_noise_terms(instrument, compute_sky_power(instrument))


def make_spectra(scene: Scene, events: int, rng: np.random.Generator) -> Spectra:
    """A year of every path, one event after the other as they arrive."""
    time_unix = YEAR_START + np.sort(rng.uniform(0, YEAR_S, events))
    lst = local_sidereal_time(time_unix, scene.instrument.longitude_deg)
    mean = {dipole: scene.mean_power(scene.sky_power.at(dipole, lst)) for dipole in ("X", "Y")}
    keys = [(r.station, r.antenna, dipole) for r in scene.instrument.antennas for dipole in mean]
    common = COMMON_GAIN * rng.standard_normal((events, 1))
    power = np.empty((events, len(keys), scene.slope.size))
    for k, (_, _, dipole) in enumerate(keys):
        gain = 1 + common + PATH_GAIN * rng.standard_normal((events, 1))
        power[:, k] = mean[dipole] * gain * rng.gamma(RADIOMETER**-2, RADIOMETER**2, mean[dipole].shape)
    station, antenna, dipole = (np.tile(column, events) for column in zip(*keys, strict=True))
    return Spectra(
        frequency_mhz=scene.instrument.frequency_mhz,
        power=power.reshape(-1, scene.slope.size),
        event_id=np.repeat([f"E{k:06d}" for k in range(events)], len(keys)),
        time_unix=np.repeat(time_unix, len(keys)),
        station=station,
        antenna=antenna,
        dipole=dipole,
        blocks=np.full(events * len(keys), 100),
    )


def measure(work: Callable[[], Result], repeats: int = REPEATS) -> tuple[Result, float, float]:
    """The result, and the smallest time by the clock and of the processor of some repeats, s."""
    done = [time_once(work) for _ in range(repeats)]
    return done[-1][0], min(wall for _, wall, _ in done), min(cpu for _, _, cpu in done)


class OnePath:
    """The chi^2 that the fit minimises for one path, written for a general minimiser: 54 parameters, whitened spectra.

    The weights are the fit's own (levels and unweighted lines), so that both have the same minimum.
    """

    def __init__(self, scene: Scene, power: Floats, sky: Floats) -> None:
        instrument = scene.instrument
        self.receiver_gain, self.power, self.sky = instrument.receiver_gain, power, sky
        lines = [np.polyfit(x, y, 1) for x, y in zip(sky.T, power.T, strict=True)]
        self.model = np.stack([np.polyval(line, x) for line, x in zip(lines, sky.T, strict=True)], axis=1)
        forms = ChainForms.of(instrument.frequency_mhz, instrument.antenna_gain, instrument.receiver_gain)
        fitted = fit_lines(power[None], sky, np.ones((1, len(power))), forms)
        vectors = fitted.shared.constant[0] - fitted.shared.behind[0] / self.model[:, None, :]
        covariance = np.diag(fitted.levels.radiometer[0] ** 2) + np.swapaxes(vectors, 1, 2) @ vectors
        self.whitener = np.swapaxes(np.linalg.inv(np.linalg.cholesky(covariance)), 1, 2)
        self.start = np.concatenate([[line[0] for line in lines], 0.5 * np.array(scene.noise)])

    def residual(self, parameters: Floats) -> Floats:
        """Whitened relative residuals, shape (event x freq,); parameters in units of their start."""
        slope, (n_lna, n_rcu, n_adc) = np.split(parameters * self.start, [self.sky.shape[1]])
        power = slope * (self.sky + n_lna) + n_rcu * self.receiver_gain + n_adc
        relative = (self.power - power) / self.model
        return np.asarray((relative[:, None, :] @ self.whitener).ravel())

    def jacobian(self, parameters: Floats) -> Floats:
        """Derivative of the model, shape (event x freq, parameter)."""
        channels = self.sky.shape[1]
        slope, (n_lna, _, _) = np.split(parameters * self.start, [channels])
        derivative = np.zeros((*self.sky.shape, channels + 3))
        at = np.arange(channels)
        derivative[:, at, at] = self.sky + n_lna
        derivative[:, :, channels] = slope
        derivative[:, :, channels + 1] = self.receiver_gain
        derivative[:, :, channels + 2] = 1.0
        derivative *= -self.start / self.model[:, :, None]
        return np.matmul(np.swapaxes(self.whitener, 1, 2), derivative).reshape(-1, channels + 3)

    def minimise(self, jacobian: str | Callable[[Floats], Floats]) -> OptimizeResult:
        """SciPy's trust-region least squares with its own tolerances."""
        return least_squares(self.residual, np.ones_like(self.start), jac=jacobian)


def farthest(report: FitReport, scene: Scene, found: OptimizeResult, path: OnePath) -> float:
    """Largest difference of C between the fit's first curve and SciPy's, in standard deviations."""
    curve = report.curves[0]
    assert curve.c is not None, curve.status  # noqa: S101
    slope = (found.x * path.start)[: curve.c.size]
    return float(np.max(np.abs(np.sqrt(scene.instrument.antenna_gain / slope) - curve.c) / curve.c_sigma_stat))


def main() -> None:
    scene = make_scene(STATIONS, ANTENNAS)
    spectra = make_spectra(scene, EVENTS, np.random.default_rng(1))
    paths = 2 * STATIONS * ANTENNAS

    report, wall, cpu = measure(lambda: fit_calibration(spectra, Simulation(scene.instrument, scene.sky_power)))
    print(f"{paths} paths x {EVENTS} events, one fit: {wall:.2f} s (processor {cpu:.2f} s), {report.status}")
    with threadpool_limits(1):
        _, part_wall, part_cpu = measure(spectra.digest)
        print(f"  of it the digest of the spectra alone: {part_wall:.2f} s (processor {part_cpu:.2f} s)")
        blocks, part_wall, part_cpu = measure(lambda: split_into_blocks(spectra))
        print(f"  laying all blocks out at once: {part_wall:.2f} s (processor {part_cpu:.2f} s)")
        block = blocks[0]
        lst = local_sidereal_time(block.time_unix, scene.instrument.longitude_deg)
        path = OnePath(scene, block.power[0], scene.sky_power.at(block.dipole, lst))
        for name, jacobian in (("finite differences", "2-point"), ("analytic derivatives", path.jacobian)):
            found, one_wall, one_cpu = measure(lambda jacobian=jacobian: path.minimise(jacobian), 1)
            differs = farthest(report, scene, found, path)
            print(
                f"scipy.optimize.least_squares, {name}, one path: {one_wall:.2f} s (processor {one_cpu:.2f} s), "
                f"status {found.status}, {found.nfev} steps, C differs by <= {differs:.1e} "
                f"sigma; x {paths} / the fit: {one_wall * paths / wall:.0f} (processor {one_cpu * paths / cpu:.0f})"
            )


if __name__ == "__main__":
    main()
