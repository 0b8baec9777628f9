"""Everything a campaign hides, and the sealed file it is kept in, apart from the data."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import UnknownNameError, UnreadableFileError
from lbacal_core.grids import Floats
from lbacal_core.provenance import canonical_json, hash_content

SEAL = "lbacal-sealed-truth-1"


@dataclass(frozen=True)
class StationTruth:
    """The planted values of one station.

    Attributes
    ----------
    antennas
        Shape (antenna,).
    c
        C(nu) of every path with the cable of the first event, without any fault; shape (antenna, dipole, freq).
    path_gain
        Shape (antenna, dipole).
    n_lna, n_rcu, n_adc
        In the units of a fit: of P_sky, and power at the output (N_RCU S and N_ADC); with stages, about what theirs
        add up to.
    constants
        The constants of stages by name; None where the instrument has no stages.
    """

    station: str
    antennas: NDArray[np.int64]
    c: Floats
    path_gain: Floats
    n_lna: float
    n_rcu: float
    n_adc: float
    constants: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Truth:
    """The planted values of a campaign."""

    settings: Mapping[str, Any]
    frequency_mhz: Floats
    stations: Sequence[StationTruth]
    faults: Sequence[Mapping[str, Any]] = ()
    dipoles: tuple[str, ...] = ("X", "Y")

    def curve(self, dipole: str, station: str | None = None, antenna: int | None = None) -> Floats:
        """C(nu) of one path, of a station or of the array.

        Antennas are averaged as the measurement averages them, in power: C of a station or of the array is that of
        the mean power gain of its paths, 1/C^2 = mean(g A L G_RCU S).
        """
        chosen = [one for one in self.stations if station in (None, one.station)]
        if not chosen:
            raise UnknownNameError("station", str(station), [one.station for one in self.stations])
        k = self.dipoles.index(dipole)
        gains = [
            one.c[one.antennas == antenna, k] ** -2 if antenna is not None else one.c[:, k] ** -2 for one in chosen
        ]
        stacked = np.concatenate(gains)
        if not len(stacked):
            raise UnknownNameError("antenna", str(antenna), [str(number) for number in chosen[0].antennas])
        return np.asarray(stacked.mean(axis=0) ** -0.5)

    def as_dict(self) -> dict[str, Any]:
        """Every planted value as JSON."""
        stations = [
            {
                "station": one.station,
                "antennas": one.antennas.tolist(),
                "c": one.c.tolist(),
                "path_gain": one.path_gain.tolist(),
                "n_lna": one.n_lna,
                "n_rcu": one.n_rcu,
                "n_adc": one.n_adc,
                **({} if one.constants is None else {"constants": dict(one.constants)}),
            }
            for one in self.stations
        ]
        return {
            "settings": dict(self.settings),
            "frequency_mhz": self.frequency_mhz.tolist(),
            "stations": stations,
            "faults": [dict(fault) for fault in self.faults],
            "dipoles": list(self.dipoles),
        }


def seal_truth(truth: Truth, path: Path) -> str:
    """Write the truth so that nothing reads it by accident: packed, under its hash; returns the hash.

    The hash may be published with the data beforehand: it proves afterwards that the truth was not changed.
    """
    content = truth.as_dict()
    digest = hash_content(content)
    packed = base64.b85encode(zlib.compress(canonical_json(content).encode())).decode()
    path.write_text(f"{SEAL}\n{digest}\n{packed}\n")
    return digest


def unseal_truth(path: Path) -> Truth:
    """Read a sealed truth, and refuse one that does not match its seal."""
    try:
        seal, digest, packed = path.read_text().split()
        content = json.loads(zlib.decompress(base64.b85decode(packed)))
    except (OSError, ValueError, zlib.error) as error:
        raise UnreadableFileError(f"{path}: expected a sealed truth, found something unreadable") from error
    if seal != SEAL or hash_content(content) != digest:
        raise UnreadableFileError(f"{path}: the truth does not match its seal")
    stations = [
        StationTruth(
            station=one["station"],
            antennas=np.array(one["antennas"], dtype=np.int64),
            c=np.array(one["c"], dtype=float),
            path_gain=np.array(one["path_gain"], dtype=float),
            n_lna=one["n_lna"],
            n_rcu=one["n_rcu"],
            n_adc=one["n_adc"],
            constants=one.get("constants"),
        )
        for one in content["stations"]
    ]
    return Truth(
        content["settings"],
        np.array(content["frequency_mhz"]),
        stations,
        content["faults"],
        tuple(content.get("dipoles", ("X", "Y"))),
    )
