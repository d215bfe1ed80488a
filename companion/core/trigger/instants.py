"""The instants at which both images stand stillest, and how well each is known.

J(t) = sum over both cameras of |motion|^2 has a minimum where the wing stands still (in the paper's case, one symmetric
mode, at the deflection peaks). Errors dx of the slope rates and dx' of their derivatives move it by
-(dJ'/dx . dx + dJ'/dx' . dx') / J''. With one mode the second part vanishes and the time's sigma is that of the slope
rate over the slope acceleration; where the minimum is a compromise between two modes, it does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.core.trigger.blur import BlurForecast
from companion.native.library import ARRAY, INTEGER, RECORD, kernel, packed
from companion.records import Floats, Ints


@dataclass(frozen=True, slots=True)
class StillInstant:
    """One minimum of the predicted blur; ``blur_px`` is the worse camera's expected rms."""

    t_host_ns: int
    sigma_ns: int
    blur_px: float


class _Shape(NamedTuple):
    """Blur over the instants, as :class:`BlurForecast` has it."""

    t_ns: Ints
    motion: Floats
    per_rate: Floats
    acceleration: Floats
    rate_covariance: Floats
    q_covariance: Floats
    spring: Floats
    rms_px: Floats


_packed, _minima = packed(_Shape), kernel("trigger_minima", RECORD, INTEGER, ARRAY)


def still_instants(blur: BlurForecast, from_host_ns: int = 0) -> list[StillInstant]:
    """Find the local minima of the predicted blur, in order of time, those before ``from_host_ns`` left out."""
    first_ns = int(blur.t_host_ns[0])
    shape = _Shape(
        blur.t_host_ns,
        blur.motion,
        blur.motion_per_rate,
        blur.acceleration_radps2,
        blur.rate_covariance,
        blur.q_covariance,
        blur.spring,
        blur.rms_px,
    )
    minima = np.empty((len(blur.t_host_ns), 3))
    count = _minima(_packed(shape), from_host_ns, minima)
    return [StillInstant(first_ns + round(t), round(sigma), px) for t, sigma, px in minima[:count].tolist()]


def blur_at_px(blur: BlurForecast, t_host_ns: int) -> float:
    """Expected rms blur of the worse camera at an instant of the forecast."""
    elapsed = blur.t_host_ns - blur.t_host_ns[0]
    at = t_host_ns - int(blur.t_host_ns[0])
    return float(np.interp(at, elapsed, blur.rms_px.max(axis=1)))
