"""Error of the slope factors by a false modal frequency: closed form against a fit of responses, and flights."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.tracking.parameters import FIRST_PARAMETERS, FREQUENCY, prior_parameters
from companion.core.tracking.slope_error import slope_factor_variance
from companion.core.tracking.states import make_layout
from companion.params.files import load_airframe
from companion.records import Floats
from companion.sim.flight.flight import build_flight
from sitl_tests.unit.test_tracking_struck import Following

FALSE = 0.003  # relative error of a frequency


def _answer(frequency_hz: Floats, natural_hz: float, damping: float) -> Floats:
    """Acceleration per load, complex."""
    square = frequency_hz**2
    answer: Floats = -square / (natural_hz**2 - square + 2j * damping * natural_hz * frequency_hz)
    return answer


@pytest.mark.parametrize("load_ratio", [0.3, 1.0])
@pytest.mark.parametrize("rank", [0, 1])
def test_a_false_frequency_moves_a_slope_factor_by_so_much(rank: int, load_ratio: float) -> None:
    """Coherent loads: the factor that explains a gyro best beside the measured acceleration, with a false frequency."""
    layout = make_layout(load_airframe("nadir-2m"))
    family = layout.families[0]
    slopes = [mode.slope_factor_radpm.value for mode in family.modes]
    gust = load_airframe("nadir-2m").wing.gust
    prior, still = (prior_parameters(each, gust) for each in layout.families)
    white = prior.white_loads
    loads = [1.0, load_ratio * white[0] / white[1]]
    modes = tuple(
        dataclasses.replace(mode, load=mode.load * load) for mode, load in zip(prior.modes, loads, strict=True)
    )
    log_sigma = np.zeros_like(prior.log_sigma)
    log_sigma[(FREQUENCY, FIRST_PARAMETERS + FREQUENCY)[rank]] = FALSE
    fitted = dataclasses.replace(prior, modes=modes, log_sigma=log_sigma)
    still = dataclasses.replace(still, log_sigma=np.zeros_like(still.log_sigma))

    natural_hz, damping = [mode.frequency_hz for mode in modes], [mode.damping for mode in modes]
    width = 6.0 * damping[rank]
    at_hz = natural_hz[rank] * np.linspace(1.0 - width, 1.0 + width, 20001)
    weights = np.sqrt([1.0, load_ratio])
    true = [weights[k] * _answer(at_hz, natural_hz[k], damping[k]) for k in (0, 1)]
    taken = [weights[k] * _answer(at_hz, natural_hz[k] * (1.0 + FALSE * (k == rank)), damping[k]) for k in (0, 1)]
    load = sum(true) / sum(taken)
    others = slopes[1 - rank] * taken[1 - rank] * load
    turned, gyro = taken[rank] * load, slopes[0] * true[0] + slopes[1] * true[1]
    best = float(np.vdot(turned, gyro - others).real / np.vdot(turned, turned).real)

    sigma = np.sqrt(slope_factor_variance(layout, (fitted, still)))
    column = layout.column(f"slope.{family.names[rank]}")
    assert column is not None
    assert sigma[column - 1] == pytest.approx(abs(best - slopes[rank]), rel=0.05)
    assert np.count_nonzero(sigma) == 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", [22, 35])
def test_a_slope_factor_is_no_surer_than_its_frequency(seed: int) -> None:
    """Fitted frequencies that are half a per cent off took the second factor 7 sigma off."""
    flight = build_flight(load_airframe("nadir-2m"), seed, 11.0)
    following = Following(flight)
    following.fly(10.5)
    error, sigma = following.state.tracker.bias_parameters()["slope.second_symmetric"]
    believed, true = (each.wing.second_symmetric for each in (flight.airframe, flight.real.actual))
    error -= true.slope_factor_radpm.value - believed.slope_factor_radpm.value
    assert abs(error) < 3.5 * sigma
    assert sigma < believed.slope_factor_radpm.sigma
