"""Sensing equation of an inertial sensor on the wing: gravity, rigid motion, heave and tilt of its station.

With r the station's place from the root sensor, ``d = (0, -s e, -w)`` its displacement by bending (w up, and e towards
the root, for a bent wing keeps its length; s is the sign of y) and phi its rotation against the rest wing (left
``(+psi, tau, 0)``, right ``(-psi, tau, 0)``)::

    f_station = f_root + omega' x (r + d) + omega x (omega x (r + d)) + 2 omega x d' + d''
    f_sensed = R f_station,   gyro = R omega + phi',   R = exp(-[phi]x)

Exact, for simulation and tests; the filter's linearisation is in ``core/tracking/model.py`` and ``native/filter.c``.
Sensor errors (bias, scale, noise, filter) come after this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.wing.foreshortening import foreshortening_pm
from companion.core.wing.model import WingModel
from companion.records import Floats, Side

_SLOPE_SIGN = (1.0, -1.0)  # up-bend turns the left tip about +x, the right one about -x (by definition)


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
    """Acceleration (m, 3) of rigid rotation at ``position_m`` (3,) or (m, 3) from the root, m/s^2, body axes."""
    omega = motion.rate_radps
    tangential = np.cross(motion.angular_acceleration_radps2, position_m)
    return np.asarray(tangential + np.cross(omega, np.cross(omega, position_m)))


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
    place, rate, acceleration = _displaced(model, side, position_m, path)
    force = motion.specific_force_mps2 + lever_arm_mps2(motion, position_m + place)
    force = force + 2.0 * np.cross(motion.rate_radps, rate) + acceleration
    sensor_from_body = _rotations(-(path.q_m @ rows.T))
    turned_force = np.einsum("mij,mj->mi", sensor_from_body, force)
    turned_rate = np.einsum("mij,mj->mi", sensor_from_body, motion.rate_radps)
    return np.hstack([turned_force, turned_rate + path.qdot_mps @ rows.T])


def _displaced(model: WingModel, side: Side, position_m: Floats, path: ModalPath) -> tuple[Floats, Floats, Floats]:
    """Displacement of a station by bending and its first two derivatives, body axes, (m, 3) each."""
    lift = model.structure.lift[side]
    q, v, a = path.q_m * lift, path.qdot_mps * lift, path.qddot_mps2 * lift
    ranks = tuple(slot // 2 for slot in model.structure.slots)
    slope_factors = np.divide(model.structure.slope_radpm[side], lift, out=np.zeros_like(lift), where=lift != 0.0)
    relative = np.sign(position_m[1]) * model.params.shortening.value
    kappa = relative * foreshortening_pm(ranks, float(position_m[1]), slope_factors)
    along = (
        0.5 * np.sum(q @ kappa * q, axis=1),
        np.sum(v @ kappa * q, axis=1),
        np.sum(v @ kappa * v + q @ kappa * a, axis=1),
    )
    none = np.zeros(len(q))
    up = (q.sum(axis=1), v.sum(axis=1), a.sum(axis=1))
    place, rate, acceleration = (np.stack([none, -y, -z], axis=1) for y, z in zip(along, up, strict=True))
    return place, rate, acceleration


def _rotations(vectors: Floats) -> Floats:
    """Rodrigues (eq. 6) for (m, 3) rotation vectors, with series where the angle is small: (m, 3, 3)."""
    angle = np.linalg.norm(vectors, axis=1)
    sinc = np.sinc(angle / np.pi)
    versine = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    k = np.zeros((len(vectors), 3, 3))
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -vectors[:, 2], vectors[:, 1], -vectors[:, 0]
    k -= k.transpose(0, 2, 1)
    return np.asarray(np.eye(3) + sinc[:, None, None] * k + versine[:, None, None] * (k @ k))
