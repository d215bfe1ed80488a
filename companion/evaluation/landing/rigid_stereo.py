"""Rigid stereo as a range finder: images of the path that is really flown, matched, and ranged without any bend."""

from __future__ import annotations

from collections import deque

from companion.evaluation.rendered_shots import InProcessStudio, Pull, Stage
from companion.evaluation.true_geometry import TrueGeometry
from companion.params.settings import Settings
from companion.records import MatchSet
from companion.sim.landing.landing_flight import LandingFlight
from companion.sim.landing.landing_vehicle import flight_of

_READY_NS = 100_000_000  # from the line to the matches: exposure, readout and matching of a small computer
_STALE_NS = 500_000_000  # ArduPilot's rangefinder timeout


class RigidStereo:
    """A :class:`companion.sim.landing.landing_flight.RangeSource` of fixed extrinsics.

    Parameters
    ----------
    landing : LandingFlight
    settings : Settings
        Of the matching; its trigger rate is the rate of the images.
    in_trim : bool
        Calibrated in level flight; otherwise on the ground.
    from_s : float
        No image before.
    """

    def __init__(self, landing: LandingFlight, settings: Settings, *, in_trim: bool, from_s: float) -> None:
        flight = flight_of(landing)
        stage = Stage.of(flight, settings, 0)
        self._studio = InProcessStudio(stage)
        geometry = TrueGeometry(flight, stage.renderer(), settings, 0)
        self._range = geometry.rigid_in_trim if in_trim else geometry.rigid
        self._settings = settings
        self._period_ns = round(1e9 / settings.trigger_rate_hz)
        self._next_ns = round(from_s * 1e9)
        self._coming: deque[Pull] = deque()
        self._shots = 0
        self._newest: tuple[int, float] | None = None

    def reading_m(self, now_ns: int) -> float | None:
        """Range of the newest pair, while it is fresh and inside the limits."""
        if now_ns >= self._next_ns:
            self._next_ns += self._period_ns
            self._coming.append(Pull(self._shots, now_ns, now_ns + _READY_NS))
            self._studio.begin(self._coming[-1])
            self._shots += 1
        while self._coming and self._coming[0].matched_host_ns <= now_ns:
            self._take(self._coming.popleft())
        if self._newest is None or now_ns - self._newest[0] > _STALE_NS:
            return None
        return self._newest[1]

    def _take(self, pull: Pull) -> None:
        limits = self._settings
        for matches in (record for record in self._studio.result(pull.shot) if isinstance(record, MatchSet)):
            reading = self._range(matches.features())
            if reading is None or reading.inverse_pm <= 0.0:
                continue
            range_m = 1.0 / reading.inverse_pm
            if limits.min_range_m <= range_m <= limits.max_range_m:
                self._newest = (pull.matched_host_ns, range_m)
