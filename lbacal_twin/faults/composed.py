"""Effects composed at random: any place in the chain, any law along frequency, any course in time, or two at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.grids import Floats
from lbacal_twin.bodies import horizontal, sun_position
from lbacal_twin.faults.fault import Fault
from lbacal_twin.hardware import Scene, Stages
from lbacal_twin.settings import DAY_S

Numbers = tuple[float, ...]
Drawn = tuple[str, Numbers]
"""A form by its name, and its numbers."""


def _day(scene: Scene) -> Floats:
    """Days since the first event."""
    return np.asarray((scene.time_unix - scene.time_unix.min()) / DAY_S)


def _is_light(scene: Scene) -> Floats:
    zenith, _ = horizontal(*sun_position(scene.time_unix), scene.lst_hours, scene.latitude_deg)
    return (zenith < np.pi / 2).astype(float)


LAWS: dict[str, tuple[Callable[..., Floats], Callable[[np.random.Generator], Numbers]]] = {
    "power": (lambda nu, p: (nu / nu[0]) ** p, lambda rng: (rng.uniform(-4.0, 1.5),)),
    "bell": (
        lambda nu, middle, width: np.exp(-0.5 * ((nu - middle) / width) ** 2),
        lambda rng: (rng.uniform(38.0, 72.0), rng.uniform(1.5, 6.0)),
    ),
    "cut": (
        lambda nu, edge, width: 0.5 * (1.0 - np.tanh((nu - edge) / width)),
        lambda rng: (rng.uniform(38.0, 65.0), rng.uniform(0.5, 5.0)),
    ),
    "standing wave": (
        lambda nu, delay, phase: np.cos(2 * np.pi * delay * nu + phase),
        lambda rng: (rng.uniform(0.04, 0.35), rng.uniform(0, 2 * np.pi)),
    ),
    "sag": (lambda nu, middle: ((nu - middle) / 30.0) ** 2, lambda rng: (rng.uniform(45.0, 65.0),)),
    "level": (np.ones_like, lambda _: ()),
}
"""Laws along frequency: of MHz and numbers, and a draw of these."""

COURSES: dict[str, tuple[Callable[..., Floats], Callable[[np.random.Generator], Numbers]]] = {
    "wave": (
        lambda s, period, phase: np.cos(2 * np.pi * s.time_unix / (period * DAY_S) + phase),
        lambda rng: (float(rng.choice([0.5, 1.0, 7.0, 27.275])), rng.uniform(0, 2 * np.pi)),
    ),
    "sidereal wave": (
        lambda s, number, phase: np.cos(2 * np.pi * number * s.lst_hours / 24.0 + phase),
        lambda rng: (float(rng.integers(1, 4)), rng.uniform(0, 2 * np.pi)),
    ),
    "saw": (
        lambda s, begin: 2.0 * ((s.utc_hours[:, 0] - begin) % 24.0) / 24.0 - 1.0,
        lambda rng: (rng.uniform(0, 24),),
    ),
    "shift": (
        lambda s, begin, hours: (((s.utc_hours[:, 0] - begin) % 24.0) < hours).astype(float),
        lambda rng: (rng.uniform(0, 24), rng.uniform(3.0, 12.0)),
    ),
    "weekend": (lambda s: ((s.time_unix // DAY_S + 3) % 7 >= 5).astype(float), lambda _: ()),
    "spell": (
        lambda s, middle, width: (np.abs(_day(s) - middle * _day(s).max()) < width).astype(float),
        lambda rng: (rng.uniform(0.2, 0.8), rng.uniform(10.0, 40.0)),
    ),
    "decay": (
        lambda s, begin, days: (_day(s) > begin * _day(s).max()) * np.exp(-(_day(s) - begin * _day(s).max()) / days),
        lambda rng: (rng.uniform(0.1, 0.6), rng.uniform(20.0, 100.0)),
    ),
    "warm": (
        lambda s, middle, width: np.tanh((s.temperature_c - middle) / width),
        lambda rng: (rng.uniform(6.0, 14.0), rng.uniform(2.0, 10.0)),
    ),
    "frost": (lambda s, below: (s.temperature_c < below).astype(float), lambda rng: (rng.uniform(2.0, 10.0),)),
    "rain": (lambda s: np.tanh(s.rain_mm_h), lambda _: ()),
    "light": (_is_light, lambda _: ()),
    "third": (
        lambda s, n, together=1.0: (np.arange(s.time_unix.size) // together % n == 0).astype(float),
        lambda rng: (float(rng.integers(3, 6)),),
    ),
}
"""Courses in time: of a scene and numbers, and a draw of these."""
GATES = ("shift", "weekend", "frost", "light", "spell")
"""Courses that may be a condition on another."""
PLACES = ("sky", "added", "gain", "receiver noise", "receiver", "converter")


@dataclass(frozen=True, kw_only=True)
class Composed(Fault):
    """One place changes by `size` (fraction; of the mean sky where power is added) times a law times courses."""

    place: str
    law: Drawn
    courses: tuple[Drawn, ...]

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """Change the stage."""
        name, numbers = self.law
        shape = LAWS[name][0](scene.frequency_mhz, *numbers)
        shape = shape / np.abs(shape).max()
        in_time = np.prod([COURSES[course][0](scene, *of) for course, of in self.courses], axis=0)
        change = self.where.mask(scene) * self.size * in_time[:, None] * shape
        if self.place == "added":
            return replace(stages, sky=stages.sky + change * scene.mean_sky)
        stage = {"receiver noise": "rcu_noise", "converter": "adc_noise"}.get(self.place, self.place)
        return replace(stages, **{stage: getattr(stages, stage) * (1.0 + change)})


def draw_composed(rng: np.random.Generator, size: float) -> Composed:
    """Draw an effect of one course, or in one of three of two."""

    def draw(
        kinds: dict[str, tuple[Callable[..., Floats], Callable[[np.random.Generator], Numbers]]], *among: str
    ) -> Drawn:
        name = str(rng.choice(list(among) or list(kinds)))
        return name, tuple(round(float(one), 4) for one in kinds[name][1](rng))

    law, courses = draw(LAWS), [draw(COURSES)]
    if rng.random() < 1 / 3:
        courses.append(draw(COURSES, *(one for one in GATES if one != courses[0][0])))
    return Composed(size=size, place=str(rng.choice(PLACES)), law=law, courses=tuple(courses))
