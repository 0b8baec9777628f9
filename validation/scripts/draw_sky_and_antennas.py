"""Draw the pictures of docs/explanation/sky-and-antennas.md.

.venv/bin/python validation/scripts/draw_sky_and_antennas.py ../shared/data
"""

from __future__ import annotations

import sys
from itertools import product
from pathlib import Path

import healpy as hp
import numpy as np
from matplotlib.figure import Figure

from lbacal.pages.chart import COLOURS
from lbacal_core.antenna.model import directional_response
from lbacal_core.antenna.names import load_antenna
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.sky.differences import model_difference_modes
from lbacal_core.sky.names import load_sky
from lbacal_core.sky.power import compute_sky_power

TARGET = Path(__file__).parents[2] / "docs" / "images"
INSTRUMENT = load_instrument("lofar-superterp")
LST_H = (0.0, 6.0, 12.0, 18.0)


def draw_skies(data: Path) -> Figure:
    """The sky overhead at four LST: two models, with the half-power line of each dipole."""
    skies = {"embedded, l ≤ 16": load_sky("gsm"), "LFSM, nside 64": load_sky(str(data / "sky/lfsm-5.1deg.npz"))}
    side = np.linspace(-1, 1, 301)
    x, y = np.meshgrid(side, side)  # x to the west, as seen when looking up
    seen = np.hypot(x, y) < 1
    zenith = np.where(seen, np.hypot(x, y) * np.pi / 2, 0.0)  # equidistant in zenith angle
    azimuth = np.arctan2(-x, y)
    response = {
        arm: directional_response(load_antenna("hamaker"), np.array([55.0]), zenith, azimuth - np.radians(arm))[0]
        for arm in (45.0, 135.0)
    }
    latitude = np.radians(INSTRUMENT.latitude_deg)
    declination = np.arcsin(np.sin(latitude) * np.cos(zenith) + np.cos(latitude) * np.sin(zenith) * np.cos(azimuth))
    hour_angle = np.arctan2(
        -np.sin(zenith) * np.sin(azimuth),
        np.cos(zenith) * np.cos(latitude) - np.sin(zenith) * np.cos(azimuth) * np.sin(latitude),
    )
    figure = Figure(figsize=(11, 6.2), layout="constrained")
    axes = figure.subplots(2, 4)
    for row, (name, sky) in zip(axes, skies.items(), strict=True):
        multipoles = sky.temperature(np.array([55.0]))[0]
        pixels = hp.alm2map(multipoles.T[np.triu_indices(sky.lmax + 1)], 128, lmax=sky.lmax)
        for axis, lst in zip(row, LST_H, strict=True):
            right_ascension = lst * np.pi / 12 - hour_angle
            values = hp.get_interp_val(pixels, np.pi / 2 - declination, right_ascension)
            image = axis.imshow(
                np.where(seen, values / 1e3, np.nan), origin="lower", extent=(-1, 1, -1, 1), cmap="inferno", norm="log",
                vmin=2, vmax=30,
            )  # fmt: skip
            for arm, style in ((45.0, "solid"), (135.0, "dashed")):
                axis.contour(x, y, np.where(seen, response[arm], np.nan), [0.5], colors="white", linestyles=style)
            axis.set_axis_off()
            for text, place in (("N", (0, 1.06)), ("S", (0, -1.06)), ("E", (-1.06, 0)), ("W", (1.06, 0))):
                axis.text(*place, text, ha="center", va="center", fontsize=8)
            axis.set_title(f"{name}\nLST {lst:.0f} h", fontsize=9, pad=12)
    figure.colorbar(image, ax=axes, label="brightness temperature at 55 MHz (1000 K)", shrink=0.8)
    figure.suptitle("The sky above the Superterp; D = 0.5 of the arm at 45° (solid) and at 135° (dashed)", fontsize=11)
    return figure


def draw_beams(data: Path) -> Figure:
    """Cuts of D along and across the arm for three antenna models."""
    antennas = {
        "Hamaker element beam": load_antenna("hamaker"),
        "WIPL-D table": load_antenna(str(data / "antenna/lba_vout.npz")),
        "short dipole, 1.5 m over a perfect plane": load_antenna("short-dipole"),
    }
    zenith = np.linspace(0, np.pi / 2 - 1e-6, 181)
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    for axis, nu in zip(figure.subplots(1, 3, sharey=True), (30.0, 55.0, 80.0), strict=True):
        for (name, antenna), colour in zip(antennas.items(), COLOURS, strict=False):
            for azimuth, style in ((0.0, "-"), (90.0, "--")):
                cut = directional_response(antenna, np.array([nu]), zenith, np.full(181, np.radians(azimuth)))[0]
                axis.plot(np.degrees(zenith), cut, style, color=colour, label=name if azimuth == 0 else None)
        axis.set(title=f"{nu:.0f} MHz", xlabel="zenith angle (deg)", xlim=(0, 90), ylim=(0, 1.6))
        axis.grid(alpha=0.3)
    figure.axes[0].set_ylabel("D, 1 at zenith")
    figure.axes[0].legend(fontsize=8, title="solid along the arm, dashed across", title_fontsize=8)
    return figure


def draw_sky_power(data: Path) -> Figure:
    """P_sky against LST for every model, and their ratio to the default with the prior of the modes."""
    skies = {"embedded": "gsm", "GSM 408": f"{data}/sky/gsm-408locked.npz", "LFSM": f"{data}/sky/lfsm-5.1deg.npz"}
    antennas = {"Hamaker": "hamaker", "WIPL-D": f"{data}/antenna/lba_vout.npz"}
    powers = {
        f"{sky}, {antenna}": compute_sky_power(INSTRUMENT, skies[sky], antennas[antenna])
        for sky, antenna in product(skies, antennas)
    }
    default = powers["embedded, Hamaker"]
    channel = int(np.argmin(np.abs(INSTRUMENT.frequency_mhz - 55.0)))
    lst = default.lst_hours
    spread = model_difference_modes(INSTRUMENT, lst)
    figure = Figure(figsize=(11, 6.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    for column, dipole in enumerate("XY"):
        for (name, power), colour in zip(powers.items(), COLOURS, strict=False):
            curve = power.power[dipole][:, channel]
            axes[0, column].plot(lst, curve * 1e14, color=colour, label=name)
            ratio = curve / default.power[dipole][:, channel]
            axes[1, column].plot(lst, 100 * (ratio / ratio.mean() - 1), color=colour)
        band = 100 * np.sqrt((spread[dipole][:, :, channel] ** 2).sum(axis=0))
        axes[1, column].fill_between(lst, -band, band, color="0.85", label="one prior sigma of the four modes")
        arm = INSTRUMENT.dipole_azimuth_deg[dipole]
        axes[0, column].set(title=f"{dipole}, arm at {arm:.0f}° azimuth", ylabel="P_sky at 55 MHz (10⁻¹⁴ W m⁻² MHz⁻¹)")
        axes[1, column].set(xlabel="local sidereal time (h)", ylabel="shape against the default (%)", xlim=(0, 24))
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    for axis in axes[:, 0]:
        axis.legend(fontsize=8)
    return figure


def main(folder: str) -> None:
    data = Path(folder)
    for name, draw in (("skies", draw_skies), ("beams", draw_beams), ("power", draw_sky_power)):
        draw(data).savefig(TARGET / f"sky-{name}.png", dpi=110)


if __name__ == "__main__":
    main(sys.argv[1])
