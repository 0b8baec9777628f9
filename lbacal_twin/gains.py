"""What makes a measured power scatter about its expectation: radiometer noise and the gain of single events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_twin.hardware import Scene, Stages
from lbacal_twin.settings import TwinSettings


def draw_scatter(
    settings: TwinSettings,
    blocks: NDArray[np.int64],
    channels: int,
    rng: np.random.Generator,
    sky_correlation: float = 0.0,
) -> Floats:
    """Draw what scatters a measured power about its expectation, as a factor of mean 1.

    A power averaged over n independent samples follows a gamma distribution of shape n; the gain of an event is flat
    along frequency. Antennas that see the same sky share a part `sky_correlation` of the radiometer variance.

    Returns
    -------
    Shape (antenna, dipole, event, freq).
    """
    antennas, dipoles, events = blocks.shape
    variance = settings.radiometer**2 * 100.0 / blocks[..., None]
    own = (1.0 - sky_correlation) * variance
    if settings.radiometer > 0:
        scatter = rng.standard_gamma(np.broadcast_to(1.0 / own, (*blocks.shape, channels)))
        scatter *= own
    else:
        scatter = np.ones((*blocks.shape, channels))
    if sky_correlation > 0:
        scatter *= 1.0 + np.sqrt(sky_correlation * variance) * rng.normal(size=(1, dipoles, events, channels))
    scatter *= 1.0 + settings.event_gain_common * rng.normal(size=(1, 1, events, 1))
    scatter *= 1.0 + settings.event_gain_path * rng.normal(size=(antennas, dipoles, events, 1))
    return scatter


# Gains that change from event to event: where in the chain they act, and what they look like along frequency.

PLACES = FRONT, BEHIND = "front", "behind"


@dataclass(frozen=True)
class EventGains:
    """Where the gains of `TwinSettings` act, and how far the resonance jitters.

    Attributes
    ----------
    common_place, path_place
        ``front`` (of N_RCU) or ``behind`` (everything): of the part common to a station, and of a path's own.
    common_jitter_mhz, path_jitter_mhz
        Standard deviation of the antenna's resonance from event to event: common to a station, and of each path.
    is_wet
        Whether the resonance jitters in rain alone.
    """

    common_place: str = BEHIND
    path_place: str = BEHIND
    common_jitter_mhz: float = 0.0
    path_jitter_mhz: float = 0.0
    is_wet: bool = False

    def __post_init__(self) -> None:
        for place in (self.common_place, self.path_place):
            if place not in PLACES:
                raise BadInputError("event gains: place", " or ".join(PLACES), repr(place))
        for jitter in (self.common_jitter_mhz, self.path_jitter_mhz):
            if not 0.0 <= jitter < 2.0:
                raise BadInputError("event gains: jitter_mhz", "0 to 2", f"{jitter}")

    def as_dict(self) -> dict[str, Any]:
        """Describe the gains as JSON values."""
        return asdict(self)

    def behind(self, settings: TwinSettings) -> TwinSettings:
        """Settings with the gains that act behind everything alone."""
        return replace(
            settings,
            event_gain_common=settings.event_gain_common if self.common_place == BEHIND else 0.0,
            event_gain_path=settings.event_gain_path if self.path_place == BEHIND else 0.0,
        )

    def before_receiver(self, settings: TwinSettings) -> tuple[float, float]:
        """Standard deviations of the gains in front of N_RCU, common and of a path."""
        return (
            settings.event_gain_common if self.common_place == FRONT else 0.0,
            settings.event_gain_path if self.path_place == FRONT else 0.0,
        )

    def jitters_at(self, scene: Scene) -> Floats:
        """1 at events in which the resonance jitters, 0 at others, shape (event, 1)."""
        return (scene.rain_mm_h[:, None] > 0).astype(float) if self.is_wet else np.ones((len(scene.time_unix), 1))

    def move(self, stages: Stages, scene: Scene, settings: TwinSettings, rng: np.random.Generator) -> Stages:
        """The stages with the gains of every event that act in front of N_RCU."""
        paths, events = stages.gain.shape[:2], len(scene.time_unix)
        common, own = self.before_receiver(settings)
        if common or own:
            factor = 1.0 + common * rng.normal(size=(1, 1, events, 1))
            factor = factor * (1.0 + own * rng.normal(size=(*paths, events, 1)))
            stages = replace(stages, gain=stages.gain * factor)
        if self.common_jitter_mhz or self.path_jitter_mhz:
            shift = self.common_jitter_mhz * rng.normal(size=(1, 1, events, 1))
            if self.path_jitter_mhz:
                shift = shift + self.path_jitter_mhz * rng.normal(size=(*paths, events, 1))
            moved = shift_resonance(stages.antenna, scene.frequency_mhz, shift * self.jitters_at(scene))
            stages = replace(stages, antenna=moved)
        return stages


BEHIND_EVERYTHING = EventGains()
NOISES: Mapping[str, EventGains] = {
    "behind": BEHIND_EVERYTHING,
    "front": EventGains(FRONT, FRONT),
    "station in front": EventGains(FRONT, BEHIND),
    "paths in front": EventGains(BEHIND, FRONT),
    "resonance": EventGains(FRONT, FRONT, common_jitter_mhz=0.1),
    "resonance of paths": EventGains(BEHIND, FRONT, path_jitter_mhz=0.1),
    "wetness": EventGains(FRONT, FRONT, common_jitter_mhz=0.3, path_jitter_mhz=0.1, is_wet=True),
}
"""Forms that the gains of events may have, by name."""


def shift_resonance(antenna: Floats, frequency_mhz: Floats, shift_mhz: Floats) -> Floats:
    """G_ant A slid along frequency.

    Parameters
    ----------
    antenna
        Shape (antenna or 1, dipole, 1, freq).
    shift_mhz
        Shape (antenna or 1, dipole or 1, event, 1).

    Returns
    -------
    Shape (antenna or 1, dipole, event, freq).
    """
    rows = max(antenna.shape[0], shift_mhz.shape[0])
    curves = np.broadcast_to(antenna, (rows, *antenna.shape[1:]))[:, :, 0]
    shifts = np.broadcast_to(shift_mhz, (rows, antenna.shape[1], *shift_mhz.shape[2:]))
    moved = [
        [
            np.exp(CubicSpline(frequency_mhz, np.log(curve))(frequency_mhz - shift))
            for curve, shift in zip(*one, strict=True)
        ]
        for one in zip(curves, shifts, strict=True)
    ]
    return np.array(moved)
