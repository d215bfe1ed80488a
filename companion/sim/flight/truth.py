"""The simulator's truth: what the aircraft and its wing really do, at any instant.

Knots lie on a uniform grid of boot time; between them every quantity is the cubic Hermite of its knots and their exact
derivatives, so that a rate is the derivative of its angle at every instant and a camera rotation is right to 1e-8 rad.
Ground is the plane z = 0 of the NED frame; body axes are FRD; modal coordinates are [sym1, anti1, sym2, anti2, ...].
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from companion.core.wing.model import WingModel
from companion.records import Floats, Ints
from companion.units import GRAVITY_MPS2

STEP_NS = 1_000_000  # chosen: fifty knots of the period at 20 Hz; cubics between them are right to 1e-8 rad

# columns of a knot: position (NED), velocity (NED), roll pitch yaw, body rate, modal coordinates
POSITION, VELOCITY, EULER, RATE, MODAL = (slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(12, None))
COLUMNS = 16  # of a knot: position, attitude, the four named modal coordinates; further ones follow (by definition)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Motion:
    """Motion of aircraft and wing: at one instant as below, of a series with n rows; tip quantities are [left, right].

    Attributes
    ----------
    body_from_ned : (3, 3) float64
    body_rate_radps, angular_accel_radps2 : (3,) float64
        Rigid body rate and its derivative, body FRD.
    specific_force_mps2 : (3,) float64
        Rigid specific force at the root (body origin); a level aircraft at rest has z = -9.80665.
    q_m, qdot_mps : (s,) float64
        Total deflection relative to the wing as calibrated on the ground, and its rate.
    slope_rad, slope_rate_radps, twist_rad, lift_m, lift_rate_mps : (2,) float64
        Up-bend slope, nose-up twist and upward displacement of the tip stations.
    """

    position_ned_m: Floats
    velocity_ned_mps: Floats
    body_from_ned: Floats
    body_rate_radps: Floats
    angular_accel_radps2: Floats
    specific_force_mps2: Floats
    q_m: Floats
    qdot_mps: Floats
    slope_rad: Floats
    slope_rate_radps: Floats
    twist_rad: Floats
    lift_m: Floats
    lift_rate_mps: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthSample(_Motion):
    """The truth at one instant; ``load_factor`` is ``-specific_force_z / g``."""

    t_boot_ns: int
    load_factor: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthSeries(_Motion):
    """The truth at ``n`` instants: each array has ``n`` rows."""

    t_boot_ns: Ints
    load_factor: Floats
    euler_rad: Floats


@dataclass(frozen=True, slots=True)
class TipShape:
    """Mode shapes at the tip stations: (2, s) gains, rows left and right."""

    lift: Floats
    slope_radpm: Floats
    twist_radpm: Floats

    @classmethod
    def from_model(cls, model: WingModel) -> TipShape:
        """Spread a wing model's gains over its s modal coordinates, at least the four named ones."""
        structure = model.structure
        rows = np.stack([structure.lift, structure.slope_radpm, structure.twist_radpm])
        return cls(*model.all_slots(rows))


def by_family(modal: Floats) -> Floats:
    """Tip deflection or its rate by all modes of the symmetric and of the antisymmetric family, (2,) of (s,)."""
    return np.array([modal[0::2].sum(), modal[1::2].sum()])


def body_from_ned_matrix(euler_rad: Floats) -> Floats:
    """Rotation matrices (n, 3, 3) from roll, pitch, yaw (n, 3), the aerospace 3-2-1 sequence."""
    cos, sin = np.cos(euler_rad), np.sin(euler_rad)
    (cr, cp, cy), (sr, sp, sy) = cos.T, sin.T
    rows = [
        [cp * cy, cp * sy, -sp],
        [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
        [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


class FlightTruth:
    """A whole flight on a 1 kHz grid, with interpolation.

    Parameters
    ----------
    knots, derivatives : (n, 12 + s) float64
        Position, velocity, Euler angles, body rate and modal coordinates, and their time derivatives, each ``step_ns``
        from boot time 0.
    shape : TipShape
        From modal coordinates to the tips.
    """

    def __init__(self, knots: Floats, derivatives: Floats, shape: TipShape, step_ns: int = STEP_NS) -> None:
        columns = MODAL.start + shape.lift.shape[1]
        if knots.shape != derivatives.shape or knots.shape[1] != columns:
            raise ValueError(f"knots and derivatives must both be (n, {columns})")
        self.knots = knots
        self.derivatives = derivatives
        self.shape = shape
        self.step_ns = step_ns

    @property
    def t_boot_ns(self) -> Ints:
        """Times of the knots, (n,)."""
        return np.arange(len(self.knots), dtype=np.int64) * self.step_ns

    @property
    def end_ns(self) -> int:
        """Boot time of the last knot."""
        return (len(self.knots) - 1) * self.step_ns

    @property
    def duration_s(self) -> float:
        """The same in seconds."""
        return self.end_ns * 1e-9

    def at(self, t_boot_ns: int) -> TruthSample:
        """Give the truth at one instant.

        Raises
        ------
        ValueError
            The instant is before boot or after the end of the flight.
        """
        many = self.series(np.array([t_boot_ns], dtype=np.int64))
        first = {entry.name: getattr(many, entry.name)[0] for entry in dataclasses.fields(_Motion)}
        return TruthSample(t_boot_ns=int(t_boot_ns), load_factor=float(many.load_factor[0]), **first)

    def series(self, t_boot_ns: Ints) -> TruthSeries:
        """Give the truth at many instants (n,), in any order; raise ValueError outside the flight."""
        value, rate = self._interpolate(t_boot_ns)
        matrix = body_from_ned_matrix(value[:, EULER])
        # specific force is acceleration less gravity, and NED's z points down
        inertial = rate[:, VELOCITY] - np.array([0.0, 0.0, GRAVITY_MPS2])
        force = np.einsum("nij,nj->ni", matrix, inertial)
        q, qdot, shape = value[:, MODAL], rate[:, MODAL], self.shape
        return TruthSeries(
            t_boot_ns=t_boot_ns,
            position_ned_m=value[:, POSITION],
            velocity_ned_mps=value[:, VELOCITY],
            euler_rad=value[:, EULER],
            body_from_ned=matrix,
            body_rate_radps=value[:, RATE],
            angular_accel_radps2=rate[:, RATE],
            specific_force_mps2=force,
            load_factor=-force[:, 2] / GRAVITY_MPS2,
            q_m=q,
            qdot_mps=qdot,
            slope_rad=q @ shape.slope_radpm.T,
            slope_rate_radps=qdot @ shape.slope_radpm.T,
            twist_rad=q @ shape.twist_radpm.T,
            lift_m=q @ shape.lift.T,
            lift_rate_mps=qdot @ shape.lift.T,
        )

    def _interpolate(self, t_boot_ns: Ints) -> tuple[Floats, Floats]:
        """Cubic Hermite values and derivatives (n, 12 + s)."""
        end = self.end_ns
        if t_boot_ns.size and (t_boot_ns.min() < 0 or t_boot_ns.max() > end):
            raise ValueError(f"boot time {t_boot_ns.min()}..{t_boot_ns.max()} ns is outside the flight 0..{end} ns")
        index = np.minimum(t_boot_ns // self.step_ns, len(self.knots) - 2)
        step = self.step_ns * 1e-9
        u = ((t_boot_ns - index * self.step_ns) / self.step_ns)[:, None]
        x0, x1 = self.knots[index], self.knots[index + 1]
        d0, d1 = self.derivatives[index] * step, self.derivatives[index + 1] * step
        jump = x1 - x0
        square, cube = 3 * jump - 2 * d0 - d1, d0 + d1 - 2 * jump
        value = x0 + u * (d0 + u * (square + u * cube))
        rate = (d0 + u * (2 * square + u * 3 * cube)) / step
        return value, rate
