"""Exposures stamped by the autopilot: its hot-shoe pin feels the shutter, sometimes better than the camera's own stamp.

CAMERA_FEEDBACK carries the boot time of the pin's edge, cut to 32 bits of microseconds. It is as good as the boot clock
is known, about 0.3 ms. A camera that stamps the middle of its exposure in hardware is better. A camera whose frames are
stamped when a driver receives them (``stamp_sigma_s`` in the airframe file), or on an unknown clock, is worse.
"""

from __future__ import annotations

import dataclasses
import math
from collections import OrderedDict, deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from companion.core.clock.bank import ClockBank
from companion.core.trigger.latency import MOST_LATENCY_NS, LatencyModel
from companion.params.airframe import Airframe, Camera
from companion.records import CameraFeedback, ClockName, MatchSet, Reject, Shot, Side

WRAP_NS = 2**32 * 1000  # by definition: 32 bits of microseconds
_PIN_SIGMA_NS = 50e3
"""Sigma of the time from the shutter to the stamp of the pin's interrupt (choice)."""
_NEAR_NS = 20_000_000
"""Without a known plan, the edge of a pair lies within this time of its own stamp (choice)."""
_STAMP_SIGMAS = 6.0  # an edge further from the camera's own stamp is of another exposure (choice: as for latencies)
_LATE_NS = 1_000_000_000  # an edge that arrives later belongs to a pair already processed (choice)
_MAX_ENTRIES = 64  # edges and shots that may wait for their pair: seconds at any rate (choice)


class StampedPair(NamedTuple):
    """A pair, the number of its stamps by the autopilot's pin, and the one-sigma of the worse stamp, s."""

    matches: MatchSet
    by_pin: int
    sigma_s: float


class ExposureFeedback:
    """Edges and shots of the last seconds, and the stamps of pairs by them. ``clocks`` and ``latency`` are only read.

    Exposures may come later after their command than the next command, so an edge belongs to the shot after which it
    comes about as late as ``latency`` believes.
    """

    def __init__(self, airframe: Airframe, clocks: ClockBank, latency: LatencyModel) -> None:
        self._cameras = (airframe.left_camera, airframe.right_camera)
        self._clocks = clocks
        self._latency = latency
        self._edges: tuple[deque[tuple[int, int]], ...] = (deque(maxlen=_MAX_ENTRIES), deque(maxlen=_MAX_ENTRIES))
        self._shots: OrderedDict[int, int] = OrderedDict()

    def edge(self, feedback: CameraFeedback) -> Reject | None:
        """Add an edge, or give the reason not to: boot clock not known, no such camera, older than a second."""
        received_ns = feedback.received_host_ns
        state = self._clocks.state(ClockName.BOOT, received_ns)
        if not state.synced:
            return Reject.CLOCK_UNSYNCED
        if feedback.camera not in (0, 1):
            return Reject.FOREIGN_SOURCE
        now_boot_ns = received_ns + state.offset_ns
        age_ns = (now_boot_ns - feedback.t_ns + state.bound_ns) % WRAP_NS - state.bound_ns
        converted = self._clocks.to_host(ClockName.BOOT, np.array([now_boot_ns - age_ns], dtype=np.int64))
        if isinstance(converted, Reject):
            return converted
        if age_ns > _LATE_NS:
            return Reject.OUT_OF_WINDOW
        self._edges[feedback.camera].append((int(converted[0][0]), converted[1]))
        return None

    def shot(self, shot: Shot) -> None:
        """Add the time at which a plan was fired."""
        self._shots[shot.plan_id] = shot.fired_host_ns
        while len(self._shots) > _MAX_ENTRIES:
            self._shots.popitem(last=False)

    def stamped(self, matches: MatchSet) -> StampedPair:
        """Give the pair with the better stamp of each camera: its own, or the pin's."""
        clocks, stamps, used = list(matches.clocks), matches.mid_exposure_ns.copy(), 0
        sigmas_s = [0.0 if camera is None else camera.stamp_sigma_s for camera in self._cameras]
        for side, camera in zip(Side, self._cameras, strict=True):
            edge = None if camera is None else self._edge_of(matches, side, camera)
            if camera is None or edge is None:
                continue
            at_ns, bound_ns = edge
            # the truth may be anywhere within the bound
            sigma_ns = math.hypot(bound_ns / math.sqrt(3.0), _PIN_SIGMA_NS)
            if clocks[side] is not ClockName.HOST or sigma_ns < camera.stamp_sigma_s * 1e9:
                clocks[side], used = ClockName.HOST, used + 1
                stamps[side], sigmas_s[side] = at_ns + _to_middle_ns(matches, camera), sigma_ns * 1e-9
        if used:
            matches = dataclasses.replace(matches, clocks=(clocks[0], clocks[1]), mid_exposure_ns=stamps)
        return StampedPair(matches, used, max(sigmas_s))

    def _edge_of(self, matches: MatchSet, side: Side, camera: Camera) -> tuple[int, int] | None:
        """Edge of the plan's shot, else the one nearest to the pair's own stamp: host time and bound, ns."""
        fired_ns = self._shots.get(matches.plan_id)
        stamp_ns = None
        if matches.clocks[side] is ClockName.HOST:
            stamp_ns = int(matches.mid_exposure_ns[side]) - _to_middle_ns(matches, camera)
        if fired_ns is not None:
            edge = self._edge_after(fired_ns, side, _to_middle_ns(matches, camera))
        elif stamp_ns is not None:
            edge = _nearest(self._edges[side], stamp_ns)
            edge = edge if edge is not None and abs(edge[0] - stamp_ns) <= _NEAR_NS else None
        else:
            return None
        if edge is None or stamp_ns is None:
            return edge
        allowed_ns = _STAMP_SIGMAS * math.hypot(camera.stamp_sigma_s * 1e9, edge[1])
        return edge if abs(edge[0] - stamp_ns) <= allowed_ns else None

    def _edge_after(self, fired_ns: int, side: Side, to_middle_ns: int) -> tuple[int, int] | None:
        """Edge nearest to when this shot's is expected, unless it is nearer to when another shot's is."""
        latency_ns = self._latency.estimate(side).bias_ns - to_middle_ns
        caused = [edge for edge in self._edges[side] if -edge[1] <= edge[0] - fired_ns <= MOST_LATENCY_NS]
        edge = _nearest(caused, fired_ns + latency_ns)
        if edge is None:
            return None
        shot_ns = min(self._shots.values(), key=lambda at_ns: abs(at_ns + latency_ns - edge[0]))
        return edge if shot_ns == fired_ns else None


def _nearest(edges: Iterable[tuple[int, int]], at_ns: float) -> tuple[int, int] | None:
    return min(edges, key=lambda edge: abs(edge[0] - at_ns), default=None)


def _to_middle_ns(matches: MatchSet, camera: Camera) -> int:
    """Time from the shutter's edge to the middle of the middle row's exposure, ns."""
    return matches.exposure_ns // 2 + matches.row_time_ns * camera.height_px // 2
