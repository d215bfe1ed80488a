"""The worlds' campaign: its statistics by closed forms, its peers on exact data, its rows."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from companion.core.stereo.geometry import Rig
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.records import Axis, ClockName, ImuBatch, MatchSet, Station
from companion.sim.flight.offline import HOST_EPOCH_NS
from companion.units import GRAVITY_MPS2
from tools.bench.world import FLIGHTS, Pooled, missed, pooled, show, summary
from tools.bench.world_constants import constants_table
from tools.bench.world_flight import fly
from tools.bench.world_peers import pair_alone, tilt_filter, tips_on_grid
from tools.bench.world_rows import ACCIDENTS, ON_GROUND, CampaignRow, rows
from tools.trial_results import wilson

COLUMNS = ["pair", "t_s", "true_toe", "toe", "toe_sigma", "true_m", "range_m", "sigma_m", "trusted", "axis_m"]
PEER_COLUMNS = ["pair alone", "tilt filter", "band-pass"]


def judged_flight(judged: list[list[float]], **changes: Any) -> dict[str, Any]:
    flight = {"columns": COLUMNS + PEER_COLUMNS, "judged": [[*shot, 0.0, 0.0, 0.0] for shot in judged], "withheld": {}}
    return (
        flight
        | {"seed": 1, "refused": {}, "lift_off_s": 0.0, "touch_down_s": 32.0, "until_s": 31.6, "shot_s": 1.0}
        | {"constants": {}}
        | changes
    )


def shot(
    t_s: float, range_m: float = 60.0, toe: float = 0.0, trusted: float = 1.0, axis_m: float = math.nan
) -> list[float]:
    return [0.0, t_s, 0.0, toe, 1e-4, 60.0, range_m, 0.5, trusted, axis_m]


def test_wilsons_interval() -> None:
    assert wilson(0, 0) == (0.0, 1.0)
    # Wilson (1927) as tabulated by Newcombe (1998): 81 of 263 is 0.2553 to 0.3662
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)


def test_rows_of_other_conditions_fly_other_wings_and_a_reference_those_of_its_world() -> None:
    first = {row: row.first_number for row in rows()}
    for row, number in first.items():
        for other, beside in first.items():
            alike = (row.world, row.accident) == (other.world, other.accident)
            assert number == beside if alike else abs(number - beside) >= FLIGHTS, (row, other)


def test_the_nees_has_the_standard_error_of_its_flights_and_not_of_its_shots() -> None:
    """Flights of equal length: the standard error is that of the mean of the flights' own means."""
    row = CampaignRow("ideal", "nadir-2m", "6-axis")
    toes = (0.5e-4, 1e-4, 3e-4)
    flights = [judged_flight([shot(16.0 + k, toe=toe) for k in range(10)]) for toe in toes]
    squares = np.array(toes) ** 2 / 1e-8
    figures = summary(pooled(row, flights))
    assert figures["nees"] == pytest.approx(squares.mean())
    assert figures["nees_sigma"] == pytest.approx(squares.std(ddof=1) / math.sqrt(3))
    assert math.isnan(summary(pooled(row, flights[:1]))["nees_sigma"])


def test_a_row_counts_what_was_published_and_what_should_have_been() -> None:
    row = CampaignRow("fair", "nadir-2m", "6-axis")
    judged = [shot(14.0), *(shot(15.0 + k) for k in range(10)), shot(25.0, trusted=0.0), shot(31.0, 70.0, 4e-4)]
    group = pooled(row, [judged_flight(judged)])
    figures = summary(group)
    assert figures["shots"] == 16, "one a second from 15 to 31 s, answered or not"
    assert figures["trusted"] == pytest.approx(11 / 16)
    assert figures["published"] == 12
    assert figures["wrong"] == 1, "10 m off is 20 sigma and 17 %"
    assert figures["far"] == 0
    assert figures["nees"] == pytest.approx(16.0 / 11)
    assert set(missed(group, figures)) == {"trusted", "NEES", "3 sigma", "wrong"}


def test_shots_that_never_came_and_flights_that_failed_are_shots_that_were_not_trusted() -> None:
    """A pipeline that answers nothing after 20 s trusted 5 of 16; of three flights one ended with an error."""
    row = CampaignRow("fair", "nadir-2m", "6-axis")
    silent = judged_flight([shot(15.0 + k) for k in range(5)])
    assert summary(pooled(row, [silent]))["trusted"] == pytest.approx(5 / 16)
    good = judged_flight([shot(15.0 + k) for k in range(16)])
    group = pooled(row, [good, good], failed=1)
    assert summary(group)["trusted"] == pytest.approx(32 / 48)
    assert {"failed", "trusted"} <= set(missed(group, summary(group)))


def test_the_share_trusted_has_the_interval_of_its_flights_and_not_of_its_shots() -> None:
    """Half of 40 flights trust all, the others nothing: 40 draws of a coin, however many shots each flight has."""
    row = CampaignRow("fair", "nadir-2m", "6-axis")
    flights = [judged_flight([shot(15.0 + k, trusted=float(n % 2)) for k in range(16)]) for n in range(40)]
    figures = summary(pooled(row, flights))
    assert (figures["low"], figures["high"]) == pytest.approx(wilson(20, 40), abs=0.01)


def test_a_range_of_the_right_features_can_miss_what_stands_on_the_axis() -> None:
    judged = [shot(16.0, axis_m=60.4), shot(17.0, axis_m=50.0), shot(18.0, axis_m=50.0, trusted=0.0), shot(19.0)]
    group = pooled(CampaignRow("fair", "nadir-2m", "6-axis"), [judged_flight(judged)])
    assert summary(group)["axis"] == 1
    assert summary(group)["wrong"] == 0
    assert "axis" in missed(group, summary(group))


def test_nothing_is_to_be_trusted_on_the_ground() -> None:
    row = CampaignRow("fair", "nadir-2m", "6-axis")
    group = pooled(row, [judged_flight([shot(5.0), shot(16.0), shot(31.0)], lift_off_s=10.0, touch_down_s=30.0)])
    figures = summary(group)
    assert figures["on_ground"] == 2
    assert "on ground" in missed(group, figures)


def test_trust_is_asked_for_from_fifteen_seconds_in_the_air_on_and_where_there_is_texture() -> None:
    row = CampaignRow("fair", "nadir-2m", "6-axis", ON_GROUND)
    early = [shot(11.0 + k, trusted=0.0) for k in range(14)]
    late = [shot(25.5 + k) for k in range(4)]
    blank = [0.0, 29.8, 0.0, 0.0, 0.0, math.nan, 0.0, 120.0, 0.0, math.nan]
    figures = summary(pooled(row, [judged_flight([*early, *late, blank], lift_off_s=10.0, touch_down_s=30.0)]))
    assert figures["shots"] == 4
    assert figures["trusted"] == 1.0


@pytest.mark.parametrize(("trusted", "misses"), [(8, False), (7, True)])
def test_shots_whose_stamps_are_wrong_need_not_be_trusted(trusted: int, misses: bool) -> None:
    """With a fifth of the stamps late, nine tenths of the other four fifths are 0.72 of all."""
    late = next(accident for accident in ACCIDENTS if accident.late_share)
    judged = [shot(16.0 + k, trusted=float(k < trusted)) for k in range(10)]
    group = pooled(CampaignRow("ideal", "nadir-2m", "6-axis", late), [judged_flight(judged, touch_down_s=25.0)])
    assert ("trusted" in missed(group, summary(group))) is misses


def test_the_pair_alone_finds_the_yaw_of_a_turned_camera() -> None:
    airframe = load_airframe("nadir-2m")
    yaw = 0.004
    assert airframe.right_camera is not None
    turned = dataclasses.replace(airframe.right_camera, rotation_rad=(0.0, yaw, 0.0))
    real = Rig.from_airframe(dataclasses.replace(airframe, right_camera=turned))
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-20, 20, (400, 2)), np.full(400, 60.0) + rng.normal(0, 2, 400)])
    left_px = real.left.project(real.left.rest, points)
    right_px = real.right.project(real.right.rest, points)
    matches = MatchSet(
        0, 0, (ClockName.HOST, ClockName.HOST), np.zeros(2, dtype=np.int64), 0, 0,
        left_px, right_px, np.full(400, 0.1), 0,
    )  # fmt: skip
    assert pair_alone(airframe, matches) == pytest.approx(yaw, abs=2e-5)


def test_the_tilt_filter_follows_a_swinging_pair_of_tips() -> None:
    t_s = np.arange(0.0, 12.0, 1e-3)
    omega, toe = 2 * math.pi * 5.0, 0.012 * np.sin(2 * math.pi * 5.0 * t_s)
    left, right = np.zeros((len(t_s), 6)), np.zeros((len(t_s), 6))
    for tip, half in ((left, 0.5), (right, -0.5)):
        tip[:, 1], tip[:, 2] = -GRAVITY_MPS2 * half * toe, -GRAVITY_MPS2
        tip[:, 3] = half * 0.012 * omega * np.cos(omega * t_s)
    late = slice(6000, -1000)
    assert np.std((tilt_filter((left, right)) - toe)[late]) < 0.0003


def test_the_peers_see_both_tips_at_one_time_though_their_clocks_run_apart() -> None:
    """Skews of 50 ppm are 1 ms in 20 s: at 5 Hz and 25 mrad of toe that were 0.8 mrad."""
    rng, records = np.random.default_rng(4), []
    for station, epoch_s, skew in ((Station.LEFT, 70.0, 5e-5), (Station.RIGHT, 900.0, -5e-5)):
        true_s = np.arange(0.01, 20.0, 1e-3)
        values = np.zeros((len(true_s), 6))
        values[:, 3] = np.sin(2 * math.pi * 5.0 * true_s)
        stamp_ns = np.rint(1e9 * (epoch_s + (1.0 + skew) * true_s)).astype(np.int64)
        delay_s = 7e-4 + rng.exponential(1e-4, len(true_s))
        arrival_ns = np.maximum.accumulate(HOST_EPOCH_NS + np.rint(1e9 * (true_s + delay_s)).astype(np.int64))
        clock = ClockName.NODE_LEFT if station is Station.LEFT else ClockName.NODE_RIGHT
        for k in range(0, len(true_s), 5):
            cut = slice(k, k + 5)
            axes = Axis.X | Axis.Y | Axis.Z | Axis.P | Axis.Q | Axis.R
            records.append(ImuBatch(station, clock, stamp_ns[cut], values[cut], axes, int(arrival_ns[cut][-1])))
    grid_s, tips = tips_on_grid(records)
    for tip in tips:
        np.testing.assert_allclose(tip[:, 3], np.sin(2 * math.pi * 5.0 * grid_s), atol=2 * math.pi * 5.0 * 1.5e-4)


def test_every_world_airframe_and_set_of_axes_has_a_row_and_every_row_its_folder() -> None:
    everything = rows()
    assert len({row.key for row in everything}) == len(everything)
    for world in ("ideal", "fair", "rough", "tones"):
        assert len([row for row in rows(world) if not row.accident.name and not row.reference]) == 4
    for sensors in ("6-axis", "vertical"):
        assert {row.accident.circuit for row in rows("rough", "nadir-2m", sensors)} == {False, True}
    assert rows("fair", "nadir-2m", "vertical")[0].belief().left.sends == "z"


def test_a_toe_noisier_than_its_reference_allows_is_a_miss() -> None:
    row = CampaignRow("fair", "nadir-2m", "6-axis")
    reference = dataclasses.replace(row, reference=True)
    assert reference in rows("fair")

    def group(of: CampaignRow, error_rad: float) -> Pooled:
        return pooled(of, [judged_flight([shot(15.0 + 0.2 * k, toe=(-1) ** k * error_rad) for k in range(80)])])

    for over, expected in ((1.1, False), (1.2, True)):
        text, failures = show([group(row, over * 1e-4), group(reference, 1e-4)])
        assert failures == int(expected)
        assert ("reference" in text.splitlines()[1]) is expected
        assert f" {over:.2f} " in text.split("above 0.5 Hz")[1]


def test_rigid_stereo_errs_by_the_toe_itself() -> None:
    """A swing of amplitude A at 5 Hz leaves it A over the root of two, a standing bend nothing above 0.5 Hz."""
    row, amplitude = CampaignRow("fair", "nadir-2m", "6-axis"), 2e-2
    shots = [shot(16.0 + 0.07 * k) for k in range(200)]
    for each in shots:
        each[2] = each[3] = 3e-2 + amplitude * math.sin(10.0 * math.pi * each[1])
    figures = summary(pooled(row, [judged_flight(shots)]))
    assert figures["fast rigid"] == pytest.approx(1e3 * amplitude / math.sqrt(2.0), rel=0.03)
    assert figures["fast toe"] == pytest.approx(0.0, abs=1e-9)


def test_a_constant_is_to_be_within_three_sigmas_in_nearly_every_flight() -> None:
    """Both tips are one constant; 97 of 100 are too few, 98 suffice."""
    for beyond, expected in ((2, False), (3, True)):
        over = [5.0] * beyond + [-1.0] * (50 - beyond)
        flights = [("fair", {"left.kz": [0.01 + z * 0.001, 0.001, 0.01], "right.kz": [0.0, 1.0, 1.0]}) for z in over]
        lines, failures = constants_table(flights)
        assert failures == int(expected)
        mean = (5.0 * beyond - (50 - beyond) - 50) / 100
        assert lines[1].split()[:3] == ["tip.kz", "100", f"{mean:.2f}"]
        assert lines[1].endswith("missed") is expected


@pytest.mark.long
def test_a_flow_that_suddenly_contradicts_withholds_ranges_and_the_rest_is_honest() -> None:
    """A fifth of the stamps 15 ms late: matches alone leave some unnoticed, of 2.3 squared sigmas together."""
    late = next(accident for accident in ACCIDENTS if accident.late_share)
    row = CampaignRow("ideal", "nadir-2m", "6-axis", late)
    figures = summary(pooled(row, [fly(row, 0)]))
    assert 0.5 < figures["trusted"] < 0.9
    assert figures["nees"] < 1.25
    assert figures["inside_3"] > 0.99
    assert figures["wrong"] == 0


@pytest.mark.long
def test_stamps_of_a_usb_camera_leave_an_honest_toe(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stamps good to 3 ms, as stated: counted as 0.1 ms, 84 of 110 ranges were trusted, of 7 squared sigmas."""
    believed = CampaignRow.belief

    def stamped_by_the_host(row: CampaignRow) -> Airframe:
        airframe = believed(row)
        cameras = [dataclasses.replace(camera, stamp_sigma_s=3e-3) for camera in airframe.camera_pair]
        return dataclasses.replace(airframe, left_camera=cameras[0], right_camera=cameras[1])

    monkeypatch.setattr(CampaignRow, "belief", stamped_by_the_host)
    row = CampaignRow("fair", "nadir-2m", "6-axis")
    figures = summary(pooled(row, [fly(row, 700)]))
    assert figures["trusted"] > 0.9
    assert figures["nees"] < 2.0
    assert figures["inside_3"] > 0.99
    assert figures["wrong"] == 0


@pytest.mark.long
def test_a_landing_before_obstacles_publishes_no_wrong_range_ahead() -> None:
    """Boards ahead, ground below, a sink of 5 m/s between unequal exposures: six ranges were 15 to 26 % too short."""
    row = CampaignRow("ideal", "forward-2m", "6-axis", ON_GROUND)
    figures = summary(pooled(row, [fly(row, 2)]))
    assert figures["published"] > 100
    assert figures["wrong"] == 0
    assert figures["far"] == 0
    assert figures["on_ground"] == 0
    assert figures["inside_3"] > 0.99
