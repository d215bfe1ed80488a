"""Poles of a structure from its frequency responses: least squares complex frequency, stabilised over model orders.

The common-denominator model ``H_o = N_o(z) / D(z)``, ``z = exp(j omega dt)``, is linear in its coefficients once it is
multiplied by ``D``; the numerators are eliminated output by output and the poles are the roots of ``D`` (Guillaume,
Verboven, Vanlanduit 1998; Peeters et al., "The PolyMAX frequency-domain method", Shock and Vibration 11, 2004, without
its multiple references). A pole of the structure comes back at every order, one of the noise wanders.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from companion.records import Complexes, Floats

_SAME_FREQUENCY = 0.005  # relative: a pole that stays from order to order is physical (stabilisation diagram; choice)
_SAME_DAMPING = 0.15  # chosen: relative: damping scatters far more than frequency
_SAME_DAMPING_FLOOR = 0.0005  # ratio: below it the relative bound means nothing
_MIN_ORDER_FRACTION = 0.35  # of the orders that have to bring a pole back (choice)


@dataclass(frozen=True, slots=True)
class Pole:
    """Underdamped pole; ``order_fraction`` of the model orders bring it back within the stability tolerances."""

    frequency_hz: float
    damping: float
    order_fraction: float

    @property
    def value(self) -> complex:
        """The pole in rad/s: ``omega (-zeta + j sqrt(1 - zeta^2))``."""
        omega = 2.0 * np.pi * self.frequency_hz
        return complex(-self.damping * omega, omega * np.sqrt(1.0 - self.damping**2))


def stable_poles(
    frequency_hz: Floats, response: Complexes, orders: range = range(24, 61, 2), most_damping: float = 0.15
) -> list[Pole]:
    """Poles that come back over the orders, by frequency; each the median of its returns.

    Parameters
    ----------
    frequency_hz : (k,) float64
        Lines of the band in which poles are wanted.
    response : (outputs, k) complex128
        Frequency responses, or positive halves of spectra.
    orders : range
        Degrees of the denominator; two per mode, and some for what lies beside the band.
    most_damping : float
        Larger ratios are not modes of a wing.
    """
    low, high = float(frequency_hz[0]), float(frequency_hz[-1])
    poles_per_order = [_within(lscf(frequency_hz, response, order), low, high, most_damping) for order in orders]
    steady = [_returning(a, b) for a, b in itertools.pairwise(poles_per_order)]
    everything = np.concatenate([each for each in steady if len(each)] or [np.empty((0, 2))])
    poles = [_median(cluster, len(steady)) for cluster in _clusters(everything)]
    return [pole for pole in poles if pole.order_fraction >= _MIN_ORDER_FRACTION]


def lscf(frequency_hz: Floats, response: Complexes, order: int) -> Complexes:
    """All poles (rad/s) of one model order.

    Parameters
    ----------
    frequency_hz : (k,) float64
        Lines.
    response : (outputs, k) complex128
        As in :func:`stable_poles`.
    order : int
        Degree of the denominator.
    """
    # the band is mapped onto most of the half circle, where powers of z are nearly orthogonal
    low, width = float(frequency_hz[0]), float(frequency_hz[-1] - frequency_hz[0])
    step_s = 1.0 / (2.0 * (low + 1.15 * width))
    basis = np.exp(-2j * np.pi * step_s * np.outer(frequency_hz, np.arange(order + 1)))
    inverse = np.linalg.pinv(np.real(basis.conj().T @ basis))
    reduced = np.zeros((order + 1, order + 1))
    for output in response:
        moved = -output[:, np.newaxis] * basis
        cross, square = np.real(basis.conj().T @ moved), np.real(moved.conj().T @ moved)
        reduced += square - cross.T @ inverse @ cross
    # the coefficient of the highest delay is 1: then the poles of the noise come out damped negatively
    lower, *_ = np.linalg.lstsq(reduced[:order, :order], -reduced[:order, order], rcond=None)
    roots = np.roots(np.concatenate([lower, [1.0]]))
    roots = roots[np.abs(roots) > 1e-6]
    poles: Complexes = np.log(roots.astype(np.complex128)) / step_s
    return poles


def _within(poles: Complexes, low_hz: float, high_hz: float, most_damping: float) -> Floats:
    """(n, 2) frequencies and damping ratios of the underdamped poles in the band."""
    omega = np.abs(poles)
    frequency, damping = omega / (2.0 * np.pi), -poles.real / np.maximum(omega, 1e-12)
    good = (poles.imag > 0.0) & (damping > 0.0) & (damping < most_damping)
    good &= (frequency > low_hz) & (frequency < high_hz)
    return np.column_stack([frequency[good], damping[good]])


def _returning(now: Floats, then: Floats) -> Floats:
    """Those poles that the next order brings back, with little change."""
    stable = []
    for frequency, damping in now:
        near = np.abs(then[:, 0] - frequency) < _SAME_FREQUENCY * frequency
        near &= np.abs(then[:, 1] - damping) < _SAME_DAMPING * damping + _SAME_DAMPING_FLOOR
        if np.any(near):
            stable.append((frequency, damping))
    return np.array(stable).reshape(-1, 2)


def _clusters(points: Floats) -> list[Floats]:
    """Split poles, sorted by frequency, where the next one is further away than the same pole could be."""
    if not len(points):
        return []
    ordered = points[np.argsort(points[:, 0])]
    cuts = np.flatnonzero(np.diff(ordered[:, 0]) > _SAME_FREQUENCY * ordered[1:, 0]) + 1
    return np.split(ordered, cuts)


def _median(cluster: Floats, orders: int) -> Pole:
    frequency, damping = np.median(cluster, axis=0)
    return Pole(float(frequency), float(damping), min(len(cluster) / orders, 1.0))
