"""One trace, drawn: its samples, its spectrum before and after cleaning, and the channels left out."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from lbacal_core.traces.background import CleaningSettings, PathBackground
from lbacal_core.traces.density import bin_weights, channel_frequencies, effective_channels, power_density
from lbacal_core.traces.trace import BLOCK_SAMPLES, Trace


def draw_inspection(trace: Trace, background: PathBackground, settings: CleaningSettings) -> Figure:
    """Draw a trace and what cleaning did to it."""
    figure = Figure(figsize=(10, 11), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1)
    rate = trace.reference.sample_rate_hz
    start = (trace.position - trace.position[0]) * BLOCK_SAMPLES / rate * 1e3
    top.fill_between(start, trace.samples.min(axis=1), trace.samples.max(axis=1), step="post", alpha=0.4, label="range")
    rms = trace.samples.astype(float).std(axis=1)
    centre = trace.samples.mean(axis=1, dtype=float)
    top.plot(start, centre + rms, "C1", lw=0.6, label="mean ± r.m.s. of a block")
    top.plot(start, centre - rms, "C1", lw=0.6)
    for pulse in background.pulses:
        top.axvline((pulse - trace.position[0]) * BLOCK_SAMPLES / rate * 1e3, color="C3", lw=0.8, ls=":")
    dropped = ", ".join(f"{count} {reason}" for reason, count in background.dropped.items()) or "none"
    top.set(xlabel="time since the first sample (ms)", ylabel="ADC units", title=f"blocks dropped: {dropped}")
    top.legend(loc="upper right")

    ohm = settings.resistance_ohm
    whole_mhz = channel_frequencies(BLOCK_SAMPLES, rate)
    whole = power_density(trace.samples, rate) / ohm
    middle.semilogy(whole_mhz, whole, "C0", lw=0.7, label="before: all blocks, channels of 0.195 MHz")
    flagged = background.is_flagged
    middle.semilogy(
        background.channel_mhz[flagged], background.density[flagged] / ohm, "C3x", ms=4, label="channels left out"
    )
    middle.set(xlabel="frequency (MHz)", ylabel="power (ADC²/Ω/MHz)", xlim=(0, whole_mhz[-1]))
    middle.legend()

    low, high = settings.frequency_mhz[0] - 1, settings.frequency_mhz[-1] + 1
    shown = (background.channel_mhz > low) & (background.channel_mhz < high)
    density = np.where(flagged, np.nan, background.density)
    bottom.semilogy(background.channel_mhz[shown], density[shown] / ohm, "C0.", ms=3, label="clean channels")
    bottom.semilogy(
        background.channel_mhz[shown & flagged],
        background.density[shown & flagged] / ohm,
        "C3x",
        ms=4,
        label="left out",
    )
    if not background.excluded:
        weights = bin_weights(background.channel_mhz, settings.frequency_mhz, settings.width_mhz) * ~flagged
        noise = 1 / np.sqrt(background.blocks * np.maximum(effective_channels(weights), 1.0))
        power = background.power
        bottom.fill_between(
            settings.frequency_mhz, power * (1 - noise), power * (1 + noise), step="mid", alpha=0.3, color="C2"
        )
        bottom.step(settings.frequency_mhz, power, "C2", where="mid", label="result with its radiometer noise")
        filled = background.is_filled
        bottom.plot(settings.frequency_mhz[filled], power[filled], "C1s", mfc="none", label="filled bins")
        low_power, high_power = power.min() / 2, 2 * float(np.max(background.density[shown] / ohm))
        bottom.set_ylim(low_power, high_power)
    bottom.set(xlabel="frequency (MHz)", ylabel="power (ADC²/Ω/MHz)", xlim=(low, high))
    bottom.legend(loc="upper right")
    state = f"; excluded: {background.excluded}" if background.excluded else ""
    figure.suptitle(f"{trace.reference.path.name}: {trace.reference.name}, {background.blocks} blocks{state}")
    return figure
