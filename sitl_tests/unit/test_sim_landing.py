"""The small autopilot: how ranges correct the barometer, the slope, and landings with the true range."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.params.files import load_airframe
from companion.sim.landing.approach import Approach, LandingParameters
from companion.sim.landing.autolander import LandingStage
from companion.sim.landing.glide_slope import GlideSlope
from companion.sim.landing.height_correction import HeightCorrection
from companion.sim.landing.landing_flight import LandingFlight, TrueRange, fly_landing

AIRFRAME = load_airframe("nadir-2m")


def descended(correction: HeightCorrection, from_m: float, to_m: float, barometer_m: float = 0.0) -> float:
    """Feed a descent at 50 Hz and 2 m/s whose barometer reads too high; the time at its end."""
    t_s = 0.0
    for height_m in np.arange(from_m, to_m, -0.04).tolist():
        correction.update(t_s, height_m, 1.0, height_m + barometer_m)
        t_s += 0.02
    return t_s


def test_ranges_count_only_after_ten_that_differ_from_the_first() -> None:
    correction = HeightCorrection(200.0)
    at_s = descended(correction, 60.0, 50.5, 3.0)
    assert not correction.in_range
    assert correction.correction_m(at_s) == 0.0
    descended(correction, 50.4, 49.0, 3.0)
    assert correction.in_range


def test_the_correction_is_the_barometers_error_and_holds_for_five_seconds() -> None:
    correction = HeightCorrection(200.0)
    at_s = descended(correction, 60.0, 40.0, 3.0)
    assert correction.correction_m(at_s) == pytest.approx(3.0, abs=1e-9)
    correction.update(at_s + 0.02, None, 1.0, 43.0)
    assert not correction.in_range
    assert correction.correction_m(at_s + 4.9) == pytest.approx(3.0, abs=1e-9)
    assert correction.correction_m(at_s + 5.1) == 0.0


def test_tilt_shortens_the_height_that_a_range_means() -> None:
    """A range of 40 m along an axis tilted by 60 degrees is a height of 20 m."""
    correction = HeightCorrection(200.0)
    for number in range(100):
        correction.update(0.02 * number, 60.0 - 0.2 * number, 0.5, 50.0)
    assert correction.correction_m(2.0) == pytest.approx(50.0 - 0.5 * 40.2, abs=0.6)


def test_a_correction_that_wanders_by_thirty_metres_is_dropped() -> None:
    correction = HeightCorrection(200.0)
    at_s = descended(correction, 60.0, 40.0)
    for number in range(50):
        correction.update(at_s + 0.02 * number, 100.0, 1.0, 40.0)
    assert correction.dropped >= 1
    assert abs(correction.correction_m(at_s + 1.0)) <= 60.0


def test_the_slope_ends_at_the_flares_height_before_the_point() -> None:
    approach, limits = Approach(), LandingParameters()
    slope = GlideSlope(approach, limits)
    heights_m = [slope.height_m(north_m) for north_m in np.linspace(-approach.slope_m, -60.0, 50)]
    assert heights_m[0] == pytest.approx(60.0)
    assert np.all(np.diff(heights_m) < 0.0)
    assert np.ptp(np.diff(heights_m)) < 1e-9
    assert slope.height_m(0.0) < limits.flare_alt_m


def test_a_barometer_too_low_by_much_makes_the_slope_too_steep() -> None:
    """300 m before the point at 31 m a slope of 6 degrees is flown on; 60 m up there is none to be flown."""
    slope = GlideSlope(Approach(), LandingParameters())
    assert not slope.adjusted(0.5, -300.0, 31.0)
    assert not slope.adjusted(3.0, -300.0, 29.0)
    assert slope.adjusted(-29.0, -300.0, 60.0)


@pytest.mark.long
@pytest.mark.parametrize(("gusts", "sink_mps"), [pytest.param(False, 0.9, marks=pytest.mark.long), (True, 2.2)])
def test_with_the_true_range_it_lands_by_the_point(gusts: bool, sink_mps: float) -> None:
    """The barometer is metres off; wheels meet the ground softly, wings level, near the runway's line."""
    for seed in (1, 4):
        flight = LandingFlight(AIRFRAME, seed, gusts=gusts, approach=Approach(level_s=2.0))
        fly_landing(flight, TrueRange(flight))
        assert flight.pilot.stage is LandingStage.ROLL_OUT
        assert flight.flare is not None
        assert flight.touch is not None
        assert flight.flare.height_m == pytest.approx(flight.flare.intended_m, rel=0.25)
        assert 0.0 < flight.touch.sink_mps < sink_mps
        assert abs(flight.touch.north_m) < 60.0
        assert abs(flight.touch.east_m) < 6.0
        assert abs(flight.present.euler_rad[0]) < 0.2


@pytest.mark.slow
def test_without_any_range_it_goes_around_below_the_gate() -> None:
    class Silent:
        def reading_m(self, now_ns: int) -> float | None:
            del now_ns

    flight = LandingFlight(AIRFRAME, 1, gusts=False, approach=Approach(level_s=2.0))
    fly_landing(flight, Silent())
    assert flight.pilot.stage is LandingStage.GO_AROUND
    assert flight.touch is None
    assert -flight.present.velocity_ned_mps[2] > 1.0, "it climbs"


@pytest.mark.slow
def test_the_flown_truth_is_one_motion() -> None:
    """Between knots position is the integral of velocity, attitude that of the rates, specific force its derivative."""
    flight = LandingFlight(AIRFRAME, 2, gusts=True, approach=Approach(height_m=30.0, level_s=1.0))
    fly_landing(flight, TrueRange(flight))
    series = flight.truth.series(np.arange(0, flight.truth.end_ns, 1_000_000))
    travelled = np.cumsum(0.0005 * (series.velocity_ned_mps[1:] + series.velocity_ned_mps[:-1]), axis=0)
    assert np.abs(series.position_ned_m[1:] - series.position_ned_m[0] - travelled).max() < 5e-3
    ned_from_body = np.swapaxes(series.body_from_ned, 1, 2)
    change = np.einsum("nij,nj->ni", ned_from_body, series.specific_force_mps2) + np.array([0.0, 0.0, 9.80665])
    gained = np.cumsum(0.0005 * (change[1:] + change[:-1]), axis=0)
    assert np.abs(series.velocity_ned_mps[1:] - series.velocity_ned_mps[0] - gained).max() < 5e-3
    roll, pitch, _ = series.euler_rad.T
    p, q, r = series.body_rate_radps.T
    pitch_rate = q * np.cos(roll) - r * np.sin(roll)
    turned = np.cumsum(0.0005 * (pitch_rate[1:] + pitch_rate[:-1]))
    assert np.abs(pitch[1:] - pitch[0] - turned).max() < 1e-4
    assert math.isfinite(float(p.sum()))
