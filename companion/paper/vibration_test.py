"""A ground vibration test of the simulated wing: a sweep, roving accelerometers, modal peaks; and many of them."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from companion.core.wing.beam import Beam, BeamMode
from companion.core.wing.model import WingModel
from companion.paper.edge_fits import CAMERA_M, CLAMPED_DEGREE, TIP_M, WHOLE_DEGREE, clamped_factor, fit_edges
from companion.paper.modal_peaks import RATE_HZ, ModalPoints, modal_points, quadrature_peak
from companion.params.airframe import Airframe
from companion.records import Floats
from companion.sim.flight.perturb import draw_truth
from companion.sim.flight.wing import SUBSTEP_S, integrate

TESTS = 8  # repeated tests: a spread known to a quarter (choice)
STATIONS_M = (0.2, 0.4, 0.6, 0.8, TIP_M)  # chosen: five pairs of accelerometers a half, as in the measured test
GAIN_SIGMA = 0.01  # chosen: of each accelerometer: a calibrated one
_SEED = 9  # convention: any fixed number
_TEST_S = 60.0  # chosen: a sweep slow beside the modes' ringing
_SWEEP_HZ = (1.0, 40.0)  # chosen: both bending modes and their sides
_FORCE_MPS2 = 0.5  # convention: the wing is linear; only the sensors' noise compares with it


def true_shapes(airframe: Airframe) -> tuple[BeamMode, BeamMode]:
    """Shapes of a held wing half with the airframe's first slope factor: a cantilever of so heavy a tip."""
    span = airframe.wing.semispan_m
    wanted = airframe.wing.symmetric.slope_factor_radpm.value

    def modes(mass_ratio: float) -> tuple[BeamMode, ...]:
        return Beam(1.0, 1.0, 1.0, 1.0, span, mass_ratio * span).modes(2)

    ratio = float(brentq(lambda mu: modes(mu)[0].slope_at_tip_radpm - wanted, 0.0, 10.0))
    first, second = modes(ratio)
    return first, second


def simulated_points(airframe: Airframe, seed: int = _SEED, gain_sigma: float = GAIN_SIGMA) -> ModalPoints:
    """Sweep the drawn wing and rove two accelerometers along each half, one run per pair."""
    rng = np.random.default_rng(seed)
    actual = draw_truth(airframe, rng).actual
    first, second = true_shapes(airframe)
    model = WingModel(actual.wing)
    count = round(_TEST_S / SUBSTEP_S)
    force = _sweep(count)
    load = np.zeros((count, model.count))
    columns = [model.structure.slots.index(slot) for slot in (0, 2)]
    load[:, columns] = force[:, None] * np.array([1.0, second.shape(np.array([0.5]))[0]])
    _, qdot = integrate(model, load, np.ones(count))
    every = round(1.0 / (SUBSTEP_S * RATE_HZ))
    # mean acceleration over each output sample: an anti-alias filter that is exact
    accel = np.diff(qdot[::every, columns], axis=0) * RATE_HZ
    felt = force.reshape(-1, every).mean(axis=1)
    noise = actual.left.accel_noise_mps2_rthz * np.sqrt(RATE_HZ / 2)
    runs = []
    for station in [side * y for side in (-1.0, 1.0) for y in STATIONS_M]:
        at = np.array([abs(station)])
        motion = accel @ np.array([first.shape(at)[0], second.shape(at)[0]])
        gains = 1.0 + gain_sigma * rng.standard_normal(2)
        runs.append((station, motion[:, None] * gains + noise * rng.standard_normal((len(motion), 2))))
    hertz = actual.wing.symmetric.frequency_hz.value
    peaks = [quadrature_peak(felt, readings, (hertz - 1.0, hertz + 1.0)) for _, readings in runs]
    stations = np.array([[station, station] for station, _ in runs])
    return modal_points(stations, np.array([peak for _, peak in peaks]), np.array([f for f, _ in peaks]))


def _sweep(count: int) -> Floats:
    t_s = np.arange(count) * np.float64(SUBSTEP_S)
    low, high = _SWEEP_HZ
    return np.asarray(_FORCE_MPS2 * np.sin(2 * np.pi * (low * t_s + 0.5 * (high - low) / _TEST_S * t_s**2)))


def survey(airframe: Airframe) -> dict[str, tuple[float, float]]:
    """Mean and spread of the slope factor's deviation over several simulated tests, by way of fitting."""
    truth = float(true_shapes(airframe)[0].slope(np.array([CAMERA_M]))[0])
    tip = airframe.wing.semispan_m
    rows = []
    for seed in range(TESTS):
        points = simulated_points(airframe, seed)
        whole_span = [fit_edges(points, degree).slope_factor_radpm(CAMERA_M, tip) for degree in (4, WHOLE_DEGREE)]
        rows.append([*whole_span, clamped_factor(points)])
    gaps = np.array(rows) / truth - 1.0
    names = (
        "whole span, degree 4",
        f"whole span, degree {WHOLE_DEGREE}",
        f"each half clamped, degree {CLAMPED_DEGREE}",
    )
    return {
        name: (float(mean), float(spread))
        for name, mean, spread in zip(names, gaps.mean(axis=0), gaps.std(axis=0, ddof=1), strict=True)
    }
