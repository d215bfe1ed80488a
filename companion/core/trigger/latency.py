"""Learned latency of each trigger path, left and right: from the command to the middle of the exposure."""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from dataclasses import dataclass, field

import numpy as np

from companion.params.airframe import Airframe, Camera
from companion.records import Reject, Shot, Side, TriggerLatency
from companion.units import MAD_TO_SIGMA

MOST_LATENCY_NS = 500_000_000
"""A frame later after a shot than this was not caused by it (choice)."""
_MEMORY = 64  # newest latencies that the median is taken of (choice)
_MAX_SHOTS = 256  # bound of memory: shots whose exposure may still arrive
_OUTLIER_SPREADS = 6.0  # jitter of a serial link or an operating system stays below (choice)
_LEAST_SPREAD_NS = 50e3  # resolution of stamps (choice)
_EARLY_SIGMAS = 6.0  # a stamp that is earlier than its command by more is not of it (choice: as for outliers)
_REGIME = 5
"""So many outliers in a row that agree are a new latency: another exposure, another link (choice)."""
_JUDGED = 32  # last latencies of which most must be no outliers (choice)
_MEDIAN_LOSS = math.pi / 2  # a median's variance over a mean's (Gaussian, derived)


@dataclass(frozen=True, slots=True)
class LatencyEstimate:
    """Estimate of one path: bias and its sigma, spread from shot to shot, numbers of latencies and of outliers."""

    bias_ns: float
    bias_sigma_ns: float
    spread_ns: float
    count: int
    outliers: int


@dataclass(slots=True)
class _TriggerPath:
    prior_ns: float
    prior_sigma_ns: float
    latencies_ns: deque[float] = field(default_factory=lambda: deque(maxlen=_MEMORY))
    odd: list[float] = field(default_factory=list)
    count: int = 0
    outliers: int = 0
    usual: deque[bool] = field(default_factory=lambda: deque(maxlen=_JUDGED))  # of the last latencies: no outlier
    to_middle_ns: float = 0.0
    belief: LatencyEstimate = field(init=False)

    def __post_init__(self) -> None:
        self.belief = self._believe()

    def learn(self, latency_ns: float) -> bool:
        """Take one latency; False for an outlier."""
        allowed = _OUTLIER_SPREADS * math.hypot(self.belief.spread_ns, self.belief.bias_sigma_ns)
        good = abs(latency_ns - self.belief.bias_ns) <= allowed
        if good:
            self.odd.clear()
            self.latencies_ns.append(latency_ns)
            self.count += 1
        else:
            self.outliers += 1
            self._suspect(latency_ns, allowed)
        self.usual.append(good)
        self.belief = self._believe()
        return good

    def _suspect(self, latency_ns: float, allowed_ns: float) -> None:
        self.odd.append(latency_ns)
        self.odd = self.odd[-_REGIME:]
        if len(self.odd) == _REGIME and max(self.odd) - min(self.odd) <= 2 * allowed_ns:
            self.latencies_ns.clear()
            self.latencies_ns.extend(self.odd)
            self.prior_sigma_ns = math.inf
            self.odd.clear()

    def _believe(self) -> LatencyEstimate:
        """Combine prior and median by information. The spread goes from the prior's to the MAD's on a log scale."""
        n = len(self.latencies_ns)
        if n == 0:
            return LatencyEstimate(self.prior_ns, self.prior_sigma_ns, self.prior_sigma_ns, self.count, self.outliers)
        median = float(np.median(self.latencies_ns))
        scatter = max(MAD_TO_SIGMA * float(np.median(np.abs(np.array(self.latencies_ns) - median))), _LEAST_SPREAD_NS)
        has_prior = math.isfinite(self.prior_sigma_ns)
        weight = n / (n + _REGIME)
        spread = scatter**weight * self.prior_sigma_ns ** (1.0 - weight) if has_prior else scatter
        information = n / (_MEDIAN_LOSS * spread**2)
        before = 1.0 / self.prior_sigma_ns**2 if has_prior else 0.0
        bias = (information * median + before * self.prior_ns) / (information + before)
        return LatencyEstimate(bias, 1.0 / math.sqrt(information + before), spread, self.count, self.outliers)


class LatencyModel:
    """Bias and spread of the latency per camera, from shots and the measured exposures that they caused.

    The prior is ``Camera.latency_s`` of the airframe file plus half the exposure (and half the rows of a rolling
    shutter).
    """

    def __init__(self, airframe: Airframe) -> None:
        self._paths = tuple(_path(camera) for camera in (airframe.left_camera, airframe.right_camera))
        self._fired: OrderedDict[int, int] = OrderedDict()
        self.unpaired = 0

    def shot(self, shot: Shot) -> None:
        """Remember when a plan was fired."""
        self._fired[shot.plan_id] = shot.fired_host_ns
        while len(self._fired) > _MAX_SHOTS:
            self._fired.popitem(last=False)

    def exposure(
        self, side: Side, plan_id: int, mid_exposure_host_ns: int, stamp_sigma_s: float = 0.0
    ) -> Reject | None:
        """Learn from a measured exposure.

        ``plan_id`` pairs it with its shot. If it is negative or unknown, the shot whose expected exposure is nearest in
        time is taken. ``UNPAIRED`` means that there is none, ``INCONSISTENT`` that the latency is an outlier. An
        exposure may come sooner after its command than its stamp is good, one-sigma ``stamp_sigma_s``. Then the stamp
        may be before the command; were such ones left out, the others would be late on average.
        """
        early_ns = _EARLY_SIGMAS * stamp_sigma_s * 1e9
        fired = self._fired.get(plan_id) if plan_id >= 0 else None
        if fired is None:
            fired = self._nearest(side, mid_exposure_host_ns, early_ns)
        if fired is None or not -early_ns <= mid_exposure_host_ns - fired <= MOST_LATENCY_NS:
            self.unpaired += 1
            return Reject.UNPAIRED
        good = self._paths[side].learn(float(mid_exposure_host_ns - fired))
        return None if good else Reject.INCONSISTENT

    def fired(self, plan_id: int) -> bool:
        """Whether a plan's shot is remembered."""
        return plan_id in self._fired

    def regular(self, side: Side) -> bool:
        """Whether most of a camera's last latencies were no outliers. Only then an outlier means a wrong stamp.

        A camera that runs freely, or whose latency is not that of the airframe file, has outliers all the time.
        """
        usual = self._paths[side].usual
        return 2 * sum(usual) > len(usual)

    def estimate(self, side: Side) -> LatencyEstimate:
        """Give the estimate of one camera."""
        return self._paths[side].belief

    @property
    def lead_ns(self) -> int:
        """Time from the command to the mean of both mid-exposures, ns."""
        return round(sum(path.belief.bias_ns for path in self._paths) / 2)

    def shifts_ns(self) -> tuple[float, float]:
        """Left and right mid-exposure relative to their mean, ns."""
        left, right = (path.belief.bias_ns for path in self._paths)
        return (left - right) / 2, (right - left) / 2

    def sigmas_ns(self) -> tuple[float, float]:
        """One-sigma of the next left and right mid-exposure, ns: bias and spread together."""
        left, right = (math.hypot(path.belief.bias_sigma_ns, path.belief.spread_ns) for path in self._paths)
        return left, right

    def learned(self, now_host_ns: int) -> TriggerLatency | None:
        """Give the learned latencies to keep for the next flight; None with too few shots."""
        beliefs = [path.belief for path in self._paths]
        shots = min(belief.count for belief in beliefs)
        if shots < _REGIME:
            return None
        latency = [(path.belief.bias_ns - path.to_middle_ns) * 1e-9 for path in self._paths]
        sigma = np.array(self.sigmas_ns()) * 1e-9
        return TriggerLatency(now_host_ns, np.maximum(np.array(latency), 0.0), sigma, shots)

    def _nearest(self, side: Side, mid_exposure_host_ns: int, early_ns: float) -> int | None:
        expected = mid_exposure_host_ns - self._paths[side].belief.bias_ns
        after_ns = ((fired, mid_exposure_host_ns - fired) for fired in self._fired.values())
        causes = [fired for fired, at_ns in after_ns if -early_ns <= at_ns <= MOST_LATENCY_NS]
        return min(causes, key=lambda fired: abs(fired - expected), default=None)


def to_middle_s(camera: Camera) -> float:
    """Time from the start of the first row's exposure to the middle of the middle row's, where stamps lie."""
    return camera.exposure_s / 2 + camera.row_time_s * camera.height_px / 2


def _path(camera: Camera | None) -> _TriggerPath:
    if camera is None:
        return _TriggerPath(0.0, 0.0)
    middle_s = to_middle_s(camera)
    sigma_ns = max(camera.latency_s.sigma * 1e9, _LEAST_SPREAD_NS)
    return _TriggerPath((camera.latency_s.value + middle_s) * 1e9, sigma_ns, to_middle_ns=middle_s * 1e9)
