"""Functions of frequency that are vectors of a known noise, shape (vector, freq)."""

from __future__ import annotations

import numpy as np

NU = np.linspace(-1.0, 1.0, 51)
"""Frequency from end to end of the band."""
THREE = np.stack([np.ones(51), 1.0 - 0.5 * NU**2, np.exp(-0.5 * (NU / 0.2) ** 2) * NU])
"""A gain behind everything, one in front of the noise of the receiver, and a resonance that moves."""
