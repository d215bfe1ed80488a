"""Cameras that are knocked in flight, and exposures that are stamped late: flights of the whole loop, judged by truth.

``python -m sitl_tests.faults.camera_faults --flights 100`` flies so many of each fault, half of them with cameras that
look down, half ahead, over ground that differs from flight to flight, and prints a table. The loop, pipeline and
simulated vehicle are the real ones (:mod:`sitl_tests.loop.simulated_service`); matches are projections with noise.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from companion.core.stereo.geometry import Rig, orientation_axis
from companion.core.stereo.inverse_depth import RangeProduct, robust_inverse_depth
from companion.core.stereo.rotation import exp_rotation, log_rotation
from companion.core.stereo.triangulation import Depths, range_axis_of_rig
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, CorrectedRange, MatchSet, Side
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.vehicle.lockstep import LockStepClock
from sitl_tests.loop.simulated_service import EPOCH_NS, MS, Cameras, SimulatedService

FLOWN_S, SETTLED_S, KNOCK_S = 22.0, 10.5, (12.5, 17.0)
AIRFRAMES = ("nadir-2m", "forward-2m")
_LATE_NS = 15 * MS
_EXPOSURE_NS, _VISION_NS = 2 * MS, 60 * MS
_EDGE_PX = 8.0
_SIGMAS, _ERROR_RATIO = 5.0, 0.05
_WAVES_M = np.array([200.0, 120.0, 60.0, 30.0, 20.0])
_HEIGHTS = np.array([1.0, 0.7, 0.4, 0.25, 0.15])


@dataclass(frozen=True)
class CameraFault:
    """Faults of the cameras: a knock about any axis or the toe's, ``at_s`` or any time; a share of late stamps."""

    name: str
    knock_rad: float = 0.0
    toe_only: bool = False
    late: float = 0.0
    sides: tuple[int, ...] = (0, 1)
    at_s: float | None = None


FAULTS = (
    CameraFault("none"),
    CameraFault("a camera knocked by 0.5 mrad", 0.0005),
    CameraFault("a camera knocked by 1 mrad", 0.001),
    CameraFault("a camera knocked by 2 mrad", 0.002),
    CameraFault("a camera knocked by 5 mrad", 0.005),
    CameraFault("a camera knocked by 2 mrad of toe alone", 0.002, toe_only=True),
    CameraFault("a fifth of the stamps 15 ms late", late=0.2),
    CameraFault("a fifth of the left stamps 15 ms late", late=0.2, sides=(0,)),
)


@dataclass(frozen=True)
class View:
    """The scene: how far, how rough, how many matches and how good."""

    range_m: float = 40.0
    relief_m: float = 0.0
    matches: int = 60
    sigma_px: float = 0.05
    blunders: float = 0.0

    @classmethod
    def drawn(cls, random: np.random.Generator) -> View:
        """Any of what a flight may meet."""
        return cls(
            range_m=float(random.uniform(25.0, 70.0)),
            relief_m=float(random.uniform(0.0, 2.0)),
            matches=int(random.integers(100, 400)),
            sigma_px=float(random.uniform(0.05, 0.15)),
            blunders=0.05,
        )


@dataclass
class StruckCameras(Cameras):
    """Cameras that a fault befalls; ``truth_m`` is the range of each pair by its number, by exact matches."""

    fault: CameraFault = FAULTS[0]
    view: View = field(default_factory=View)
    truth_m: dict[int, float] = field(default_factory=dict)
    late: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._random = np.random.default_rng([self.flight.seed, 0xCA])
        self._phases = self._random.uniform(0.0, 2.0 * np.pi, len(_WAVES_M))
        drawn_s = float(self._random.uniform(*KNOCK_S))
        at_s = drawn_s if self.fault.at_s is None else self.fault.at_s
        self.knock_ns = int(at_s * 1e9) if self.fault.knock_rad else None
        self._knocked = self._turned(self.flight.airframe)

    def _turned(self, airframe: Airframe) -> Rig:
        """The rig after the knock: one of its cameras turned about an axis drawn from the sphere."""
        side = Side(int(self._random.integers(2)))
        axis = self._random.standard_normal(3)
        if self.fault.toe_only:
            axis = np.array([1.0, 0.0, 0.0] if airframe.looks_down else [0.0, 0.0, 1.0])
        turn_body = self.fault.knock_rad * axis / np.linalg.norm(axis)
        name = f"{side.name.lower()}_camera"
        camera = getattr(airframe, name)
        turn = exp_rotation(self._rig.camera(side).rest.camera_from_body @ turn_body)
        x, y, z = log_rotation(exp_rotation(np.array(camera.rotation_rad)) @ turn).tolist()
        return Rig.from_airframe(
            dataclasses.replace(airframe, **{name: dataclasses.replace(camera, rotation_rad=(x, y, z))})
        )

    def _matches(self, plan_id: int, middle_ns: int) -> MatchSet:
        self.made += 1
        boot_ns, view, random = middle_ns - EPOCH_NS, self.view, self._random
        truth = self.flight.truth.at(boot_ns)
        rig = self._knocked if self.knock_ns is not None and boot_ns >= self.knock_ns else self._rig
        points = self._points(truth.position_ned_m)
        poses = [rig.pose(side, float(truth.slope_rad[side]), float(truth.lift_m[side])) for side in Side]
        pixels = [rig.project(side, pose, points) for side, pose in zip(Side, poses, strict=True)]
        size = np.array(rig.left.lens.size_px)
        inside = np.all([(px > _EDGE_PX) & (px < size - _EDGE_PX) for px in pixels], axis=(0, 2))
        points, left_px, right_px = (entry[inside][: view.matches] for entry in (points, *pixels))
        self.truth_m[self.made] = self._range_m(points)
        noise = view.sigma_px * random.standard_normal((2, *left_px.shape))
        wrong = random.random(len(points)) < view.blunders
        noise[1][wrong] += random.normal(0.0, 3.0, (int(wrong.sum()), 2))
        stamps_ns = np.array([middle_ns, middle_ns])
        if random.random() < self.fault.late:
            stamps_ns[list(self.fault.sides)] += _LATE_NS
            self.late += 1
        return MatchSet(
            pair_id=self.made,
            plan_id=plan_id,
            clocks=(ClockName.HOST, ClockName.HOST),
            mid_exposure_ns=stamps_ns,
            exposure_ns=_EXPOSURE_NS,
            row_time_ns=0,
            left_px=left_px + noise[0],
            right_px=right_px + noise[1],
            sigma_px=np.full(len(points), view.sigma_px),
            matched_host_ns=middle_ns + _VISION_NS,
        )

    def _points(self, position_m: np.ndarray) -> np.ndarray:
        """Points of a rough surface across the view, which passes by with the flight, body axes."""
        count, reach = 3 * self.view.matches, self.view.range_m
        across = self._random.uniform(-0.36, 0.36, (count, 2)) * reach
        where = across + position_m[:2]
        waves = np.stack([np.cos(self._phases), np.sin(self._phases)])
        rough = np.sin(2.0 * np.pi * (where @ waves) / _WAVES_M + 3.0 * self._phases) @ _HEIGHTS
        depth = reach + self.view.relief_m * rough
        scaled = across * (depth / reach)[:, np.newaxis]
        if self.flight.airframe.looks_down:
            return np.column_stack([scaled[:, 0], scaled[:, 1], depth])
        return np.column_stack([depth, scaled[:, 0], scaled[:, 1]])

    def _range_m(self, points: np.ndarray) -> float:
        """Range of the product from exact depths."""
        sight = range_axis_of_rig(self._rig, orientation_axis(self.flight.airframe.orientation))
        depth = (points - sight.origin_m) @ sight.axis
        tangent = ((points - sight.origin_m) @ sight.across.T) / depth[:, np.newaxis]
        parallax = 1e-9 * np.cos(np.arange(len(points)))
        depths = Depths(1.0 / depth, np.full(len(points), 1e-5), tangent, parallax, np.zeros(len(points)))
        down = self.flight.airframe.looks_down
        reading = robust_inverse_depth(depths, RangeProduct.MEDIAN, Settings().min_matches, one_surface=down)
        assert reading is not None
        return 1.0 / reading.inverse_pm


@dataclass(frozen=True)
class FlightOutcome:
    """One flight: ranges by trust and truth, and the longest time between trusted ones from the knock on."""

    fault: str
    airframe: str
    seed: int
    trusted: int
    judged: int
    wrong: int
    far_off: int
    again_s: float
    late: int


def fly(airframe: str, fault: CameraFault, seed: int, view: View | None = None) -> FlightOutcome:
    """One flight, judged by exact matches; wrong is more than 5 sigma and 5 % off while trusted."""
    flight = build_flight(load_airframe(airframe), seed, FLOWN_S + 1.0)
    view = view or View.drawn(np.random.default_rng([seed, 0x5C]))

    def cameras(flight: Flight, clock: LockStepClock) -> StruckCameras:
        return StruckCameras(flight, clock, fault=fault, view=view)

    service = SimulatedService(flight, cameras=cameras)
    eyes = service.cameras
    assert isinstance(eyes, StruckCameras)
    service.fly(FLOWN_S)
    service.close()
    ranges = [entry for entry in service.tape.records if isinstance(entry, CorrectedRange)]
    settled = [entry for entry in ranges if entry.t_host_ns - EPOCH_NS >= SETTLED_S * 1e9]
    trusted = [entry for entry in settled if entry.trusted]
    error_m = np.array([abs(entry.range_m - eyes.truth_m[entry.pair_id]) for entry in trusted])
    true_m = np.array([eyes.truth_m[entry.pair_id] for entry in trusted])
    sigma_m = np.array([entry.sigma_m for entry in trusted])
    far = error_m > _ERROR_RATIO * true_m
    since_s = (eyes.knock_ns or 0) * 1e-9 - 0.5
    at_s = np.array([1e-9 * (entry.t_host_ns - EPOCH_NS) for entry in trusted])
    again_s = float(np.max(np.diff([*at_s[at_s > since_s], at_s[-1] + 0.1]))) if len(at_s) else np.inf
    wrong = int(np.sum(far & (error_m > _SIGMAS * sigma_m)))
    return FlightOutcome(
        fault.name, airframe, seed, len(trusted), len(settled), wrong, int(far.sum()), again_s, eyes.late
    )


def flights(fault: CameraFault, count: int, first: int = 0) -> Iterator[FlightOutcome]:
    """So many flights of one fault, both airframes in turn, from number ``first`` on."""
    for number in range(first, first + count):
        yield fly(AIRFRAMES[number % len(AIRFRAMES)], fault, 1 + number)


HEAD = (
    "| what befell the cameras | flights | ranges trusted of those judged | wrong | more than 5 % off | "
    "longest pause: median, worst |\n|---|---|---|---|---|---|"
)


def row(fault: CameraFault, outcomes: list[FlightOutcome]) -> str:
    """A line of the table."""
    trusted, judged, wrong, far = (
        sum(getattr(entry, name) for entry in outcomes) for name in ("trusted", "judged", "wrong", "far_off")
    )
    pauses_s = np.array([entry.again_s for entry in outcomes])
    pause = f"{np.median(pauses_s):.2f} s, {pauses_s.max():.2f} s"
    return f"| {fault.name} | {len(outcomes)} | {trusted} of {judged} | {wrong} | {far} | {pause} |"


def main(arguments: list[str] | None = None) -> int:
    """Fly and print; 1 where a trusted range was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=100, help="of each fault")
    parser.add_argument("--first", type=int, default=0, help="number of the first one: a campaign in parts")
    parser.add_argument("--fault", default="", help="only those whose name contains this")
    options = parser.parse_args(arguments)
    print(HEAD, flush=True)
    wrong = 0
    for fault in FAULTS:
        if options.fault in fault.name:
            outcomes = []
            for outcome in flights(fault, options.flights, options.first):
                outcomes.append(outcome)
                print(f"  {outcome}", file=sys.stderr, flush=True)
            wrong += sum(entry.wrong for entry in outcomes)
            print(row(fault, outcomes), flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
