"""The smoothed wing does not depend on where a recording ends, beyond the time in which its samples fade."""

from __future__ import annotations

import numpy as np

from companion.diagnosis.data.grid import FADES_S
from companion.diagnosis.data.observations import Observations
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.spectral_matrices import apply
from companion.evaluation.flight_models import belief_for, top_of
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.records import Complexes, Floats, Side

RATE_HZ, LENGTH_S, CUT_S, FLIGHTS = 96.0, 60.0, 40.0, 6
FIRST = round(0.5 * (LENGTH_S - CUT_S) * RATE_HZ)
NEAR_S = 4.0


def model_of(airframe: Airframe, up_mps2: Floats) -> FlightModel:
    """Level flight without a root sensor."""
    level, sides = np.ones(len(up_mps2)), (Side.LEFT, Side.RIGHT)
    observations = Observations(RATE_HZ, sides, up_mps2 - up_mps2.mean(0), np.zeros(2), False, level, {}, None)
    return FlightModel(belief_for(airframe, [[observations]]), observations, top_of(airframe))


def drawn(model: FlightModel, rng: np.random.Generator) -> Floats:
    """Accelerations (m, 2) of the believed wing in its gust."""
    linear = model.expect(np.zeros(len(model.belief.nuisances))).motion.linear

    def white(density: Complexes | Floats) -> Complexes:
        sizes = np.sqrt(0.5 * density.real * model.transforms.count / model.transforms.dt_s)
        return np.asarray(sizes * (rng.standard_normal(density.shape) + 1j * rng.standard_normal(density.shape)))

    assert linear.load.ndim == 2, "the test wants modes that share no gust"
    noise = white(np.stack([linear.noise[k, k] for k in range(2)]))
    shown = apply(linear.sensing, apply(linear.receptance, white(linear.load))) + noise
    return model.transforms.in_time(shown).T


def smoothed_m(model: FlightModel) -> Floats:
    """Symmetric deflection, (m,)."""
    return np.asarray(model.expect(np.zeros(len(model.belief.nuisances))).q_m[0])


def test_the_smoothed_wing_does_not_depend_on_where_a_recording_ends() -> None:
    airframe, rng = load_airframe("nadir-2m"), np.random.default_rng(3)
    still = model_of(airframe, np.zeros((round(LENGTH_S * RATE_HZ), 2)))
    cut = slice(FIRST, FIRST + round(CUT_S * RATE_HZ))
    t_s = np.arange(cut.stop - cut.start) / RATE_HZ
    outside = np.minimum(t_s, CUT_S - t_s)
    near = (outside > FADES_S) & (outside < FADES_S + NEAR_S)
    squares = []
    for _ in range(FLIGHTS):
        up_mps2 = drawn(still, rng)
        change_m = smoothed_m(model_of(airframe, up_mps2[cut])) - smoothed_m(model_of(airframe, up_mps2))[cut]
        squares.append(np.mean(change_m[near] ** 2))
    change_rad = 2.0 * airframe.wing.symmetric.slope_factor_radpm.value * np.sqrt(np.mean(squares))
    assert change_rad < 0.6 * still.belief.match_sigma_rad()
