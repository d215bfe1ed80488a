"""One flight of the worlds' campaign: true cameras, matches with the world's errors, the whole pipeline, its peers.

Nothing is rendered: a match is what both true lenses make of a point of the scene, with noise and blunders. What the
images of a world would do to matching stands in ``ImageFaults.match_ratio`` and in how many matches a ground gives.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.pipeline import start, step
from companion.evaluation.shot_scores import PipelineOutputs, collect
from companion.evaluation.true_geometry import TrueGeometry
from companion.params.airframe import Camera
from companion.params.settings import Settings
from companion.records import (
    Bools,
    ClockName,
    CorrectedRange,
    Floats,
    Flow,
    ImuBatch,
    MatchSet,
    Record,
    Side,
    Station,
    Tick,
    VehicleState,
)
from companion.sim.flight.flight import Flight, build_flight, undisturbed
from companion.sim.flight.offline import HOST_EPOCH_NS
from companion.sim.flight.world_draw import log_uniform
from companion.sim.flight.worlds import WORLDS
from companion.sim.vision.cameras import Shutters
from companion.sim.vision.posed_pair import PosedPair
from companion.sim.vision.scene import PosedCamera
from companion.sim.vision.scenery import scene_of
from tools.bench.slow import in_order
from tools.bench.world_constants import constants
from tools.bench.world_peers import PEERS, peer_toes
from tools.bench.world_rows import STRUCK_S, Accident, CampaignRow

_S = 1_000_000_000
_SHOT_NS, _VISION_NS, _TICK_NS = 150_000_000, 60_000_000, 20_000_000
_FEATURES, _MATCH_PX, _BLUNDERS, _BLUNDER_PX = 400, 0.1, 0.05, 3.0
_MATCHES = 150
_FADED = 0.3  # contrast over meadow's below which features are lost in proportion: the matcher's least gradient
_ROW_BLUNDERS = 0.25  # share of matches that take the wrong furrow
_NO_SHOTS = 2
_EDGE_PX = 10


class StruckPair(PosedPair):
    """The true pair, whose cameras heat turns, and whose right one is struck.

    From :data:`STRUCK_S` on that one is turned about every axis, by the knock's size in all.
    """

    def __init__(self, flight: Flight, knock_rad: float) -> None:
        super().__init__(flight.real.actual, flight.truth, scene_of(flight))
        self._actual, self._heat = flight.real.actual, flight.heat_turn()
        direction = flight.generator("knock").standard_normal(3)
        self._knock_rad: Floats = knock_rad * direction / np.linalg.norm(direction)

    def at(self, t_boot_ns: int) -> PosedPair:
        """The pair as it is at an instant."""
        left_rad, right_rad = self._heat.rotation_rad(t_boot_ns / _S)
        if t_boot_ns >= STRUCK_S * _S:
            right_rad = right_rad + self._knock_rad
        turns_rad = (left_rad, right_rad)
        airframe = self._actual.with_cameras(lambda side, camera: _turned(camera, turns_rad[side]))
        return PosedPair(airframe, self.truth, self.scene)


def _turned(camera: Camera, turn_rad: Floats) -> Camera:
    """The camera with a small rotation (3,) more, camera axes."""
    x, y, z = (np.array(camera.rotation_rad) + turn_rad).tolist()
    return dataclasses.replace(camera, rotation_rad=(x, y, z))


def fly(row: CampaignRow, number: int) -> dict[str, Any]:
    """One flight of a row as plain values: every judged shot with its peers' toes, and what was withheld."""
    flight = build_flight(row.belief(), row.seed(number), plan=row.plan(), world=WORLDS[row.world])
    if row.reference:
        flight = undisturbed(flight)
    pair = StruckPair(flight, row.accident.knock_rad)
    shots = list(judged_shots(flight, pair))
    stamped = [_stamped_late(as_stamped(matches, flight), row.accident, flight) for matches in shots]
    inputs = list(_too_fast(_lying(in_order(flight, stamped), row.accident), row.accident))
    lifts_s, lands_s = flight.plan.airborne_s
    outputs, learned = _outputs(flight, inputs, HOST_EPOCH_NS + round(lands_s * _S) - _TICK_NS)
    outputs.matches = {matches.pair_id: matches for matches in shots}
    judged = [_judged(flight, pair, outputs, entry) for _, entry in sorted(outputs.ranges.items())]
    peers = peer_toes(flight.airframe, inputs, [entry[:2] for entry in judged], outputs.matches)
    return {
        "row": row.name,
        "airframe": row.airframe,
        "sensors": row.sensors,
        "seed": row.seed(number),
        "shot_s": _SHOT_NS / _S,
        "lift_off_s": lifts_s,
        "touch_down_s": lands_s,
        "until_s": flight.duration_s,
        "columns": [*_COLUMNS, *PEERS],
        "judged": [[*entry, *(float(peers[name][i]) for name in PEERS)] for i, entry in enumerate(judged)],
        "withheld": dict(Counter(str(entry.reject) for entry in outputs.ranges.values() if not entry.trusted)),
        "refused": dict(outputs.rejected),
        "constants": learned,
    }


@dataclasses.dataclass(frozen=True, slots=True)
class CampaignTask:
    """One flight of a row as a task: its part file lies in the row's folder."""

    row: CampaignRow
    number: int
    folder: Path

    @property
    def name(self) -> str:
        """Row and number of the flight."""
        return f"{self.row.key} {self.number}"

    @property
    def result_file(self) -> Path:
        """Part file of the flight."""
        return self.folder / self.row.key / f"{self.number:04d}.json"


def fly_task(task: CampaignTask) -> dict[str, Any]:
    """Fly one task, in a worker."""
    return fly(task.row, task.number)


_COLUMNS = ("pair", "t_s", "true_toe", "toe", "toe_sigma", "true_m", "range_m", "sigma_m", "trusted", "axis_m")


def _judged(flight: Flight, pair: StruckPair, outputs: PipelineOutputs, entry: CorrectedRange) -> list[float]:
    """A shot's row; the truth is worked out where the range was published."""
    matches = outputs.matches[entry.pair_id]
    t_ns = int(matches.mid_exposure_ns.mean()) - HOST_EPOCH_NS
    toe = true_m = axis_m = math.nan
    if entry.trusted:
        geometry = TrueGeometry(flight, pair.at(t_ns), Settings(), HOST_EPOCH_NS)
        toe, axis_m = geometry.true_toe_rad(matches), geometry.true_range_m(matches)
        # of the features that this range counts: true extrinsics may count those of another surface
        reading = geometry.corrected(matches, *outputs.bends[entry.pair_id], outputs.turned.get(entry.pair_id))
        true_m = math.nan if reading is None else 1.0 / reading.true_inverse_pm
    return [entry.pair_id, t_ns / _S, toe, entry.toe_rad, entry.toe_sigma_rad, true_m, entry.range_m,
            entry.sigma_m, float(entry.trusted), axis_m]  # fmt: skip


def _outputs(flight: Flight, inputs: list[Record], lands_ns: int) -> tuple[PipelineOutputs, dict[str, list[float]]]:
    """Outputs of the whole pipeline, and the constants as it has them when the flight ends."""
    state = start(flight.airframe, dataclasses.replace(Settings(), trigger_policy=_NO_SHOTS))
    records: list[Record] = []
    learned: dict[str, list[float]] = {}
    for record in inputs:
        state, outputs = step(state, record)
        records += [record, *outputs] if isinstance(record, MatchSet) else outputs
        if not learned and isinstance(record, Tick) and record.now_host_ns >= lands_ns:
            learned = constants(state.tracker, flight.airframe, flight.real)
    return collect(records), learned


# ------------------------------------------------------------------------------------------------ matches


def judged_shots(flight: Flight, pair: StruckPair) -> Iterator[MatchSet]:
    """Matches at a steady rate, each camera exposed by its own latency, with the true instants."""
    shutters = Shutters(flight.real.actual, flight.seed)
    rng = flight.generator("match ratio")
    ratio = log_uniform(flight.world.images.match_ratio, rng)
    end_ns = round(flight.duration_s * _S) - 3 * _VISION_NS
    earlier: PosedCamera | None = None
    for number, edge_ns in enumerate(range(_S // 2, end_ns, _SHOT_NS)):
        mids = [shutters.exposure(side, edge_ns, number).mid_boot_ns for side in Side]
        posed = pair.at(mids[0])
        left_px, right_px, points = _matched(flight, posed, mids, ratio, number)
        flow = _flowed(flight, earlier, points, ratio, number)
        earlier = posed.view(Side.LEFT, mids[Side.LEFT])
        host_ns = np.array(mids, dtype=np.int64) + HOST_EPOCH_NS
        yield MatchSet(
            number, number, (ClockName.HOST, ClockName.HOST), host_ns, 2_000_000, 0,
            left_px, right_px, np.full(len(right_px), _MATCH_PX), int(host_ns.max()) + _VISION_NS,
            flow=flow,
        )  # fmt: skip


def as_stamped(matches: MatchSet, flight: Flight) -> MatchSet:
    """The matches with each camera's own stamps, as wrong as the airframe file states."""
    rng = np.random.default_rng([flight.seed, matches.pair_id, *b"stamps"])
    sigma_s = np.array([camera.stamp_sigma_s for camera in flight.airframe.camera_pair])
    error_ns = np.rint(sigma_s * rng.standard_normal(2) * _S).astype(np.int64)
    return dataclasses.replace(matches, mid_exposure_ns=matches.mid_exposure_ns + error_ns)


def _flowed(flight: Flight, earlier: PosedCamera | None, points: Floats, ratio: float, number: int) -> Flow | None:
    """Features at points (n, 3) found again in the left image of the pair before, with noise and blunders."""
    if earlier is None:
        return None
    rng = np.random.default_rng([flight.seed, number, *b"flow"])
    earlier_px = earlier.project(points)
    inside = np.all((earlier_px > _EDGE_PX) & (earlier_px < np.array(earlier.camera.lens.size_px) - _EDGE_PX), axis=1)
    index = np.flatnonzero(inside)
    earlier_px = earlier_px[index] + ratio * _MATCH_PX * rng.standard_normal((len(index), 2))
    wrong = rng.random(len(index)) < _BLUNDERS
    earlier_px[wrong] += rng.normal(0.0, _BLUNDER_PX, (int(wrong.sum()), 2))
    return Flow(number - 1, index, earlier_px, np.full(len(index), _MATCH_PX))


def _matched(
    flight: Flight, pair: PosedPair, mids: list[int], ratio: float, number: int
) -> tuple[Floats, Floats, Floats]:
    """Pixels (n, 2) of both cameras, and scene points (n, 3): features of the left image found in the right one."""
    rng = np.random.default_rng([flight.seed, number, *b"matches"])
    left, right = (pair.view(side, mids[side]) for side in Side)
    size = np.array(left.camera.lens.size_px, dtype=np.float64)
    left_px = rng.uniform(_EDGE_PX, size - _EDGE_PX, (_FEATURES, 2))
    points, textured = _seen_points(left, left_px, pair, rng)
    right_px = right.project(points)
    inside = np.all((right_px > _EDGE_PX) & (right_px < size - _EDGE_PX), axis=1) & textured
    left_px, right_px, points = (each[inside][:_MATCHES] for each in (left_px, right_px, points))
    right_px = right_px + ratio * _MATCH_PX * rng.standard_normal(right_px.shape)
    furrowed = any(plane.furrow > 1.0 for plane in pair.scene.planes)
    wrong = rng.random(len(right_px)) < (_ROW_BLUNDERS if furrowed else _BLUNDERS)
    right_px[wrong] += rng.normal(0.0, _BLUNDER_PX, (int(wrong.sum()), 2))
    return left_px, right_px, points


def _seen_points(left: PosedCamera, left_px: Floats, pair: PosedPair, rng: np.random.Generator) -> tuple[Floats, Bools]:
    """Scene points (n, 3) of left pixels, NaN for the sky, and which of them carry texture enough."""
    points = left.points_ned_m(pair.scene, left_px)
    floor = next(plane for plane in pair.scene.planes if plane.half_size_m is None)
    bare = np.abs(points[:, 2] - floor.centre_m[2]) < 0.01
    textured = rng.random(len(points)) < np.where(bare, min(floor.contrast / _FADED, 1.0), 1.0)
    return points, textured & np.isfinite(points[:, 0])


# ------------------------------------------------------------------------------------------------ accidents


def _stamped_late(matches: MatchSet, accident: Accident, flight: Flight) -> MatchSet:
    rng = np.random.default_rng([flight.seed, matches.pair_id, *b"late"])
    if rng.random() >= accident.late_share:
        return matches
    return dataclasses.replace(matches, mid_exposure_ns=matches.mid_exposure_ns + round(accident.late_s * _S))


def _lying(records: Iterable[Record], accident: Accident) -> Iterator[Record]:
    """The records with one sample of one sensor off by so much, the first that arrives after :data:`STRUCK_S`."""
    due, from_ns = accident.lie, HOST_EPOCH_NS + round(STRUCK_S * _S)
    for record in records:
        if due is not None and isinstance(record, ImuBatch) and _struck(record, due[0], from_ns):
            values = record.values.copy()
            values[0, due[1]] += due[2]
            record, due = dataclasses.replace(record, values=values), None
        yield record


def _too_fast(records: Iterable[Record], accident: Accident) -> Iterator[Record]:
    """The records with a wrong velocity over ground, along the path, from :data:`STRUCK_S` on."""
    from_ns = HOST_EPOCH_NS + round(STRUCK_S * _S)
    for record in records:
        if accident.velocity_mps and isinstance(record, VehicleState) and record.received_host_ns >= from_ns:
            assert record.velocity_ned_mps is not None
            velocity = np.array(record.velocity_ned_mps)
            north, east, down = (velocity * (1.0 + accident.velocity_mps / np.linalg.norm(velocity))).tolist()
            record = dataclasses.replace(record, velocity_ned_mps=(north, east, down))
        yield record


def _struck(batch: ImuBatch, station: Station, from_ns: int) -> bool:
    return batch.station is station and batch.received_host_ns > from_ns and len(batch.t_ns) > 0
