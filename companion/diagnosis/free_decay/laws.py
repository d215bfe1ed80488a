"""Laws of a mode's frequency and damping in a free decay, and a second mode near the first.

A named law is an effect of the catalogue; a law without a name describes what is left and is no cause.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.wing.effects.damping.coulomb_friction import CoulombFriction
from companion.core.wing.effects.damping.quadratic_damping import QuadraticDamping
from companion.core.wing.effects.modes.close_mode import CloseMode
from companion.core.wing.effects.stiffness.covariate_frequency import CovariateFrequency
from companion.core.wing.effects.stiffness.cubic_stiffness import CubicStiffness
from companion.core.wing.effects.stiffness.frequency_drift import FrequencyDrift
from companion.diagnosis.free_decay.record import FreeDecay
from companion.records import Floats

_MINUTE_S = 60.0  # by definition
_LEAST_AMPLITUDE = 0.01  # chosen: of the rms, below which friction's damping grows no further: it is noise


class Follows(enum.StrEnum):
    """Property of the mode that a law moves."""

    FREQUENCY = "frequency"
    DAMPING = "damping"
    ADDED_DAMPING = "added damping"


@dataclass(frozen=True, slots=True)
class Law:
    """Frequency x (1 + c basis(t)), log damping + c basis(t), or damping + c basis(t).

    Attributes
    ----------
    effect : str
        Of the catalogue; "" for a law that only describes.
    key : str
        What it says.
    channel : str
        Recorded channel that it follows, "" for none.
    parameter, unit, meaning : str
    sigma : float
        Prior standard deviation of c.
    starts : tuple of float
        Where a search begins.
    by_amplitude : bool
        Whether its basis is the amplitude's, which the filter follows.
    """

    effect: str
    key: str
    channel: str
    follows: Follows
    basis: Callable[[FreeDecay], Floats]
    parameter: str
    unit: str
    meaning: str
    sigma: float
    starts: tuple[float, ...]
    by_amplitude: bool = False
    log_trials: float = 0.0

    @property
    def name(self) -> str:
        """The effect, or what the law says."""
        return self.effect or self.key


@dataclass(frozen=True, slots=True)
class NeighbourMode:
    """A further mode near the first: where its search begins, in times the first one's frequency."""

    starts: tuple[float, ...] = (0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.05, 1.1, 1.15, 1.25)
    key: str = "a second mode near the first"
    effect: str = CloseMode.name
    name: str = CloseMode.name
    channel: str = ""
    log_trials: float = 0.0


Extension = Law | NeighbourMode


def laws_for(channels: Sequence[str]) -> list[Extension]:
    """All laws that are tried, for the channels that were recorded."""
    extensions: list[Extension] = [NeighbourMode()]
    for channel in channels:
        extensions.append(_covariate(channel))
        extensions.append(_bent(channel))
        extensions.append(_damping(channel))
    return [*extensions, _drift(), _cubic(), _quadratic(), _friction()]


def _covariate(channel: str) -> Law:
    return Law(
        CovariateFrequency.name,
        f"frequency follows {channel}",
        channel,
        Follows.FREQUENCY,
        lambda record: record.channels[channel],
        "ratio_per_rms",
        "",
        "relative change of the natural frequency per rms of the channel",
        0.05,
        (-0.25, -0.2, -0.15, -0.1, -0.05, 0.05, 0.1, 0.15, 0.2, 0.25),
    )


def _bent(channel: str) -> Law:
    return Law(
        "",
        f"frequency bends with {channel}: it is no straight line",
        channel,
        Follows.FREQUENCY,
        lambda record: record.channels[channel] ** 2 - 1.0,
        "ratio_per_rms2",
        "",
        "relative change of the natural frequency per squared rms of the channel",
        0.02,
        (0.0,),
    )


def _damping(channel: str) -> Law:
    return Law(
        "",
        f"damping follows {channel}",
        channel,
        Follows.DAMPING,
        lambda record: record.channels[channel],
        "log_ratio_per_rms",
        "",
        "change of the logarithm of the damping ratio per rms of the channel",
        0.5,
        (0.0,),
    )


def _drift() -> Law:
    return Law(
        FrequencyDrift.name,
        "frequency drifts in time",
        "",
        Follows.FREQUENCY,
        lambda record: (record.t_s - record.t_s.mean()) / _MINUTE_S,
        "ratio_per_min",
        "1/min",
        "relative change of the natural frequency per minute",
        0.05,
        (-1.0, -0.5, -0.2, 0.2, 0.5, 1.0),
    )


def _cubic() -> Law:
    return Law(
        CubicStiffness.name,
        "frequency follows the amplitude's square",
        "",
        Follows.FREQUENCY,
        lambda record: record.amplitude**2,
        "ratio_at_rms",
        "",
        "relative change of the natural frequency at an amplitude of the rms deflection",
        0.02,
        (-0.02, -0.006, -0.002, -0.0006, -0.0002, 0.0002, 0.0006, 0.002, 0.006, 0.02),
        by_amplitude=True,
    )


def _quadratic() -> Law:
    return Law(
        QuadraticDamping.name,
        "damping grows with the amplitude",
        "",
        Follows.ADDED_DAMPING,
        lambda record: record.amplitude,
        "damping_at_rms",
        "",
        "damping ratio that a force with speed squared adds at an amplitude of the rms deflection",
        0.02,
        (0.0, 0.001, 0.004),
        by_amplitude=True,
    )


def _friction() -> Law:
    return Law(
        CoulombFriction.name,
        "damping falls with the amplitude",
        "",
        Follows.ADDED_DAMPING,
        lambda record: 1.0 / np.maximum(record.amplitude, _LEAST_AMPLITUDE),
        "damping_at_rms",
        "",
        "damping ratio that dry friction adds at an amplitude of the rms deflection",
        0.02,
        (0.0, 0.001, 0.004),
        by_amplitude=True,
    )
