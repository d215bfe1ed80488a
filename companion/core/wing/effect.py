"""What a named effect may change: the extension point of the one super-model.

An effect is a frozen dataclass in a file of its own under ``companion/core/wing/effects``. It names itself, declares
its parameters with unit, prior sigma and meaning, and overrides the hooks that it needs; the others are neutral. The
model calls the hooks in the order in which the effects are listed. With its parameters at 0 an effect changes nothing.

structure  ``structure``  reshape the linear matrices (frequency, damping, coupling, added modes)
           ``force``      add a modal acceleration that depends on time and state (nonlinear stiffness, friction)
sensing    ``sample_time``  the instant that a sample stamped ``t_s`` really shows (delay, skew)
           ``sense``      change what a station's sensor reports (scale, bias, cubic, tone, saturation)
camera     ``camera``     change when and where to a camera looks (exposure delay, baseline, focal length, mount)
forcing    ``forcing``    change the load on the modes (colour, periodic, impulsive)
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from companion.core.wing.structure import Structure
from companion.errors import ConfigError
from companion.records import Floats, Side, Station


class Group(enum.StrEnum):
    """Where an effect acts."""

    STRUCTURE = "structure"
    SENSING = "sensing"
    CAMERA = "camera"
    FORCING = "forcing"


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """One parameter of an effect as its class declares it."""

    name: str
    unit: str
    default: float
    sigma: float
    doc: str


@dataclass(frozen=True, slots=True)
class ModalMotion:
    """The instant at which a force is asked for.

    ``offset_m`` is the deflection from the equilibrium ``static_m`` of this load factor.
    """

    t_s: float
    q_m: Floats
    qdot_mps: Floats
    static_m: Floats
    load_factor: float
    structure: Structure

    @property
    def offset_m(self) -> Floats:
        """Deflection from equilibrium, (n,)."""
        return self.q_m - self.static_m


@dataclass(frozen=True, slots=True)
class CameraView:
    """What the effects have made of a camera: extra rotation vector (camera axes) and shift (body), focal, time."""

    rotation_rad: Floats = field(default_factory=lambda: np.zeros(3))
    shift_m: Floats = field(default_factory=lambda: np.zeros(3))
    focal_ratio: float = 1.0
    exposure_delay_s: float = 0.0


def parameter(unit: str, sigma: float, doc: str, default: float = 0.0) -> Any:
    """Declare a parameter of an effect: unit, prior standard deviation, meaning."""
    return field(default=default, metadata={"unit": unit, "sigma": sigma, "doc": doc})


@dataclass(frozen=True, slots=True)
class Effect:
    """Base of all effects: every hook neutral."""

    name: ClassVar[str]
    group: ClassVar[Group]

    @classmethod
    def parameters(cls) -> tuple[EffectParameter, ...]:
        """The declared parameters, in order."""
        return tuple(
            EffectParameter(
                entry.name,
                entry.metadata["unit"],
                _number(entry.default),
                entry.metadata["sigma"],
                entry.metadata["doc"],
            )
            for entry in dataclasses.fields(cls)
        )

    def structure(self, structure: Structure) -> Structure:
        """Reshape the linear model."""
        return structure

    def force(self, motion: ModalMotion) -> Floats | None:
        """Modal acceleration to add, (n,) in m/s^2, or None for none."""
        del motion
        return None

    def sample_time(self, station: Station, t_s: Floats) -> Floats:
        """The instants that samples stamped ``t_s`` really show, (m,)."""
        del station
        return t_s

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """What the sensor makes of true ``values`` (m, 6), m/s^2 and rad/s, before noise and quantisation."""
        del station, t_s
        return values

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """What becomes of a camera's view."""
        del side, t_s
        return view

    def forcing(self, t_s: Floats, load_mps2: Floats, generator: np.random.Generator) -> Floats:
        """Change the modal load (m, n) on the uniform grid ``t_s`` (m,)."""
        del t_s, generator
        return load_mps2

    @classmethod
    def from_values(cls, values: dict[str, float]) -> Effect:
        """Build the effect; raise :class:`ConfigError` naming a parameter that it does not have."""
        known = [entry.name for entry in cls.parameters()]
        for key in values:
            if key not in known:
                raise ConfigError(f"effect '{cls.name}' has no parameter '{key}'; it has: {', '.join(known)}")
        return cls(**values)


def sensed(effects: Iterable[Effect], station: Station, t_s: Floats, values: Floats) -> Floats:
    """Pass true sensor values through every effect, in order."""
    for effect in effects:
        values = effect.sense(station, t_s, values)
    return values


def viewed(effects: Iterable[Effect], side: Side, t_s: float) -> CameraView:
    """What all effects together make of a camera."""
    view = CameraView()
    for effect in effects:
        view = effect.camera(side, t_s, view)
    return view


def _number(value: Any) -> float:
    return float(value)
