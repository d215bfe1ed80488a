"""The correction's own business: attitude at exposure, what an untrusted wing withholds, and the same answer twice."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from companion.adapters.recordings.mcap.codec import dumps
from companion.core.stereo.correction import Correction
from companion.core.stereo.geometry import Rig
from companion.core.stereo.sectors import level_from_body
from companion.params.settings import Settings
from companion.records import (
    CorrectedRange,
    Deflection,
    MatchSet,
    ObstacleSectors,
    OutputRecord,
    Reject,
    Rejected,
    RelativeRotation,
    VehicleState,
)
from sitl_tests.unit.stereo_cases import bend, forward, match_set, raw_pixels, wall_ahead

MS = 1_000_000
SLOPES = (0.02, 0.024)
EXPOSED_NS = 1000 * MS
ROLL_RATE_RADPS = 0.8
YAW_RATE_RADPS = 0.4


class Still:
    """A tracker of a wing that does not move."""

    def __init__(self, distrust: Reject | None = None) -> None:
        self.distrust = distrust

    def smooth(self, t_host_ns: int) -> Deflection:
        return bend(SLOPES, t_ns=t_host_ns, slope_sigma_rad=2e-5)


def _vehicle(t_ns: int) -> VehicleState:
    """Rolling steadily, level one second before the exposure."""
    return VehicleState(
        0, t_ns, ROLL_RATE_RADPS * (t_ns - EXPOSED_NS + 500 * MS) * 1e-9, 0.0, 0.0, 20.0, 0.0, 0.5, True
    )


def _matches(number: int = 0) -> MatchSet:
    """A post ahead to the right, and ground 30 m below, from the bank that there is at exposure."""
    random = np.random.default_rng(5 + number)
    bearing = np.radians(10.0 + random.uniform(-1.0, 1.0, 40))
    post = np.column_stack([40.0 * np.cos(bearing), 40.0 * np.sin(bearing), random.uniform(-3, 3, 40)])
    ahead = random.uniform(60.0, 150.0, 300)
    ground = np.column_stack([ahead, ahead * random.uniform(-0.3, 0.3, 300), np.full(300, 30.0)])
    points = np.vstack([post, ground]) @ level_from_body(ROLL_RATE_RADPS * 0.5, 0.0)
    return _of_points(points, random, number)


def _of_wall(number: int = 0) -> MatchSet:
    """A wall across the axis: a range needs something there."""
    return _of_points(wall_ahead(60.0, 150, 5 + number), np.random.default_rng(5 + number), number)


def _of_points(points: np.ndarray, random: np.random.Generator, number: int) -> MatchSet:
    rig = Rig.from_airframe(forward(rotation_sigma_rad=2e-5))
    left, right = raw_pixels(rig, points, SLOPES)
    inside = np.all((left > 0) & (left < (640, 480)) & (right > 0) & (right < (640, 480)), axis=1)
    pixels = right[inside] + 0.02 * random.normal(size=right[inside].shape)
    exposed_ns = EXPOSED_NS + 100 * MS * number
    return match_set(left[inside], pixels, 0.02, mid_exposure_ns=(exposed_ns, exposed_ns))


def _states(on_ground_until_ns: int = 0) -> list[VehicleState]:
    """The autopilot's states, on the ground until an instant."""
    times_ns = range(0, 3000 * MS, 100 * MS)
    return [dataclasses.replace(_vehicle(t_ns), on_ground=t_ns < on_ground_until_ns) for t_ns in times_ns]


def test_on_the_ground_nothing_is_trusted_or_learnt_and_from_lift_off_on_it_is() -> None:
    correction = Correction.create(forward(rotation_sigma_rad=2e-5), Settings())
    lift_off_ns = EXPOSED_NS + 450 * MS
    for state in _states(lift_off_ns):
        correction.vehicle.add(state)
    outputs: list[OutputRecord] = []
    for number in range(12):
        assert not list(correction.add(_of_wall(number)))
        outputs += correction.due(Still(), EXPOSED_NS + (600 + 100 * number) * MS)
    rolling = [measured for measured in _of(CorrectedRange, outputs) if measured.t_host_ns < lift_off_ns]
    assert len(rolling) == 5
    assert {measured.reject for measured in rolling} == {Reject.ON_GROUND}
    assert {rotation.matches for rotation in _of(RelativeRotation, outputs)[:5]} == {0}
    assert min(sectors.t_host_ns for sectors in _of(ObstacleSectors, outputs)) > lift_off_ns
    aloft = _of(CorrectedRange, outputs)[5:]
    assert Reject.ON_GROUND not in {measured.reject for measured in aloft}
    assert aloft[-1].trusted


def test_an_autopilot_that_tells_nothing_of_the_ground_is_taken_to_fly() -> None:
    correction = Correction.create(forward(rotation_sigma_rad=2e-5), Settings())
    assert correction.vehicle.on_ground(EXPOSED_NS) is None
    correction.vehicle.add(_vehicle(EXPOSED_NS))
    assert correction.vehicle.on_ground(EXPOSED_NS) is None


class Yawing(Still):
    """A tracker of a wing that does not bend, whose aircraft yaws."""

    def smooth(self, t_host_ns: int) -> Deflection:
        return dataclasses.replace(super().smooth(t_host_ns), body_rate_radps=np.array([0.0, 0.0, YAW_RATE_RADPS]))


def test_stamps_that_are_worse_widen_the_toe_by_what_the_aircraft_turns_meanwhile() -> None:
    """Each camera's stamp is off by itself: the variance of the toe grows by twice that of one stamp's yaw."""
    variances = []
    for timing_sigma_s in (1e-4, 3e-3):
        correction = Correction.create(forward(rotation_sigma_rad=2e-5), Settings(hold_slow=0))
        correction.vehicle.add(_vehicle(EXPOSED_NS))
        assert not list(correction.add(_matches(), None, timing_sigma_s))
        (measured,) = _of(CorrectedRange, list(correction.due(Yawing(), EXPOSED_NS + 600 * MS)))
        variances.append(measured.toe_sigma_rad**2)
    turned_rad2 = 2.0 * YAW_RATE_RADPS**2 * (3e-3**2 - 1e-4**2)
    assert variances[1] - variances[0] == pytest.approx(turned_rad2, rel=0.02)


def _corrected(
    tracker: Any,
    settings: Settings,
    pairs: int = 1,
    *,
    vehicles: bool = True,
    misstamped: tuple[int, ...] = (),
    matched: Callable[[int], MatchSet] = _matches,
) -> list[OutputRecord]:
    correction = Correction.create(forward(rotation_sigma_rad=2e-5), settings)
    for t_ns in range(0, 1600 * MS, 100 * MS) if vehicles else ():
        correction.vehicle.add(_vehicle(t_ns))
    outputs: list[OutputRecord] = []
    for number in range(pairs):
        outputs += correction.add(matched(number), Reject.STAMP_OUTLIER if number in misstamped else None)
        outputs += correction.due(tracker, EXPOSED_NS + (600 + 100 * number) * MS)
    return outputs


def _of(kind: type[Any], outputs: list[OutputRecord]) -> list[Any]:
    return [output for output in outputs if isinstance(output, kind)]


def test_sectors_are_levelled_by_the_attitude_at_exposure_and_not_by_the_newest() -> None:
    (sectors,) = _of(ObstacleSectors, _corrected(Still(), Settings()))
    assert np.flatnonzero(sectors.known).tolist() == [2]
    assert sectors.distance_m[2] == pytest.approx(40.0, abs=4.0 * sectors.sigma_m[2])
    (bodily,) = _of(ObstacleSectors, _corrected(Still(), Settings(), vehicles=False))
    assert bodily.known.any()


def test_an_untrusted_wing_withholds_range_and_sectors_and_teaches_nothing() -> None:
    outputs = _corrected(Still(Reject.NOT_SETTLED), Settings(), pairs=4, matched=_of_wall)
    ranges = _of(CorrectedRange, outputs)
    assert len(ranges) == 4
    assert not any(measured.trusted for measured in ranges)
    assert Reject.NOT_SETTLED in {measured.reject for measured in ranges}
    assert not _of(ObstacleSectors, outputs)
    assert {rotation.matches for rotation in _of(RelativeRotation, outputs)} == {0}


class Refusing(Still):
    """A tracker that has no bend for some pairs."""

    refuses = False

    def smooth(self, t_host_ns: int) -> Any:
        return Reject.STALE if self.refuses else super().smooth(t_host_ns)


@pytest.mark.parametrize(("distrust", "doubted"), [(Reject.STALE, True), (None, False)], ids=["silent", "short gap"])
def test_after_a_time_without_a_bend_the_matches_tell_anew_and_soon(distrust: Reject | None, doubted: bool) -> None:
    correction, tracker = Correction.create(forward(rotation_sigma_rad=2e-5), Settings()), Refusing()
    for state in _states():
        correction.vehicle.add(state)
    outputs: list[OutputRecord] = []
    for number in range(12):
        tracker.refuses = number in (5, 6)
        tracker.distrust = distrust if tracker.refuses else None
        outputs += correction.add(_of_wall(number))
        outputs += correction.due(tracker, EXPOSED_NS + (600 + 100 * number) * MS)
    sigmas_rad = [measured.toe_sigma_rad for measured in _of(CorrectedRange, outputs)]
    assert len(sigmas_rad) == 10
    assert (sigmas_rad[5] > 1.5 * sigmas_rad[4]) is doubted
    assert all(measured.trusted for measured in _of(CorrectedRange, outputs)[-4:])


def test_a_pair_whose_stamps_are_wrong_gives_no_sectors_and_teaches_nothing() -> None:
    outputs = _corrected(Still(), Settings(), pairs=4, misstamped=(2,))
    assert [rotation.matches > 0 for rotation in _of(RelativeRotation, outputs)] == [True, True, False, True]
    assert len(_of(ObstacleSectors, outputs)) == 3


def test_matches_are_left_aside_where_the_parameter_says_so() -> None:
    on = _of(RelativeRotation, _corrected(Still(), Settings()))
    off = _of(RelativeRotation, _corrected(Still(), dataclasses.replace(Settings(), hold_slow=0)))
    assert on[0].matches > 30
    assert off[0].matches == 0
    assert np.all(off[0].slow_rad == 0.0)


@pytest.mark.slow
def test_the_same_inputs_give_the_same_bytes() -> None:
    first, other = (
        [dumps(type(output), output) for output in _corrected(Still(), Settings(), pairs=5)] for _ in range(2)
    )
    assert first == other
    assert len(_of(RelativeRotation, _corrected(Still(), Settings(), pairs=5))) == 5


def test_a_pair_stamped_in_the_future_holds_up_none_behind_it() -> None:
    airframe = forward(rotation_sigma_rad=2e-5)
    correction = Correction.create(airframe, Settings())
    late = _matches()
    ahead = dataclasses.replace(late, pair_id=99, mid_exposure_ns=late.mid_exposure_ns + 8_000 * MS)
    assert list(correction.add(ahead)) == list(correction.add(late)) == []
    outputs = list(correction.due(Still(), EXPOSED_NS + 2_000 * MS))
    (refused,) = _of(Rejected, outputs)
    assert (refused.reason, refused.what) == (Reject.STAMP_OUTLIER, "pair 99")
    assert [measured.pair_id for measured in _of(CorrectedRange, outputs)] == [late.pair_id]
