"""Contradictions are not trusted: knocked cameras, late stamps, a misled tracker; and real surfaces are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from companion.core.stereo.consistency_gate import (
    Innovation,
    MatchTest,
    MatchVerdict,
    RangeGate,
    range_reject,
    range_slack_mps,
    withheld,
)
from companion.core.stereo.correction import Correction
from companion.core.stereo.geometry import Rig
from companion.core.stereo.rotation import exp_rotation, log_rotation
from companion.params.settings import Settings
from companion.records import CorrectedRange, Deflection, Notice, Reject, VehicleState
from sitl_tests.unit.stereo_cases import bend, ground_below, match_set, nadir, raw_pixels

MS = 1_000_000
PERIOD_NS = 120 * MS
SLOPE, FAST_RAD, SLOW_RAD = 0.02, 1e-4, 1e-4
MATCH_PX, MATCHES = 0.1, 120
CALM_PAIRS, PAIRS = 15, 40
PITCH, YAW, ROLL = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)  # body axes; epipolar y is body x of a nadir pair


@dataclass
class ScriptedTracker:
    """A tracker that says what it is given: its bend errs by its own fast sigma, and by a lie."""

    seed: int
    lie_rad: float = 0.0
    distrust: Reject | None = None

    def smooth(self, t_host_ns: int) -> Deflection:
        error = FAST_RAD * np.random.default_rng([self.seed, t_host_ns]).standard_normal(2) + self.lie_rad
        wing = bend((SLOPE + error[0], SLOPE + error[1]), t_ns=t_host_ns, slope_sigma_rad=FAST_RAD)
        covariance = wing.covariance.copy()
        covariance[4:, 4:] += SLOW_RAD**2
        return dataclasses.replace(wing, covariance=covariance, slow_slope_sigma_rad=SLOW_RAD)


@dataclass(frozen=True)
class Strike:
    """Faults of a pair."""

    turned_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the right camera, body axes
    range_m: float = 60.0
    distrust: Reject | None = None
    lie_rad: float = 0.0
    late_rad: float = 0.0  # by how much more both wings were bent than at the stamp
    match_px: float = MATCH_PX
    matches: int = MATCHES
    stamps: Reject | None = None  # what the learned latency says of the stamps
    roll_rad: float | None = None  # of the aircraft, as its autopilot tells it


def flown(
    struck: Callable[[int], Strike], seed: int, settings: Settings | None = None, pairs: int = PAIRS
) -> tuple[list[CorrectedRange], list[Notice]]:
    """Correct pair after pair; the ranges, one per pair, and what was said."""
    airframe = nadir()
    assert airframe.right_camera is not None
    rig = Rig.from_airframe(airframe)
    correction, tracker = Correction.create(airframe, settings or Settings()), ScriptedTracker(seed)
    ranges: list[CorrectedRange] = []
    said: list[Notice] = []
    for k in range(pairs):
        strike = struck(k)
        tracker.lie_rad, tracker.distrust = strike.lie_rad, strike.distrust
        body_from_camera = rig.right.rest.camera_from_body.T
        x, y, z = (body_from_camera.T @ np.array(strike.turned_rad)).tolist()
        camera = dataclasses.replace(airframe.right_camera, rotation_rad=tuple(log_rotation(exp_rotation([x, y, z]))))
        true_rig = Rig.from_airframe(dataclasses.replace(airframe, right_camera=camera))
        slope = SLOPE + strike.late_rad
        left_px, right_px = raw_pixels(
            true_rig, ground_below(strike.range_m, strike.matches, 1000 * seed + k), (slope, slope)
        )
        right_px = right_px + strike.match_px * np.random.default_rng([seed, k]).standard_normal(right_px.shape)
        exposed_ns = 10_000 * MS + k * PERIOD_NS
        matches = match_set(left_px, right_px, strike.match_px, mid_exposure_ns=(exposed_ns, exposed_ns))
        if strike.roll_rad is not None:
            state = VehicleState(exposed_ns, exposed_ns, strike.roll_rad, 0.0, 0.0, 0.0, 0.0, 0.0, armed=True)
            correction.vehicle.add(state)
        list(correction.add(matches, strike.stamps))
        for output in correction.due(tracker, exposed_ns + 1000 * MS):
            if isinstance(output, CorrectedRange):
                ranges.append(output)
            elif isinstance(output, Notice):
                said.append(output)
    return ranges, said


def wrong(ranges: list[CorrectedRange], range_m: float = 60.0) -> int:
    errors = [(abs(entry.range_m - range_m), entry.sigma_m) for entry in ranges if entry.trusted]
    return sum(error_m > 5.0 * sigma_m or error_m > 0.05 * range_m for error_m, sigma_m in errors)


def longest_pause_s(ranges: list[CorrectedRange], since: int = 5) -> float:
    at_s = [1e-9 * entry.t_host_ns for entry in ranges[since:] if entry.trusted]
    at_s.append(1e-9 * ranges[-1].t_host_ns)
    return float(np.max(np.diff(at_s)))


# ------------------------------------------------------------------------------------- cameras


@pytest.mark.slow
def test_without_a_fault_every_range_from_the_third_on_is_trusted() -> None:
    for seed in range(2):
        ranges, said = flown(lambda k: Strike(), seed)
        assert [entry.trusted for entry in ranges] == [False, False] + [True] * (PAIRS - 2)
        assert wrong(ranges) == 0
        assert not said


@pytest.mark.slow
def test_poor_matches_at_eighty_metres_are_trusted_too() -> None:
    """Chance in the innovation is no reason to doubt: the ranges' sigma is 1 % here, the limit 3 %."""
    for seed in range(3):
        ranges, said = flown(lambda k: Strike(range_m=80.0, match_px=0.3, matches=100), seed)
        assert np.mean([entry.trusted for entry in ranges[2:]]) > 0.95
        assert wrong(ranges, 80.0) == 0
        assert not said


@pytest.mark.slow
@pytest.mark.parametrize("axis", [PITCH, YAW, ROLL, (0.6, 0.48, -0.64)])
def test_a_camera_knocked_by_two_milliradians_is_noticed_and_trusted_again_within_a_second(
    axis: tuple[float, float, float],
) -> None:
    """About its yaw alone 2 mrad are 3.5 m of 60 m, and one pair sees it to half a milliradian."""
    for seed in range(2):
        x, y, z = (0.002 * (-1) ** seed * np.array(axis)).tolist()
        ranges, said = flown(lambda k: Strike((x, y, z) if k >= CALM_PAIRS else (0.0, 0.0, 0.0)), seed)  # noqa: B023
        assert wrong(ranges) == 0
        assert longest_pause_s(ranges) < 1.0
        assert all(entry.trusted for entry in ranges[-10:])
        assert len(said) == 1


@pytest.mark.slow
def test_late_stamps_cost_their_own_pairs_only() -> None:
    """Every seventh pair was exposed when the wings were bent by 2 mrad more than at its stamp: 4 mrad of toe."""
    late = [k for k in range(8, PAIRS) if k % 7 == 0]
    for seed in range(2):
        ranges, _ = flown(lambda k: Strike(late_rad=0.002 if k in late else 0.0), seed)
        assert wrong(ranges) == 0
        timely = [entry.trusted for k, entry in enumerate(ranges) if k not in late and k > 2]
        assert np.mean(timely) > 0.95


@pytest.mark.slow
@pytest.mark.parametrize("late_rad", [0.0003, 0.002])
def test_late_stamps_that_the_latency_shows_cost_no_other_pair_even_in_a_row(late_rad: float) -> None:
    """Ten in a row, 0.6 or 4 mrad of toe: taken for true they would be a knock, or teach the filter an offset."""
    late = range(CALM_PAIRS, CALM_PAIRS + 10)

    def struck(k: int) -> Strike:
        return Strike(late_rad=late_rad, stamps=Reject.STAMP_OUTLIER) if k in late else Strike()

    for seed in range(2):
        ranges, said = flown(struck, seed)
        assert wrong(ranges) == 0
        assert {entry.reject for entry in ranges[late.start : late.stop]} == {Reject.STAMP_OUTLIER}
        assert all(entry.trusted for entry in [*ranges[2 : late.start], *ranges[late.stop :]])
        assert not said


# ------------------------------------------------------------------------------------- tracker


@pytest.mark.parametrize("lie_rad", [-0.0025, 0.0015, 0.003])
def test_a_tracker_that_lies_after_a_time_of_distrust_is_held_against_the_matches(lie_rad: float) -> None:
    """3.5 s of distrust, then both tips' slopes wrong by as much, fading over 3 s: the toe errs by twice it."""

    def struck(k: int) -> Strike:
        lost, back = CALM_PAIRS, CALM_PAIRS + 29
        faded = lie_rad * np.exp(-max(k - back, 0) * PERIOD_NS / 3e9)
        return Strike(distrust=Reject.CONTRADICTED if lost <= k < back else None, lie_rad=faded if k >= lost else 0.0)

    ranges, _ = flown(struck, 1, pairs=75)
    assert wrong(ranges) == 0
    assert np.mean([entry.trusted for entry in ranges[-15:]]) > 0.9


# ------------------------------------------------------------------------------------- surfaces


@pytest.mark.parametrize("step_m", [-15.0, 12.0, 25.0])
def test_a_real_step_of_the_ground_is_believed_within_a_second_and_a_half(step_m: float) -> None:
    """A cliff or a roof: the matches tell the toe anew, and what they confirm is no fault."""
    ranges, _ = flown(lambda k: Strike(range_m=60.0 + (step_m if k >= CALM_PAIRS else 0.0)), 5)
    assert wrong(ranges[:CALM_PAIRS]) == 0
    assert wrong(ranges[CALM_PAIRS:], 60.0 + step_m) == 0
    back = next(k for k in range(CALM_PAIRS, PAIRS) if ranges[k].trusted)
    assert (back - CALM_PAIRS) * PERIOD_NS < 1500 * MS
    assert all(entry.trusted for entry in ranges[back:])


def rolled_rad(k: int) -> float:
    """Roll of a pair: from 45 degrees on one side to 45 on the other and back within 3 s, 1.6 rad/s at most."""
    return float(np.radians(45.0) * np.cos(2.0 * np.pi * k * PERIOD_NS / 3e9))


@pytest.mark.slow
def test_a_bank_lengthens_the_range_and_moves_no_ground() -> None:
    """Level ground 50 m below lies 50/cos(bank) along the axis: up to 80 m/s of change, and no jump."""
    for seed in range(2):
        ranges, said = flown(lambda k: Strike(range_m=50.0 / np.cos(rolled_rad(k)), roll_rad=rolled_rad(k)), seed)
        assert [entry.trusted for entry in ranges] == [False, False] + [True] * (PAIRS - 2)
        assert not said


def banked(rolls_rad: list[float], heights_m: list[float], level_rad: float = 0.0) -> list[bool]:
    """Whether each range is trusted, sigma 0.05 m; the autopilot's roll is ``level_rad`` more than the cameras'."""
    gate, trusted = RangeGate(1.0), []
    for k, (roll_rad, height_m) in enumerate(zip(rolls_rad, heights_m, strict=True)):
        range_m = height_m / float(np.cos(roll_rad))
        measured = CorrectedRange(
            k, k, k * PERIOD_NS, 25, range_m, 0.05, 0.0, 1e-4, range_m, 100, trusted=True, reject=None
        )
        told_rad = (roll_rad + level_rad, 0.0)
        trusted.append(gate.judge(measured, 0.0, slack_mps=0.0, attitude_rad=told_rad).trusted)
    return trusted


def test_a_jump_in_a_bank_is_a_jump() -> None:
    """2 m of 50 are none where only the bank explains them, and ranges that stay as a bank ends have jumped."""
    steady = [float(np.radians(45.0))] * 10
    assert banked(steady, [50.0] * 6 + [52.0] * 4) == [False, False] + [True] * 4 + [False] * 4
    levelled = steady[:6] + [0.0] * 4
    assert not any(banked(levelled, [50.0] * 6 + [50.0 / float(np.cos(steady[0]))] * 4)[6:])


def test_axes_that_the_autopilot_has_wrong_by_two_degrees_make_no_jump() -> None:
    """From 45 degrees to 45 they change the height by 3.5 m of 50; in a steady bank they excuse nothing."""
    rolls_rad = [float(np.radians(45.0)) * (-1.0) ** k for k in range(12)]
    assert all(banked(rolls_rad, [50.0] * 12, level_rad=0.035)[2:])


def over_a_slope(slope: float, *, toe_confirmed: bool, airspeed_mps: float = 22.0) -> list[bool]:
    """Whether each range is trusted, of an aircraft that flies level towards a slope; it begins at the tenth pair."""
    gate, slack_mps = RangeGate(1.0), range_slack_mps(True, airspeed_mps, toe_confirmed=toe_confirmed)
    trusted = []
    for k in range(20):
        range_m = 60.0 - slope * airspeed_mps * 1e-9 * PERIOD_NS * max(k - 9, 0)
        measured = CorrectedRange(
            k, k, k * PERIOD_NS, 25, range_m, 0.05, 0.0, 1e-4, range_m, 100, trusted=True, reject=None
        )
        trusted.append(gate.judge(measured, 0.0, slack_mps).trusted)
    return trusted


@pytest.mark.parametrize(
    ("pairs_m", "pause_s", "trusted"),
    [
        ([60.5, 60.0], 0.0, [True, True]),
        ([56.0, 60.0], 0.0, [False, True]),
        ([56.0, 56.5], 0.0, [False, True]),  # two that agree, both 2.5 sigma and more from the last trusted one
        ([60.5, 60.0], 30.0, [False, False]),  # long ago: three must agree
    ],
)
def test_the_first_range_by_a_toe_learnt_anew_needs_another_unless_it_lies_close(
    pairs_m: list[float], pause_s: float, trusted: list[bool]
) -> None:
    """Sigma 1 m: 4 m from the last trusted range may be noise of 2.8 sigma, or the matches of a single pair."""
    gate = RangeGate(1.0)

    def judged(k: int, range_m: float, after_s: float = 0.0) -> bool:
        at_ns = k * PERIOD_NS + round(1e9 * after_s)
        measured = CorrectedRange(k, k, at_ns, 25, range_m, 1.0, 0.0, 1e-4, range_m, 100, trusted=True, reject=None)
        return gate.judge(measured, 0.0, slack_mps=0.0).trusted

    assert [judged(k, 60.0) for k in range(4)] == [False, False, True, True]
    gate.reopened()
    assert [judged(4 + k, range_m, pause_s) for k, range_m in enumerate(pairs_m)] == trusted


@pytest.mark.parametrize("slope", [-0.9, 0.9])
def test_a_slope_of_forty_degrees_is_believed_at_once_where_the_flow_confirms_the_toe(slope: float) -> None:
    assert all(over_a_slope(slope, toe_confirmed=True)[2:])
    assert not all(over_a_slope(slope, toe_confirmed=False)[10:])


def test_no_slope_explains_a_jump_that_a_turned_camera_does() -> None:
    assert not any(over_a_slope(1.6, toe_confirmed=True)[10:])


def test_where_nothing_looks_at_matches_a_new_surface_must_stay_for_five_seconds() -> None:
    blind = dataclasses.replace(Settings(), hold_slow=0)
    ranges, _ = flown(lambda k: Strike(range_m=50.0 if k >= 8 else 40.0), 6, blind, pairs=60)
    assert all(entry.trusted for entry in ranges[2:8])
    trusted = [k for k in range(8, 60) if ranges[k].trusted]
    assert (trusted[0] - 8) * PERIOD_NS == pytest.approx(5e9, abs=PERIOD_NS)
    assert trusted == list(range(trusted[0], 60))


# ------------------------------------------------------------------------------------- the test itself


def _verdicts(shift_sigmas: float, count: int, seed: int) -> list[MatchVerdict]:
    test, random = MatchTest(), np.random.default_rng(seed)
    sigma_rad = np.array([2e-5, 5e-4, 1e-4])
    shift = np.array([0.0, shift_sigmas, 0.0])
    units = random.standard_normal((count, 3)) + shift
    return [test.take(Innovation(sigma_rad * unit, np.diag(sigma_rad**2)))[0] for unit in units]


@pytest.mark.slow
def test_chance_opens_nothing_in_ten_minutes_at_eight_pairs_a_second() -> None:
    said = _verdicts(0.0, 8 * 600 * 10, 1)
    assert said.count(MatchVerdict.KNOCKED) <= 2, "in a hundred minutes"
    assert said.count(MatchVerdict.OUTLIER) <= 2


@pytest.mark.parametrize(("shift_sigmas", "pairs"), [(2.0, 20), (3.5, 8), (8.0, 5)])
def test_a_shift_that_one_pair_hardly_shows_adds_up(shift_sigmas: float, pairs: int) -> None:
    """The sum grows by the shift less three quarters of a sigma a pair; far outliers open by their number."""
    for seed in range(20):
        assert MatchVerdict.KNOCKED in _verdicts(shift_sigmas, pairs, seed)


RANGE = CorrectedRange(0, 0, PERIOD_NS, 25, 40.0, 0.5, 0.0, 1e-4, 40.0, 100, trusted=True, reject=None)


def test_a_sigma_that_is_no_number_is_too_large() -> None:
    assert range_reject(100, 40.0, 0.5, Settings()) is None
    assert range_reject(100, 40.0, np.nan, Settings()) is Reject.SIGMA_TOO_LARGE


def test_a_reason_of_the_pair_is_said_before_one_of_its_range() -> None:
    """A contradicted tracker makes sigmas large: the operator is told of the tracker."""
    wide = dataclasses.replace(RANGE, trusted=False, reject=Reject.SIGMA_TOO_LARGE)
    assert withheld(wide, Reject.CONTRADICTED).reject is Reject.CONTRADICTED
    assert withheld(wide, None) == wide
    assert not withheld(RANGE, Reject.CONTRADICTED).trusted


def test_one_outlier_is_an_outlier_and_is_granted_any_rotation() -> None:
    test, sigma_rad = MatchTest(), np.array([2e-5, 5e-4, 1e-4])
    covariance = np.diag(sigma_rad**2)
    verdict, doubt = test.take(Innovation(np.array([7.0, 0.0, 0.0]) * sigma_rad, covariance))
    assert verdict is MatchVerdict.OUTLIER
    assert np.sqrt(doubt[1, 1]) > 0.003
    assert test.take(Innovation(np.zeros(3), covariance))[0] is MatchVerdict.AGREE
