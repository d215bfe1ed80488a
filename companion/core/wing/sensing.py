"""Sensing equation of an inertial sensor on the wing: gravity, rigid motion, heave and tilt of its station.

With r the station's place from the root sensor, w its upward displacement and phi its rotation against the rest wing
(left ``(+psi, tau, 0)``, right ``(-psi, tau, 0)``)::

    f_station = f_root + omega' x r + omega x (omega x r) + (0, 0, -w'')
    f_sensed = R f_station,   gyro = R omega + phi',   R = exp(-[phi]x)

:func:`sense_station` is exact, for simulation and tests; :func:`sensing_rows` is its linearisation for the estimator.
Sensor errors (bias, scale, noise, filter) come after this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.wing.model import WingModel
from companion.records import Floats, Side

_SLOPE_SIGN = (1.0, -1.0)  # up-bend turns the left tip about +x, the right one about -x


@dataclass(frozen=True, slots=True)
class RigidMotion:
    """The root's motion at m instants, body FRD: specific force, rate, angular acceleration, each (m, 3)."""

    specific_force_mps2: Floats
    rate_radps: Floats
    angular_acceleration_radps2: Floats


@dataclass(frozen=True, slots=True)
class ModalPath:
    """Modal coordinates and their first two derivatives at m instants, each (m, n)."""

    q_m: Floats
    qdot_mps: Floats
    qddot_mps2: Floats


def lever_arm_mps2(motion: RigidMotion, position_m: Floats) -> Floats:
    """Lever-arm acceleration (m, 3) of rigid rotation at ``position_m`` (3,) from the root, m/s^2, body axes."""
    omega = motion.rate_radps
    tangential = np.cross(motion.angular_acceleration_radps2, position_m)
    return np.asarray(tangential + np.cross(omega, np.cross(omega, position_m)))


def remove_rigid_motion(values: Floats, motion: RigidMotion, position_m: Floats) -> Floats:
    """Take the root's specific force, rate and lever arms out of a station's (m, 6) readings.

    What is left of an untilted station is the wing's own: (0, 0, -w'') and the slope rate. A tilted one keeps the
    projections of gravity that tell its slope.
    """
    rigid = np.hstack([motion.specific_force_mps2 + lever_arm_mps2(motion, position_m), motion.rate_radps])
    return np.asarray(values - rigid)


def rotation_rows(model: WingModel, side: Side) -> Floats:
    """Rotation vector of a tip station per modal coordinate, body axes, (3, n) in rad/m."""
    slope, twist = model.structure.slope_radpm[side], model.structure.twist_radpm[side]
    return np.vstack([_SLOPE_SIGN[side] * slope, twist, np.zeros_like(slope)])


def sense_station(model: WingModel, side: Side, position_m: Floats, motion: RigidMotion, path: ModalPath) -> Floats:
    """Exact readings of an ideal sensor at a tip station.

    Returns
    -------
    (m, 6) float64
        Specific force in m/s^2 and angular rate in rad/s along the sensor's own, tilted axes.
    """
    rows = rotation_rows(model, side)
    force = motion.specific_force_mps2 + lever_arm_mps2(motion, position_m)
    force[:, 2] -= path.qddot_mps2 @ model.structure.lift[side]
    sensor_from_body = _rotations(-(path.q_m @ rows.T))
    turned_force = np.einsum("mij,mj->mi", sensor_from_body, force)
    turned_rate = np.einsum("mij,mj->mi", sensor_from_body, motion.rate_radps)
    return np.hstack([turned_force, turned_rate + path.qdot_mps @ rows.T])


@dataclass(frozen=True, slots=True)
class SensingRows:
    """Readings near an operating point: values = offset + per_q dq + per_qdot dqdot + per_qddot qddot.

    Attributes
    ----------
    offset : (6,)
        Readings at the operating point with ``qdot = qddot = 0``.
    at_q_m : (n,)
        The operating point; ``dq = q - at_q_m``.
    per_q, per_qdot, per_qddot : (6, n)
    """

    offset: Floats
    at_q_m: Floats
    per_q: Floats
    per_qdot: Floats
    per_qddot: Floats

    def in_state(self, model: WingModel, load_factor: float) -> tuple[Floats, Floats, Floats]:
        """Substitute the modal equation for q'': ``values = constant + c [q, qdot] + d g``.

        Returns
        -------
        constant (6,), c (6, 2n), d (6, n)
            An accelerometer feels gust load and spring force alike, so d is per_qddot itself.
        """
        n = model.count
        space = model.state_space()
        driven = space.offset_trim + space.offset_per_g * (load_factor - 1.0)
        c = np.hstack([self.per_q, self.per_qdot]) + self.per_qddot @ space.a[n:]
        constant = self.offset - self.per_q @ self.at_q_m + self.per_qddot @ driven[n:]
        return constant, c, self.per_qddot


def sensing_rows(model: WingModel, side: Side, position_m: Floats, motion: RigidMotion, at_q_m: Floats) -> SensingRows:
    """Linearise :func:`sense_station` about a modal deflection (n,) and one instant of rigid motion.

    First order in the modal coordinates about ``at_q_m``; the tilt at the operating point is taken exactly, its change
    as a small rotation. Products of tilt change and q'' are second order and left out.
    """
    rows = rotation_rows(model, side)
    force = (motion.specific_force_mps2 + lever_arm_mps2(motion, position_m))[0]
    turn = _rotations(-(rows @ at_q_m)[None])[0]
    turned = np.concatenate([turn @ force, turn @ motion.rate_radps[0]])
    # R(phi + dphi) v is about R v - dphi x (R v) = R v + [R v]x dphi
    per_q = np.vstack([_cross(turned[:3]) @ rows, _cross(turned[3:]) @ rows])
    heave = np.outer(turn[:, 2], -model.structure.lift[side])
    none = np.zeros_like(heave)
    return SensingRows(turned, at_q_m, per_q, np.vstack([none, rows]), np.vstack([heave, none]))


def _cross(vector: Floats) -> Floats:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _rotations(vectors: Floats) -> Floats:
    """Rodrigues (eq. 6) for (m, 3) rotation vectors, with series where the angle is small: (m, 3, 3)."""
    angle = np.linalg.norm(vectors, axis=1)
    sinc = np.sinc(angle / np.pi)
    versine = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    k = np.zeros((len(vectors), 3, 3))
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -vectors[:, 2], vectors[:, 1], -vectors[:, 0]
    k -= k.transpose(0, 2, 1)
    return np.asarray(np.eye(3) + sinc[:, None, None] * k + versine[:, None, None] * (k @ k))
