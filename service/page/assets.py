"""Files of the page under names that hold their hash: a browser may keep them for ever, and never shows an old one."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from service.errors import NotFoundError

_FILES = {
    "page.css": ("page.css", "text/css"),
    "page.js": ("page.js", "text/javascript"),
    "plotly.js": ("vendor/plotly-cartesian-4.1.1.min.js", "text/javascript"),
    "icon.svg": ("icon.svg", "image/svg+xml"),
}


@dataclass(frozen=True)
class Asset:
    """One file as it is served."""

    name: str
    content: bytes
    media_type: str

    @property
    def url(self) -> str:
        """Its address, which changes with its content."""
        return f"/static/{hashlib.sha256(self.content).hexdigest()[:16]}/{self.name}"


@cache
def load_assets() -> dict[str, Asset]:
    """All files of the page by name."""
    folder = files("service.page") / "static"
    return {name: Asset(name, folder.joinpath(path).read_bytes(), media) for name, (path, media) in _FILES.items()}


def find_asset(digest: str, name: str) -> Asset:
    """A file by its address."""
    asset = load_assets().get(name)
    if asset is None or asset.url != f"/static/{digest}/{name}":
        raise NotFoundError(f"no file /static/{digest}/{name}")
    return asset
