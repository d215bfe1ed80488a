"""Instants to expose at, with the sigma of their time: minima of the blur of both images, or deflection peaks.

J(t) = sum over both cameras of |motion|^2 has a minimum where the wing stands still. In the paper's case, one symmetric
mode, these are the deflection peaks. Errors dx of the slope rates and dx' of their derivatives move a minimum by
-(dJ'/dx . dx + dJ'/dx' . dx') / J''. With one mode the second part vanishes, and the sigma of the time is that of the
slope rate over the slope acceleration. With two modes the minimum is a compromise, and the second part counts.

A deflection peak is an extreme of the first coordinate of the family that moves fastest. The sigma of its time is that
of the coordinate's rate over its acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.core.tracking.prediction import Forecast
from companion.core.trigger.blur import BlurForecast
from companion.native.library import ARRAY, INTEGER, RECORD, kernel, packed
from companion.records import Floats

_ACTIVITY_SHARE = 0.01  # weight of one forecast: 4 s of memory at 25 forecasts a second (choice)
_CLEARLY_FASTER = 1.5  # ratio of mean squares at which the family changes (choice)
_WORST_SIGMA_NS = 1e9  # largest sigma, as for minima of the blur (native/trigger.c; convention)


@dataclass(frozen=True, slots=True)
class PlannedInstant:
    """Minimum of the predicted blur, or deflection peak. ``blur_px`` is the expected rms of the worse camera."""

    t_host_ns: int
    sigma_ns: int
    blur_px: float


@dataclass(slots=True)
class ModeActivity:
    """Mean square rate of either family's first coordinate over the last seconds of forecasts.

    Attributes
    ----------
    dominating : int
        The family that moves faster: 0 symmetric, 1 antisymmetric. It changes only once the other is clearly faster,
        for the peaks of either lie at other instants.
    """

    dominating: int = 0
    _squares_mps2: Floats = field(default_factory=lambda: np.zeros(2))

    def add(self, forecast: Forecast) -> None:
        """Add the rate at the begin of a forecast."""
        step_s = 1e-9 * float(forecast.t_host_ns[1] - forecast.t_host_ns[0])
        rates = (forecast.q_m[1] - forecast.q_m[0]) / step_s
        self._squares_mps2 = self._squares_mps2 + _ACTIVITY_SHARE * (rates**2 - self._squares_mps2)
        other = 1 - self.dominating
        if self._squares_mps2[other] > _CLEARLY_FASTER * self._squares_mps2[self.dominating]:
            self.dominating = other


_packed, _minima = packed(BlurForecast), kernel("trigger_minima", RECORD, INTEGER, ARRAY)


def still_instants(blur: BlurForecast, from_host_ns: int = 0) -> list[PlannedInstant]:
    """Find the local minima of the predicted blur, in order of time, those before ``from_host_ns`` left out."""
    first_ns = int(blur.t_host_ns[0])
    minima = np.empty((len(blur.t_host_ns), 3))
    count = _minima(_packed(blur), from_host_ns, minima)
    return [PlannedInstant(first_ns + round(t), round(sigma), px) for t, sigma, px in minima[:count].tolist()]


def deflection_peaks(
    forecast: Forecast, blur: BlurForecast, family: int, factors_radpm: tuple[float, ...], from_host_ns: int = 0
) -> list[PlannedInstant]:
    """Find the peaks of a family's first coordinate, in order of time, those before ``from_host_ns`` left out.

    Parameters
    ----------
    forecast : Forecast
        Three instants or more, equally spaced.
    blur : BlurForecast
        Blur at the same instants.
    family : int
        0 symmetric, 1 antisymmetric.
    factors_radpm : (symmetric, antisymmetric)
        Slope factors of the first modes: both tips' rates of slope tell how well the coordinate's rate is known.
    from_host_ns : int
        Earliest instant.
    """
    first_ns, step_ns = int(forecast.t_host_ns[0]), int(forecast.t_host_ns[1] - forecast.t_host_ns[0])
    change = np.diff(forecast.q_m[:, family])  # m a step, in the middle of each
    before = np.flatnonzero((change[:-1] * change[1:] <= 0.0) & (change[:-1] != 0.0))
    curvature = change[before + 1] - change[before]
    t_ns = np.rint((before + 0.5 - change[before] / curvature) * step_ns).astype(np.int64) + first_ns
    of_rate = np.array([(1.0, -1.0)[family], 1.0]) / (2.0 * factors_radpm[family])
    rate_sigma_mps = np.sqrt(np.maximum(of_rate @ forecast.slope_rate_covariance[before + 1] @ of_rate, 0.0))
    sigma_ns = np.fmin(rate_sigma_mps * 1e-9 * step_ns**2 / np.abs(curvature), _WORST_SIGMA_NS)  # of no number, too
    return [
        PlannedInstant(t, round(sigma), blur_at_px(blur, t))
        for t, sigma in zip(t_ns.tolist(), sigma_ns.tolist(), strict=True)
        if t >= from_host_ns
    ]


def blur_at_px(blur: BlurForecast, t_host_ns: int) -> float:
    """Expected rms blur of the worse camera at an instant of the forecast, px."""
    elapsed = blur.t_host_ns - blur.t_host_ns[0]
    at = t_host_ns - int(blur.t_host_ns[0])
    return float(np.interp(at, elapsed, blur.rms_px.max(axis=1)))
