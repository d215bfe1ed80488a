"""The filter's own constants in level flight: slope factors are where they say they are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.tracking.tracker import WingTracker
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import Station
from tools.bench.accuracy_belief import Perturbation, believed_airframe
from tools.bench.accuracy_cases import Cell, cells
from tools.reference.imu import EPOCH_HOST_NS, chunks, samples
from tools.reference.rigid import LEVEL
from tools.reference.spec import DRYDEN, ModeSpec, SensorSpec, TruthSpec
from tools.reference.truth import TruthRun, simulate


def ten_hertz() -> Cell:
    """A 10 Hz wing in level flight whose sensors' errors the airframe believes to be half a percent."""
    return next(cell for cell in cells("priors", 7, 30.0) if cell.spec.symmetric.frequency_hz == 10.0)


def without_errors(spec: TruthSpec) -> TruthSpec:
    """The same flight with ideal scales, mountings and clocks."""

    def ideal(sensor: SensorSpec) -> SensorSpec:
        return dataclasses.replace(
            sensor, accel_scale_sigma=0.0, gyro_scale_sigma=0.0, misalignment_sigma_rad=0.0, time_offset_sigma_s=0.0
        )

    sensors = {place: ideal(getattr(spec, place)) for place in ("root", "left", "right")}
    return dataclasses.replace(spec, trim_sigma_m=0.0, bend_per_g_sigma_m=0.0, **sensors)


def driven(run: TruthRun, airframe: Airframe) -> WingTracker:
    """The tracker after a whole run, of which it takes 50 ms at a time."""
    tracker = WingTracker(airframe, Settings())
    for end_s, batches in chunks(run, samples(run), 0, np.arange(0.1, run.spec.duration_s, 0.05).tolist()):
        for batch in batches:
            tracker.add(batch)
        tracker.process_until(EPOCH_HOST_NS + round(end_s * 1e9))
    return tracker


@pytest.mark.slow
@pytest.mark.parametrize("slope_sigma_ratio", [0.0, 0.01])
def test_slope_factors_do_not_slide_with_the_scales(slope_sigma_ratio: float) -> None:
    """Scale errors of root noise regressed on itself once moved both slope factors by 1.8 %, ten times their sigma."""
    cell = ten_hertz()
    truth = dataclasses.replace(without_errors(cell.spec), slope_sigma_ratio=slope_sigma_ratio)
    run = simulate(truth, (cell.seeds[0],))
    tracker = driven(run, believed_airframe(cell.spec, cell.seeds[0], cell.perturbation))
    layout, kalman = tracker._layout, tracker._kalman
    for mode, name in enumerate(("slope.symmetric", "slope.antisymmetric")):
        at = layout.bias_parameters.index(name)
        error = kalman.bias_parameters[at] - run.errors.slope_ratio[0][mode] * cell.spec.modes[mode].slope_radpm
        sigma = np.sqrt(kalman.bias_parameter_covariance[at, at])
        assert abs(error) < 3.0 * sigma
        assert sigma < 0.0139, "no more than the prior"


@pytest.mark.slow
def test_a_wing_that_stands_still_teaches_no_scale() -> None:
    """No gust for half a minute: by the noise that the filter follows scales and slope factors came out small."""
    cell = next(cell for cell in cells("priors", 7, 30.0) if cell.spec.symmetric.frequency_hz == 5.0)
    modes = {at: dataclasses.replace(getattr(cell.spec, at), rms_m=1e-9) for at in ("symmetric", "antisymmetric")}
    truth = dataclasses.replace(without_errors(cell.spec), motion=LEVEL, slope_sigma_ratio=0.0, **modes)
    run = simulate(truth, (cell.seeds[0],))
    tracker = driven(run, believed_airframe(cell.spec, cell.seeds[0], cell.perturbation))
    learned = tracker.bias_parameters()
    for name in ("slope.symmetric", "slope.antisymmetric", "left.kp", "right.kp", "left.kz", "right.kz"):
        error, sigma = learned[name]
        assert abs(error) < 2.0 * sigma, name


@pytest.mark.slow
@pytest.mark.parametrize("seed", [206, 203])
def test_noise_of_the_roll_acceleration_is_no_common_bias(seed: int) -> None:
    """Level flight, 41 mm of trim: regressed on force and tilt together, the bias came out 5 to 6 sigma off."""
    first = ModeSpec(3.0, 0.02, 0.008)
    second = dataclasses.replace(first, frequency_hz=3.84)
    belief = TruthSpec(first, second, DRYDEN, 0.0414, 0.0414, LEVEL)
    places = ("root", "left", "right")
    unbiased = {at: dataclasses.replace(getattr(belief, at), accel_bias_sigma_mps2=0.0) for at in places}
    truth = dataclasses.replace(belief, **unbiased)
    run = simulate(truth, (seed,))
    tracker = driven(run, believed_airframe(belief, seed, Perturbation()))
    bias_mps2, sigma_mps2 = tracker.bias_parameters()["bz"]
    assert abs(bias_mps2) < 3.0 * sigma_mps2


@pytest.mark.slow
def test_stamp_offsets_are_where_they_are_said_to_be() -> None:
    """Estimated from a Taylor series, both were off by 12 to 16 sigma, and by 75 with a cleaner derivative."""
    cell = ten_hertz()
    run = simulate(cell.spec, (cell.seeds[0],))
    tracker = driven(run, believed_airframe(cell.spec, cell.seeds[0], cell.perturbation))
    layout, kalman = tracker._layout, tracker._kalman
    for place in ("left", "right"):
        at = layout.bias_parameters.index(f"{place}.tau")
        error_s = kalman.bias_parameters[at] + run.errors.time_offset_s[0, Station[place.upper()]]  # shown: later by it
        assert abs(error_s) < 3.5 * np.sqrt(kalman.bias_parameter_covariance[at, at])


@pytest.mark.slow
def test_a_wing_that_does_not_roll_is_no_lower_than_it_is() -> None:
    """Its trim of 41 mm came out 15 mm too low: estimated roll accelerations go with the error of their own force."""
    cell = next(cell for cell in cells("priors", 7, 11.0) if cell.spec.symmetric.frequency_hz == 3.0)
    run = simulate(without_errors(cell.spec), (cell.seeds[0],))
    tracker = WingTracker(believed_airframe(cell.spec, cell.seeds[0], cell.perturbation), Settings())
    errors_m, sigmas_m = [], []
    for end_s, batches in chunks(run, samples(run), 0, np.arange(0.1, cell.spec.duration_s, 0.05).tolist()):
        for batch in batches:
            tracker.add(batch)
        state = tracker.advance(EPOCH_HOST_NS + round(end_s * 1e9))
        if state is not None and end_s > 8.0:
            at_s = np.array([(state.t_host_ns - EPOCH_HOST_NS) * 1e-9])
            errors_m.append(state.q_m[0] - run.total_at(at_s)[0, 0, 0])
            sigmas_m.append(state.q_sigma_m[0])
    assert len(errors_m) > 50
    assert abs(np.mean(errors_m)) < 3.0 * np.mean(sigmas_m)
