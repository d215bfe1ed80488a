"""A drifting frequency: evening it out, and how its rate is found."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.mode.drift import at_end, evened, when_evened
from companion.core.mode.parameters import FREQUENCY, FREQUENCY_2, PARAMETERS

STEP_S, LENGTH_S = 0.004, 20.0
TIME_S = (np.arange(round(LENGTH_S / STEP_S)) + 0.5) * STEP_S


@pytest.mark.parametrize("rate_per_s", [0.01, -0.01, 0.03, -0.003])
@pytest.mark.parametrize("frequency_hz", [3.0, 40.0])
def test_a_growing_frequency_becomes_a_steady_one_and_the_parameters_go_along(
    rate_per_s: float, frequency_hz: float
) -> None:
    phase = 2.0 * np.pi * frequency_hz * np.expm1(rate_per_s * TIME_S) / rate_per_s
    logs = np.zeros(PARAMETERS)
    logs[FREQUENCY] = np.log(frequency_hz) + rate_per_s * LENGTH_S
    steady_hz = np.exp(when_evened(logs, rate_per_s, LENGTH_S)[FREQUENCY])
    found = evened(np.sin(phase), rate_per_s, STEP_S)
    inside = slice(20, -20)  # the ends have no neighbours; the taper takes them away
    np.testing.assert_allclose(found[inside], np.sin(2.0 * np.pi * steady_hz * TIME_S)[inside], atol=0.004)


@pytest.mark.parametrize("rate_per_s", [0.0, 1e-9, 0.02, -0.02])
def test_there_and_back_is_where_it_began_and_only_frequencies_move(rate_per_s: float) -> None:
    logs = np.random.default_rng(3).normal(size=2 * PARAMETERS)
    moved = at_end(logs, rate_per_s, LENGTH_S)
    np.testing.assert_allclose(when_evened(moved, rate_per_s, LENGTH_S), logs, atol=1e-12)
    frequencies = [first + k for first in (0, PARAMETERS) for k in (FREQUENCY, FREQUENCY_2)]
    # a line's end lies half its length beyond its middle
    np.testing.assert_allclose((moved - logs)[frequencies], 0.5 * rate_per_s * LENGTH_S, atol=(rate_per_s * 20) ** 2)
    np.testing.assert_array_equal(np.delete(moved, frequencies), np.delete(logs, frequencies))


def test_what_does_not_drift_stays_as_it_is() -> None:
    samples = np.random.default_rng(4).normal(size=1000)
    assert evened(samples, 0.0, STEP_S) is samples
