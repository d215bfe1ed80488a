"""Slow tilt of the tips against each other, from what their gyros and lateral accelerometers tell beside the vertical.

A vertical accelerometer shows a deflection by omega^2: below a tenth of the first mode it tells nothing, and there a
gust bends the wing by some mrad, slowly, as ranges change with the distance. With phi the turn of a tip about x,

    gyros:                A = int (p_tip - p_root) dt = phi + drift
    lateral axis:         f_y,tip cos A - f_z,tip sin A - f_y = f_z sin(phi - A)

the second tells the first one's drift, about which a wing that swings makes no error but by its length: a bent wing
draws its tip in. Both are kept below a fifth of the first mode's frequency. What biases, scales, turned axes and noise
make of either is normal and of known shape.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.diagnosis.data.rigid_motion import lateral_force, rotation_forces
from companion.diagnosis.data.tip_tilt import SLOW, TipTilt, slow_response
from companion.params.airframe import Airframe
from companion.records import Floats, Side
from companion.units import GRAVITY_MPS2

_LEAST_FORCE_MPS2 = 3.0  # near weightlessness a lateral force tells no turn (choice)
_ANY_SCALE = 0.1  # of a reading, for errors of scale that are still to be found (choice)
_ROOT_SCALE = 0.02  # of what turning adds, by the root's gyro (choice)
_AXES_RAD = 0.001  # how well an axis is known at best (choice)
_SHORTER_M = 1.0  # how far a bent wing draws its tip in, by half the square of its slope (choice)
_DRIFTS = 0.2  # of the low-pass, below which rates drift from lateral forces (choice)
_PASSES = 2  # the drift of a minute turns a swinging force, what is left of it does not (numerical)
_LOAD_POWERS = 3  # of the load factor that a law of the bend may follow: a straight line, a curve, a yield (choice)
_LEAST_LOAD_MPS2 = 0.01  # rms; smaller changes of the load are noise (choice)
_LEAST_RAD, _LEAST_SHARE = 5e-5, 0.02  # noise of an instant at least, and of the tilt's rms (choice)


@dataclass(frozen=True, slots=True)
class TipSamples:
    """Readings of tips and root on one even grid from ``t_s[0]`` on; sides in the order of :class:`Side`.

    Attributes
    ----------
    t_s : (m,)
    force_y_mps2, force_z_mps2, roll_radps : (2, m)
    root_z_mps2 : (m,)
    rigid : dict of str to ((n,), (n,))
        The root's further axes with their stamps: x, y in m/s^2, p, q, r in rad/s.
    """

    t_s: Floats
    force_y_mps2: Floats
    force_z_mps2: Floats
    roll_radps: Floats
    root_z_mps2: Floats
    rigid: dict[str, tuple[Floats, Floats]]


def tip_tilt(samples: TipSamples, airframe: Airframe, at_s: Floats) -> TipTilt:
    """Tilt of the tips at instants (k,) inside the grid."""
    rate_hz, first_hz = _rate_hz(samples), airframe.wing.symmetric.frequency_hz.value
    felt = rotation_forces(samples.rigid, samples.t_s, rate_hz, airframe, tuple(Side))
    across = lateral_force(samples.rigid, samples.t_s, rate_hz, airframe)
    rigid_y = np.zeros(len(samples.t_s)) if across is None else across
    along = {letter: np.interp(samples.t_s, *channel) for letter, channel in samples.rigid.items()}

    def slow(values: Floats) -> Floats:
        return _slow(values, rate_hz, first_hz)

    lateral, rates, shapes, turns = np.zeros(len(rigid_y)), np.zeros(len(rigid_y)), [], []
    for side, sign in zip(Side, (1.0, -1.0), strict=True):
        turn = _integral(samples.roll_radps[side] - along["p"], rate_hz)
        # its slow part by the root, which no error of a tip's own vertical axis moves
        heavy = slow(samples.root_z_mps2 + felt[side, 2])
        force_z = samples.force_z_mps2[side] - slow(samples.force_z_mps2[side]) + heavy
        angle = turn
        for _ in range(_PASSES):
            left = samples.force_y_mps2[side] * np.cos(angle) - force_z * np.sin(angle) - rigid_y - felt[side, 1]
            angle = angle + slow(left) / _heavy_enough(heavy)
        lateral, rates = lateral + sign * slow(angle), rates + sign * slow(turn)
        shapes += [
            _ANY_SCALE * slow((force_z - heavy) * np.sin(angle)) / _heavy_enough(heavy),
            _ANY_SCALE * (slow(angle) - angle.mean()),
            _SHORTER_M * slow(_twice_derived(0.5 * angle**2, rate_hz)) / _heavy_enough(heavy),
        ]
        sensor = (airframe.left, airframe.right)[side]
        turns += [max(sensor.gyro_scale_sigma, _AXES_RAD) * (slow(angle) - angle.mean())]
    weight = slow(samples.root_z_mps2)
    axes_rad = _of_either(airframe, "misalignment_sigma_rad")
    shapes += [_ROOT_SCALE * slow(felt[0, 1] - felt[1, 1]) / _heavy_enough(weight)]
    shapes += [axes_rad * slow(along["x"]) / _heavy_enough(weight)] if "x" in along else []
    for letter, sigma in (("p", _of_either(airframe, "gyro_scale_sigma")), ("q", axes_rad), ("r", axes_rad)):
        turns += [sigma * slow(_integral(along[letter], rate_hz))] if letter in along else []
    apart = lateral - rates

    def at_exposures(values: Floats) -> Floats:
        return np.asarray(np.interp(at_s, samples.t_s, values))

    return TipTilt(
        at_s,
        at_exposures(lateral),
        at_exposures(rates),
        np.stack([at_exposures(shape) for shape in shapes]),
        np.stack([at_exposures(shape) for shape in turns]),
        GRAVITY_MPS2 / np.abs(at_exposures(_heavy_enough(weight))),
        np.abs(at_exposures(weight)) > _LEAST_FORCE_MPS2,
        (airframe.left, airframe.right),
        SLOW * first_hz,
        _load_shapes(at_exposures(weight)),
        float(np.sqrt(np.mean((apart - _slow(apart, rate_hz, _DRIFTS * first_hz)) ** 2))),
        math.hypot(_LEAST_RAD, _LEAST_SHARE * float(np.std(lateral))),
    )


def _load_shapes(weight_mps2: Floats) -> Floats:
    """Powers of the load factor's changes, of unit rms, (s, k)."""
    change = weight_mps2 - weight_mps2.mean()
    unit = change / max(float(np.std(change)), _LEAST_LOAD_MPS2)
    return np.stack([unit**power for power in range(1, _LOAD_POWERS + 1)])


def _of_either(airframe: Airframe, name: str) -> float:
    """Sigma of the difference of both tips in an axis or a scale."""
    return math.hypot(*(max(getattr(sensor, name), _AXES_RAD) for sensor in (airframe.left, airframe.right)))


def _heavy_enough(force_mps2: Floats) -> Floats:
    """Vertical force (m,) to divide by; what that says near weightlessness does not count."""
    return np.where(np.abs(force_mps2) > 0.5 * _LEAST_FORCE_MPS2, force_mps2, -0.5 * _LEAST_FORCE_MPS2)


def _twice_derived(values: Floats, rate_hz: float) -> Floats:
    """Second derivative of values (m,)."""
    return np.asarray(np.gradient(np.gradient(values, 1.0 / rate_hz), 1.0 / rate_hz))


def _integral(rate_radps: Floats, rate_hz: float) -> Floats:
    """Angle (m,) of a rate about its mean, from its own mean."""
    about = rate_radps - rate_radps.mean()
    angle = np.cumsum(about) / rate_hz
    return np.asarray(angle - angle.mean())


def _slow(values: Floats, rate_hz: float, first_hz: float) -> Floats:
    """Values (m,) behind the low-pass, about the line between their ends."""
    line = np.linspace(values[0], values[-1], len(values))
    gain = slow_response(np.asarray(np.fft.rfftfreq(len(values), 1.0 / rate_hz)), first_hz)
    return np.asarray(line + np.fft.irfft(gain * np.fft.rfft(values - line), len(values)))


def _rate_hz(samples: TipSamples) -> float:
    return float((len(samples.t_s) - 1) / (samples.t_s[-1] - samples.t_s[0]))
