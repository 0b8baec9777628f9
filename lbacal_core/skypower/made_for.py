"""What a sky power was computed for: instrument, sky, antenna and arms, with their hashes (docs/formats.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from typing import Any

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.instrument import Instrument
from lbacal_core.provenance import MODEL_VERSION

ARM_TOLERANCE_DEG = 1e-6
SHOWN = 12
"""Digits of a hash that a sentence shows."""


@dataclass(frozen=True)
class MadeFor:
    """The instrument, sky model and antenna model behind a sky power; what is None or absent is not known.

    Attributes
    ----------
    dipole_azimuth_deg
        Azimuths of the arms.
    hashes
        `instrument`: hash of what P_sky takes from it; `sky`, `antenna`: of the numbers of the models.
    versions
        `lbacal`: that of the package; `model_version`.
    """

    instrument: str | None = None
    sky: str | None = None
    antenna: str | None = None
    dipole_azimuth_deg: Mapping[str, float] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, Any] = field(default_factory=dict)

    def require(self, instrument: Instrument, place: str) -> None:
        """Refuse an instrument with another name, place, arms, channels or antenna, and models that changed since."""
        if self.instrument is not None and self.instrument != instrument.name:
            raise BadInputError(f"{place}: instrument", f"that of the fit, {instrument.name!r}", repr(self.instrument))
        for dipole, azimuth in self.dipole_azimuth_deg.items():
            arm = instrument.dipole_azimuth_deg.get(dipole)
            if arm is None or not np.isclose(azimuth, arm, rtol=0.0, atol=ARM_TOLERANCE_DEG):
                expected = "no such dipole" if arm is None else f"{arm:g}, that of instrument {instrument.name}"
                raise BadInputError(f"{place}: dipoles.{dipole}.azimuth_deg", expected, f"{azimuth:g}")
        view = self.hashes.get("instrument", instrument.view_digest())
        if view != instrument.view_digest():
            raise BadInputError(
                f"{place}: hashes.instrument",
                f"that of the place, arms and channels of instrument {instrument.name}, "
                f"{instrument.view_digest()[:SHOWN]}: compute the sky power again (lbacal sky-power)",
                view[:SHOWN],
            )
        for kind, digest in (("sky", shipped_sky_digest(self.sky)), ("antenna", shipped_antenna_digest(self.antenna))):
            if digest is not None and self.hashes.get(kind, digest) != digest:
                ours = f"this package's {kind} {getattr(self, kind)}, {digest[:SHOWN]}: compute the sky power again"
                raise BadInputError(f"{place}: hashes.{kind}", ours, self.hashes[kind][:SHOWN])
        gain = instrument.gain_provenance
        own = None if gain is None else gain.antenna_sha256
        if own is not None and self.hashes.get("antenna", own) != own:
            raise BadInputError(
                f"{place}: antenna",
                f"the antenna of which instrument {instrument.name} has its antenna_gain, {own[:SHOWN]}",
                f"{self.antenna} ({self.hashes['antenna'][:SHOWN]})",
            )

    def with_sky(self, added: str) -> MadeFor:
        """The same with something added to the sky, which then has no hash of its own."""
        hashes = {name: value for name, value in self.hashes.items() if name != "sky"}
        return replace(self, sky=f"{self.sky}{added}", hashes=hashes)

    def note(self, instrument: Instrument) -> str:
        """What is known, in words."""
        words = [f"{name} {value}" for name, value in (("sky", self.sky), ("antenna", self.antenna)) if value]
        if not words:
            return "unchecked: it does not say which sky and antenna it was made with"
        if None not in (self.antenna, instrument.antenna) and self.antenna != instrument.antenna:
            words.append(f"instrument {instrument.name} names the antenna {instrument.antenna}")
        return ", ".join(words)

    def as_dict(self) -> dict[str, Any]:
        """The fields of a sky power file."""
        named = {"instrument": self.instrument, "sky": self.sky, "antenna": self.antenna}
        dipoles = {dipole: {"azimuth_deg": azimuth} for dipole, azimuth in self.dipole_azimuth_deg.items()}
        more = {"dipoles": dipoles, "hashes": dict(self.hashes), "versions": dict(self.versions)}
        return {name: value for name, value in (named | more).items() if value}


def shipped_sky_digest(name: str | None) -> str | None:
    """Digest of a sky model that ships with the package; None for any other."""
    # the models need scipy, the tables that this describes do not
    from lbacal_core.sky.measured import MEASURED_SKY
    from lbacal_core.sky.names import list_skies, load_sky

    return load_sky(name).digest() if name in [*list_skies(), MEASURED_SKY] else None


def shipped_antenna_digest(name: str | None) -> str | None:
    """Digest of an antenna model that ships with the package; None for any other."""
    from lbacal_core.antenna.names import ANTENNAS, load_antenna

    return load_antenna(name).digest() if name in ANTENNAS else None


def describe_view(instrument: Instrument, sky: str, sky_digest: str, antenna: str, antenna_digest: str) -> MadeFor:
    """What this package's own sky power is made for."""
    return MadeFor(
        instrument.name,
        sky,
        antenna,
        dict(instrument.dipole_azimuth_deg),
        {"instrument": instrument.view_digest(), "sky": sky_digest, "antenna": antenna_digest},
        {"lbacal": version("lbacal"), "model_version": MODEL_VERSION},
    )


def parse_made_for(content: Mapping[str, Any], place: str) -> MadeFor | None:
    """Read what a sky power file says that it was made for; None where it says nothing."""
    kinds: dict[str, type] = {"instrument": str, "sky": str, "antenna": str, "dipoles": dict, "hashes": dict}
    kinds["versions"] = dict
    given = {name: content[name] for name in kinds if content.get(name) is not None}
    for name, value in given.items():
        if not isinstance(value, kinds[name]):
            raise BadInputError(f"{place}: {name}", "a name" if kinds[name] is str else "an object", repr(value)[:60])
    if not given:
        return None
    arms = {}
    for dipole, value in given.get("dipoles", {}).items():
        azimuth = value.get("azimuth_deg") if isinstance(value, dict) else None
        if isinstance(azimuth, bool) or not isinstance(azimuth, int | float):
            raise BadInputError(f"{place}: dipoles.{dipole}", "an object with azimuth_deg", repr(value)[:60])
        arms[str(dipole)] = float(azimuth)
    for name, value in given.get("hashes", {}).items():
        if not isinstance(value, str):
            raise BadInputError(f"{place}: hashes.{name}", "a hash", repr(value)[:60])
    return MadeFor(
        given.get("instrument"),
        given.get("sky"),
        given.get("antenna"),
        arms,
        given.get("hashes", {}),
        given.get("versions", {}),
    )
