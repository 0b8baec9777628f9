"""Data sets of drawn worlds: nothing hidden until a part hides something, and what the models leave of the sky."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.grids import Floats
from validation.hidden.data_sets import DataSet
from validation.hidden.ideal import IdealDetector, PathChains
from validation.hidden.noise import count_blocks, noise_of
from validation.hidden.worlds import EVENTS, EVERYTHING, OWN, STATION, draw, draw_antennas
from validation.machinery.parts import Row

SPANNED_SIGMA = 5.0
"""What the models leave of a world's difference, in standard deviations, below which they span it: about what a
detector needs that knows the template."""


def drawn_data(seed: int) -> DataSet:
    """A data set of a drawn world, with nothing hidden; in every third the station has more noise."""
    noisy = STATION if seed % 3 == 0 else "CS003"
    nuisances = replace(EVERYTHING, noisy_stations=(noisy,))
    return DataSet(seed, draw_antennas(seed), nuisances, EVENTS, world=draw(seed, OWN))


def describe_world(data: DataSet) -> Row:
    world = data.world
    if world is None:
        raise ValueError(f"data set {data.seed} has no world of its own")
    antenna = world.antenna.rpartition("/")[2].removesuffix(".npz")
    return {
        "sky": world.sky,
        "antenna": antenna,
        "noise": world.noise,
        "outside": world.outside,
        "antennas": len(data.antennas),
    }


def unspanned_sigma(data: DataSet) -> float:
    """The part of the difference between the finder's sky and the true one that its models do not span, in sigma.

    The ideal SNR of the mean of all antennas, the fit of the chain and the modes of the models left free.
    """
    truth = data.detector
    scene, chains = truth.station.scene, truth.chains

    def mean(values: Floats) -> Floats:
        return np.asarray(values.reshape(-1, len(DIPOLES), *values.shape[1:]).mean(axis=0))

    own_sky = np.stack([data.finder.power().at(dipole, scene.lst_hours) for dipole in DIPOLES])
    warmer = (mean(chains.sky) / own_sky).mean(axis=1, keepdims=True)
    believed = PathChains(
        own_sky,
        mean(chains.receiver),
        mean(chains.front) * warmer,
        mean(chains.n_lna) / warmer.mean(),
        mean(chains.n_rcu),
        mean(chains.n_adc),
    )
    power = mean(truth.power(()))
    blocks = count_blocks(data.spectra(), scene)
    antennas = len(scene.antennas)
    together = 1.0 / np.maximum(blocks.reshape(antennas, len(DIPOLES), -1).sum(axis=0), 1)
    shared = data.nuisances.sky_correlation
    independent = data.gains
    settings = replace(data.settings, event_gain_path=data.settings.event_gain_path / antennas**0.5)
    noise = noise_of(
        settings,
        replace(data.nuisances, sky_correlation=0.0),
        STATION,
        1.0 / ((1.0 - shared) * together + shared / 100.0),
        believed.columns[0],
        np.gradient(np.log(believed.front[:, 0]), scene.frequency_mhz, axis=1),
        independent.jitters_at(scene)[:, 0],
        replace(independent, path_jitter_mhz=independent.path_jitter_mhz / antennas**0.5),
    )
    detector = IdealDetector(truth.station, noise, truth.departure, believed, truth.modes)
    return float(np.sqrt(max(detector.chi_squared(power), 0.0)))
