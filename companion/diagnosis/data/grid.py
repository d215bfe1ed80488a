"""Lengths of a grid that transform fast, and how far its ends fade."""

from __future__ import annotations

import numpy as np

from companion.records import Floats

TAPER = 0.05
"""Share of a recording over which each end fades in its spectra (choice)."""
FADES_S = 3.0
"""At either end the smoothed wing is not known: two periods of the lowest frequency, 0.15 of some 5 Hz (convention)."""
_MOST_FADED = 0.15  # share of a short recording at either end, so that its middle is left (choice)


def faded_share(duration_s: float) -> float:
    """Share of a recording over which each end fades before its motion is smoothed."""
    return max(TAPER, min(FADES_S / duration_s, _MOST_FADED))


def fast_length(count: int, up: bool) -> int:
    """The next even length, up or down, with no prime factor beyond 5."""
    best = 0 if not up else 1 << max(count - 1, 1).bit_length()
    for power5 in range(10):
        for power3 in range(12):
            base = 2 * 5**power5 * 3**power3
            while base <= 4 * count:
                if (up and count <= base < best) or (not up and best < base <= count):
                    best = base
                base *= 2
    return best


def half_cosine(values: Floats, full_at: float, zero_at: float) -> Floats:
    """Share at each value (n,): 1 from ``full_at`` on, 0 from ``zero_at`` on, and half a cosine in between.

    It falls where ``full_at`` is the smaller of the two, and rises where it is the larger.
    """
    ramp = np.clip((values - zero_at) / (full_at - zero_at), 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * ramp))
