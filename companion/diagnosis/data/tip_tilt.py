"""Reading of a tip that the wing has tilted: its vertical force in the aircraft's axes.

A tip whose wing is bent by psi shows ``psi`` times the vertical force along its lateral axis, and the lateral force
times ``psi`` along its vertical one. The aircraft has a lateral force where it rolls in a climb or a push-over. What
the tilt then adds is slow, and omega^-2 makes a deflection of it that exceeds the noise of the ranges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.wing.foreshortening import foreshortening_pm
from companion.diagnosis.data.grid import half_cosine
from companion.params.airframe import Wing
from companion.records import Floats
from companion.units import GRAVITY_MPS2

_SLOW_PERIODS = 1.5  # of the first mode: width of the mean in which the lateral axis tells the slow tilt (choice)
_LOW, _FULL = 0.08, 0.16  # of the first mode's frequency: the fast deflection begins, and is complete (choice)
_REACH = 6.0  # widths after which a bell has ended (numerical)


@dataclass(frozen=True, slots=True)
class RigidTip:
    """The rigid aircraft at one tip, ``arm_m`` to the right of the root: forces (m,), m/s^2; roll rate (m,), rad/s."""

    lateral_mps2: Floats
    vertical_mps2: Floats
    roll_radps: Floats
    arm_m: float


def upright_force(force_y: Floats, force_z: Floats, rigid: RigidTip, wing: Wing, rate_hz: float) -> Floats:
    """Vertical specific force of a tip in the aircraft's axes, (m,), m/s^2.

    The tilt is the slope of the fast deflection, of which the acceleration tells, and a slow part, of which the lateral
    axis tells: ``A z`` of what it reads beyond the lateral force. The slow part is a local regression, for a tip is
    weightless at times.

    Parameters
    ----------
    force_y, force_z : (m,)
        Readings of the tip's own axes, m/s^2.
    rigid : RigidTip
        The aircraft there.
    wing : Wing
        Believed: slope, static bend, shortening, frequency of the first mode.
    rate_hz : float
        Of all samples.
    """
    first_hz = wing.symmetric.frequency_hz.value
    up_mps2 = rigid.vertical_mps2 - force_z
    deflection_m, speed_mps = _fast_motion(up_mps2, rate_hz, first_hz)
    lateral = rigid.lateral_mps2 + _bending_lateral(up_mps2, deflection_m, speed_mps, rigid, wing)
    fast_rad = -np.sign(rigid.arm_m) * wing.symmetric.slope_factor_radpm.value * deflection_m
    beyond, width = force_y - lateral - fast_rad * force_z, _SLOW_PERIODS / first_hz * rate_hz
    tilt_rad = fast_rad + _local_sum(beyond * force_z, width) / _local_sum(force_z**2, width)
    return np.asarray((force_z + np.sin(tilt_rad) * lateral) / np.cos(tilt_rad))


def _local_sum(values: Floats, width: float) -> Floats:
    """Sum (m,) under a bell of this width in samples about each sample."""
    count = len(values) + round(_REACH * width)  # nothing comes round from the other end
    bell: Floats = np.exp(-2.0 * (np.pi * width * np.fft.rfftfreq(count)) ** 2)
    return np.asarray(np.fft.irfft(bell * np.fft.rfft(values, count), count)[: len(values)])


def _fast_motion(up_mps2: Floats, rate_hz: float, first_hz: float) -> tuple[Floats, Floats]:
    """Deflection, m, and speed, m/s, of an acceleration (m,) without what is slow."""
    count = len(up_mps2)
    f_hz: Floats = np.asarray(np.fft.rfftfreq(count, 1.0 / rate_hz), dtype=np.float64)
    omega = 2.0 * np.pi * np.maximum(f_hz, _LOW * first_hz)
    once = half_cosine(f_hz / first_hz, _FULL, _LOW) / (1j * omega)
    spectrum = once * np.fft.rfft(up_mps2 - np.linspace(up_mps2[0], up_mps2[-1], count))
    return np.fft.irfft(spectrum / (1j * omega), count), np.fft.irfft(spectrum, count)


def _bending_lateral(up_mps2: Floats, deflection_m: Floats, speed_mps: Floats, rigid: RigidTip, wing: Wing) -> Floats:
    """Lateral force (m,) of a bending tip: it moves inboard by kappa q^2 / 2, and up and down in a rolling aircraft."""
    load_factor = -rigid.vertical_mps2 / GRAVITY_MPS2
    bend_m = wing.trim_bend_m.value + wing.bend_per_g_m.value * (load_factor - 1.0) + deflection_m
    inboard_pm = np.sign(rigid.arm_m) * wing.shortening.value * foreshortening_pm((0,), rigid.arm_m)[0, 0]
    return np.asarray(2.0 * rigid.roll_radps * speed_mps - inboard_pm * (bend_m * up_mps2 + speed_mps**2))
