"""Rigid stereo as a range finder: matches that perfect images of the path really flown would give, without any bend.

No image is rendered: points of the ground that both cameras see are projected by the true poses at each camera's own
exposure, and triangulated with fixed extrinsics. Matching noise is left out, to the benefit of rigid stereo.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from companion.evaluation.rendered_shots import Stage
from companion.evaluation.true_geometry import TrueGeometry
from companion.params.settings import Settings
from companion.records import ClockName, Floats, MatchSet, Side
from companion.sim.landing.landing_flight import LandingFlight
from companion.sim.landing.landing_vehicle import flight_of
from companion.sim.vision.cameras import Shutters
from companion.sim.vision.posed_pair import PosedPair

_READY_NS = 100_000_000  # from the line to the matches: exposure, readout and matching of a small computer (choice)
_STALE_NS = 500_000_000  # ArduPilot's rangefinder timeout
_COLUMNS, _ROWS = 16, 12  # chosen: of the grid of points: as many as a pair usually matches


class RigidStereo:
    """A :class:`companion.sim.landing.landing_flight.RangeSource` of fixed extrinsics.

    ``settings`` limit the range, and their trigger rate is that of the pairs. With ``in_trim`` the pair was calibrated
    in level flight, otherwise on the ground.
    """

    def __init__(self, landing: LandingFlight, settings: Settings, *, in_trim: bool) -> None:
        flight = flight_of(landing)
        stage = Stage.of(flight, settings, 0)
        self._pair = PosedPair(stage.actual, stage.truth, stage.scene)
        self._shutters = Shutters(stage.actual, stage.seed)
        geometry = TrueGeometry(flight, self._pair, settings, 0)
        self._range = geometry.rigid_in_trim if in_trim else geometry.rigid
        self._settings = settings
        self._period_ns = round(1e9 / settings.trigger_rate_hz)
        self._next_ns = 0
        self._edges: deque[int] = deque()
        self._shots = 0
        self._newest: tuple[int, float] | None = None

    def reading_m(self, now_ns: int) -> float | None:
        """Range of the newest pair, while it is fresh and inside the limits."""
        if now_ns >= self._next_ns:
            self._next_ns += self._period_ns
            self._edges.append(now_ns)
        while self._edges and self._edges[0] + _READY_NS <= now_ns:
            self._take(self._edges.popleft())
        if self._newest is None or now_ns - self._newest[0] > _STALE_NS:
            return None
        return self._newest[1]

    def _take(self, edge_ns: int) -> None:
        limits, reading = self._settings, self._range(self._matches(edge_ns))
        self._shots += 1
        if reading is None or reading.inverse_pm <= 0.0:
            return
        range_m = 1.0 / reading.inverse_pm
        if limits.min_range_m <= range_m <= limits.max_range_m:
            self._newest = (edge_ns + _READY_NS, range_m)

    def _matches(self, edge_ns: int) -> MatchSet:
        """Pixels of the same points of the ground in both images."""
        exposures = [self._shutters.exposure(side, edge_ns, self._shots) for side in Side]
        middles = [exposure.mid_boot_ns for exposure in exposures]
        left, right = (self._pair.view(side, middles[side]) for side in Side)
        left_px = _grid(left.camera.lens.size_px)
        right_px = right.project(left.points_ned_m(self._pair.scene, left_px))
        inside = np.all((right_px > -0.5) & (right_px < np.array(right.camera.lens.size_px) - 0.5), axis=1)
        clocks = (ClockName.BOOT, ClockName.BOOT)
        stamps = np.array(middles, dtype=np.int64)
        left_px, right_px, sigma_px = left_px[inside], right_px[inside], np.full(int(inside.sum()), 0.1)
        return MatchSet(
            self._shots, 0, clocks, stamps, exposures[0].exposure_ns, 0, left_px, right_px, sigma_px, edge_ns
        )


def _grid(size_px: tuple[int, int]) -> Floats:
    """Pixels (n, 2) spread evenly over an image."""
    width, height = size_px
    columns = (np.arange(_COLUMNS) + 0.5) * width / _COLUMNS - 0.5
    rows = (np.arange(_ROWS) + 0.5) * height / _ROWS - 0.5
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
