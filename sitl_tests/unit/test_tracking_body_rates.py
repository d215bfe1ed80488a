"""The body rate at an exposure: as the aircraft turns, not as propulsion shakes the root."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.tracking.body_rates import BodyRates
from companion.core.tracking.rigid_body import _empty
from companion.records import Floats

H, COUNT = 0.004, 250


def _rates(added: Floats, covered: slice = slice(None)) -> BodyRates:
    """Epochs of a second that end with this yaw rate, (n,) rad/s."""
    rates = BodyRates(COUNT, H)
    body_rate_radps = np.zeros((COUNT, 3))
    body_rate_radps[:, 2] = added
    root_covered = np.zeros(COUNT, np.bool_)
    root_covered[covered] = True
    rates.extend(_empty(COUNT, 0)._replace(body_rate_radps=body_rate_radps, root_covered=root_covered))
    return rates


def _sine(frequency_hz: float, t_s: Floats | float) -> Floats:
    return np.asarray(np.sin(2.0 * np.pi * frequency_hz * np.asarray(t_s) + 0.3))


def _at(rates: BodyRates, epoch: int, fraction: float) -> float:
    body_rate_radps = rates.at(epoch, fraction)
    assert body_rate_radps is not None
    return float(body_rate_radps[2])


@pytest.mark.parametrize("fraction", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("hz", [0.5, 2.0, 8.0])
def test_turns_of_the_aircraft_pass_and_a_shaft_does_not(hz: float, fraction: float) -> None:
    t_s = H * np.arange(1, COUNT + 1)
    rates = _rates(_sine(hz, t_s) + 0.1 * _sine(47.0, t_s))
    by_chord = (2.0 * np.pi * hz * H) ** 2 / 8.0
    most = by_chord + (0.013 if hz > 5.0 else 1e-3)  # of which the kernel takes 1.2 % at 8 Hz
    for epoch in range(-200, -40):
        at_s = H * (COUNT + epoch + fraction)
        assert _at(rates, epoch, fraction) == pytest.approx(float(_sine(hz, at_s)), abs=most)


def test_beside_the_newest_epoch_the_kernel_is_as_short_as_it_must_be() -> None:
    t_s = H * np.arange(1, COUNT + 1)
    rates = _rates(3.0 * t_s)
    for epoch in (-1, -2, -4, -10, -COUNT + 1):
        assert _at(rates, epoch, 0.3) == pytest.approx(3.0 * H * (COUNT + epoch + 0.3))
    assert _at(rates, -1, 1.0) == float(rates.newest_radps[2])


def test_a_gap_of_the_root_has_no_rate_and_is_in_none() -> None:
    added = np.where(np.arange(COUNT) < 150, 1.0, 9.0)
    rates = _rates(added, slice(0, 150))
    assert rates.at(-COUNT + 155, 0.5) is None
    assert _at(rates, -COUNT + 148, 0.5) == pytest.approx(1.0)
