"""Hooks of a named effect: the extension point of the one super-model.

An effect is a frozen dataclass in a file of its own under ``companion/core/wing/effects``. It names itself, declares
its parameters with unit, prior sigma and meaning, and overrides the hooks that it needs; the others are neutral. The
model calls the hooks in the order in which the effects are listed. With its parameters at 0 an effect changes nothing.

structure  ``structure``  reshape the linear matrices (frequency, damping, coupling, added modes)
           ``force``      add a modal acceleration that depends on time and state (nonlinear stiffness, friction)
sensing    ``sample_time``  the instant that a sample stamped ``t_s`` really shows (delay, skew)
           ``sense``      change what a station's sensor reports (scale, bias, cubic, tone, saturation)
           ``undone``     take that out of samples as they come, where each sample tells
camera     ``camera``     change when and where to a camera looks (exposure delay, baseline, focal length, mount)
forcing    ``forcing``    change the load on the modes (colour, periodic, impulsive)

Diagnosis asks the same hooks (``force`` with whole time series: each entry of :class:`ModalMotion` then has a last
axis for time) and three more, for what is linear and steady and can be said exactly in the frequency domain:

``response``   the sensor's complex gain beyond the calibrated one; with it ``sample_time`` and ``sense`` are not asked
``load_gain``  what the load passes through, beyond the believed gust
``bias``       what the sensor shows at rest

And what only its own class can know of an effect: ``sample_defect`` and ``clipped`` find it in recorded samples,
``starts_at`` and ``trial_values`` say where a fit of it begins, ``apply_to_airframe`` turns it into airframe values.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from companion.core.wing.samples import SampleDefect
from companion.core.wing.structure import Structure
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Sensor
from companion.records import Complexes, Floats, Side, Station

MOUNT_DAMPING = 0.02
"""Damping ratio of a camera mount that rings (half its loss factor; choice)."""


class Group(enum.StrEnum):
    """Where an effect acts."""

    STRUCTURE = "structure"
    SENSING = "sensing"
    CAMERA = "camera"
    FORCING = "forcing"


class ResidualPeak(enum.StrEnum):
    """Peaks of a fitted model's residual at which a fit of an effect can begin."""

    LINE = "line"
    """Highest line of the accelerations' periodogram, Hz."""
    STIFFNESS_LINE = "stiffness line"
    """Highest line of the periodogram of residual force times spring force, Hz."""
    IMPULSES = "impulses"
    """Strongest instants of the residual force, s."""


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """One parameter of an effect as its class declares it."""

    name: str
    unit: str
    default: float
    sigma: float
    doc: str
    above: float = -math.inf
    """No wing, sensor or camera has this value or less (no frequency is 0, no step is negative)."""


@dataclass(frozen=True, slots=True)
class ModalMotion:
    """The instant at which a force is asked for.

    ``offset_m`` is the deflection from the equilibrium ``static_m`` of this load factor; ``covariate`` a recorded
    channel about its mean in units of its rms, where an effect follows one; ``memory`` what the effect's
    :meth:`Effect.remember` gave at the end of the last step, None at the start and for whole time series.
    """

    t_s: float
    q_m: Floats
    qdot_mps: Floats
    static_m: Floats
    load_factor: float
    structure: Structure
    covariate: Floats | float = 0.0
    memory: Floats | None = None

    @property
    def offset_m(self) -> Floats:
        """Deflection from equilibrium, (n,)."""
        return self.q_m - self.static_m

    @property
    def spring_mps2(self) -> Floats:
        """Modal acceleration that the linear springs oppose, (n,)."""
        spring: Floats = self.structure.stiffness_radps2 @ self.offset_m
        return spring

    @property
    def half_stiffness_radps2(self) -> float:
        """Squared natural frequency of the first symmetric mode, to which laws of the halves' springs refer."""
        return float(self.structure.stiffness_radps2[0, 0])


@dataclass(frozen=True, slots=True)
class CameraView:
    """Camera as the effects have changed it: extra rotation vector (camera axes) and shift (body), focal, time.

    The mount follows the tip station's slope ``slope_gain`` times, ``lag_s`` late (first order), through a resonance at
    ``1/sqrt(softness_s2)`` rad/s with a damper of ``damper_s`` beside its loss; the image is the mean over a readout of
    ``readout2_s2`` seconds squared; ``jitter_s`` is the standard deviation of what the exposure's instant wanders (on
    average it misses a fast motion), ``jitter_shared`` the share of its square that both cameras have in common.
    """

    rotation_rad: Floats = field(default_factory=lambda: np.zeros(3))
    shift_m: Floats = field(default_factory=lambda: np.zeros(3))
    focal_ratio: float = 1.0
    exposure_delay_s: float = 0.0
    slope_gain: float = 1.0
    lag_s: float = 0.0
    jitter_s: float = 0.0
    jitter_shared: float = 1.0
    softness_s2: float = 0.0
    damper_s: float = 0.0
    readout2_s2: float = 0.0

    def follows(self, omega_radps: Floats) -> Complexes:
        """Camera slope per station slope, (f,); (1,) where it is the same at every frequency."""
        if not (self.lag_s or self.softness_s2 or self.damper_s or self.readout2_s2 or self.jitter_s):
            return np.array([self.slope_gain + 0.0j])
        omega: Floats = np.asarray(omega_radps)
        lag = 1.0 / (1.0 + 1j * omega * self.lag_s)
        soft = self.softness_s2 * omega**2
        resonance = 1.0 / (1.0 - soft * (1.0 - 2j * MOUNT_DAMPING) + 1j * omega * self.damper_s)
        # a mean over T passes sinc(omega T / 2) = 1 - omega^2 T^2 / 24 + ...
        mean = np.sinc(np.sqrt(np.maximum(self.readout2_s2, 0.0)) * omega / (2.0 * np.pi))
        wandering = np.exp(-0.5 * (omega * self.jitter_s) ** 2)  # the mean over instants that are normal
        return np.asarray(self.slope_gain * lag * resonance * mean * wandering, dtype=np.complex128)


def parameter(unit: str, sigma: float, doc: str, default: float = 0.0, above: float = -math.inf) -> Any:
    """Declare a parameter of an effect: unit, prior standard deviation, meaning, and what every value lies above."""
    return field(default=default, metadata={"unit": unit, "sigma": sigma, "doc": doc, "above": above})


@dataclass(frozen=True, slots=True)
class Effect:
    """Base of all effects: every hook neutral."""

    name: ClassVar[str]
    group: ClassVar[Group]
    advice: ClassVar[str] = ""
    """What would separate it from its neighbours, or mend it."""
    scan: ClassVar[Mapping[str, tuple[float, ...]]] = MappingProxyType({})
    """Values at which to begin for parameters that mean nothing while those declared before them are 0 (a mode's
    frequency). A first parameter cannot be one: those before the first of them are what is screened."""
    follows_channel: ClassVar[bool] = False
    """Whether it needs a recorded channel."""
    multimodal: ClassVar[bool] = False
    """Whether a fit may end on a lesser hill, so that it is begun at every place of ``scan``."""
    one_way: ClassVar[bool] = False
    """Whether nature has it with a positive first parameter only (friction is never negative)."""
    hinged: ClassVar[bool] = False
    """Whether below 0 it is another thing than above (the other stream late), so that it is screened on either side."""
    in_samples: ClassVar[bool] = False
    """Whether recorded samples show it by themselves (:meth:`sample_defect`): then nothing is fitted to it."""
    additive: ClassVar[bool] = False
    """Whether what it adds is the same whatever a sensor reads, or however the wing moves: it has no slope."""
    discretises: ClassVar[bool] = False
    """Whether it makes a staircase of readings, from which no smooth law of the sensors can be told."""
    own_law: ClassVar[str] = ""
    """Law without a name that is its own, as sharp or as smooth as a recording has it: no rival of the name."""
    transient: ClassVar[bool] = False
    """Whether it acts at instants of its own: then no block of a recording foretells another."""
    instants: ClassVar[tuple[str, ...]] = ()
    """Parameters that are instants of a recording: their prior is its length, not the declared sigma."""
    adds_toe_variance: ClassVar[bool] = False
    """Whether the variance of the measured toe follows from it, beside or in place of the mean."""
    starts_at: ClassVar[ResidualPeak | None] = None
    """Peak of the residual at which a fit begins, for what has a frequency or instants of its own."""

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
                entry.metadata["above"],
            )
            for entry in dataclasses.fields(cls)
        )

    def structure(self, structure: Structure) -> Structure:
        """Reshape the linear model."""
        return structure

    def is_distinct(self, structure: Structure) -> bool:
        """Whether it is another thing than what a wing of this structure has already."""
        del structure
        return True

    def force(self, motion: ModalMotion) -> Floats | None:
        """Modal acceleration to add, (n,) in m/s^2, or None for none."""
        del motion
        return None

    def remember(self, motion: ModalMotion) -> Floats | None:
        """Memory (k, ...) of a force with history from this instant to the next, k as the effect likes; or None."""
        del motion
        return None

    def mean_derivative(self, motion: ModalMotion, weight: Floats) -> Floats:
        """Mean derivative (h, m) of a half's force by its deflection k samples before, (rad/s)^2, k from 0 to m - 1.

        Only of effects that ``remember``. ``motion`` is a whole one; ``weight`` (m,) is that of a sample in the mean.
        """
        raise NotImplementedError(f"effect '{self.name}' remembers and needs a mean_derivative()")

    def kick_spectrum(self, omega_radps: Floats, count: int, start_s: float, stop_s: float) -> Complexes:
        """Fourier transform (count, f) of the modal loads of a ``transient`` effect between two times, from the first.

        What lasts for less than a sample has a spectrum beyond all of the samples'.
        """
        raise NotImplementedError(f"effect '{self.name}' is transient and needs a kick_spectrum()")

    @classmethod
    def may_follow(cls, channel: str) -> bool:
        """Whether the effect may follow a recorded channel of this name; asked where ``follows_channel``."""
        del channel
        return cls.follows_channel

    @classmethod
    def belongs_to_recording(cls) -> bool:
        """Whether its values are those of one recording (losses of a link, instants, a phase) and of no airframe."""
        return cls.in_samples or cls.transient or cls.starts_at is not None

    @classmethod
    def forces_modes(cls) -> bool:
        """Whether it overrides ``force``, so that a wing with it is not linear."""
        return cls.force is not Effect.force

    def sample_time(self, station: Station, t_s: Floats) -> Floats:
        """The instants that samples stamped ``t_s`` really show, (m,)."""
        del station
        return t_s

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Sensor's output (m, 6) for true ``values`` (m, 6), m/s^2 and rad/s, before noise and quantisation.

        The values are consecutive samples of one stream at ``t_s`` (m,) on an even grid: a whole flight, or a block of
        it, which may be a single sample.
        """
        del station, t_s
        return values

    def undone(self, station: Station, values: Floats) -> Floats:
        """True values of samples (m, 6) that this effect has changed, where each sample tells; else as they are."""
        del station
        return values

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """View of a camera under this effect."""
        del side, t_s
        return view

    def forcing(self, t_s: Floats, load_mps2: Floats, generator: np.random.Generator) -> Floats:
        """Change the modal load (m, n) on the uniform grid ``t_s`` (m,)."""
        del t_s, generator
        return load_mps2

    def response(self, station: Station, f_hz: Floats) -> Complexes | None:
        """Complex gain of a station's accelerometer, (m,), or None for 1."""
        del station, f_hz
        return None

    def bias(self, station: Station) -> float:
        """Constant that a station's vertical accelerometer adds, m/s^2."""
        del station
        return 0.0

    def load_gain(self, f_hz: Floats, count: int) -> Complexes | None:
        """Matrix (m, n, n) that the modal loads pass through, or None for unity."""
        del f_hz, count
        return None

    @classmethod
    def sample_defect(cls, t_s: Floats, force_z_mps2: Floats, sensor: Sensor) -> SampleDefect | None:
        """The effect as one stream's stamps (n,) and values (n,) show it; asked where ``in_samples``."""
        del t_s, force_z_mps2, sensor
        return None

    @classmethod
    def clipped(cls, force_z_mps2: Floats) -> Floats:
        """1 where it cut a sample from above (the truth is at least that), -1 where from below, else 0, (n,)."""
        return np.zeros(len(force_z_mps2))

    @classmethod
    def at_peaks(cls, peaks: tuple[float, ...]) -> Effect:
        """The effect at nothing, at the peaks of ``starts_at``, strongest first."""
        return cls.from_values({"frequency_hz": peaks[0]})

    @classmethod
    def trial_values(cls, first_hz: float) -> tuple[dict[str, float], ...]:
        """Values to try one by one before a refit, where the likelihood has many hills; the first mode is given."""
        del first_hz
        return ()

    def apply_to_airframe(self, airframe: Airframe) -> Airframe | None:
        """The airframe with the effect as other values of its own; None if it is more than that."""
        del airframe
        return None

    @classmethod
    def from_values(cls, values: dict[str, float]) -> Effect:
        """Build the effect; raise :class:`ConfigError` naming a parameter that it does not have."""
        names = [entry.name for entry in cls.parameters()]
        for key in values:
            if key not in names:
                raise ConfigError(f"effect '{cls.name}' has no parameter '{key}'; it has: {', '.join(names)}")
        return cls(**values)


def sensed(effects: Iterable[Effect], station: Station, t_s: Floats, values: Floats) -> Floats:
    """Pass true sensor values (m, 6) through every effect, in order; raise ConfigError for one that gives others."""
    for effect in effects:
        output = effect.sense(station, t_s, values)
        if np.shape(output) != values.shape:
            shapes = f"{np.shape(output)} of samples {values.shape}"
            raise ConfigError(f"effect '{effect.name}': its sense() makes {shapes}; both must be alike")
        values = output
    return values


def viewed(effects: Iterable[Effect], side: Side, t_s: float) -> CameraView:
    """View of a camera under all effects together."""
    view = CameraView()
    for effect in effects:
        view = effect.camera(side, t_s, view)
    return view


def with_vertical(values: Floats, vertical_mps2: Floats) -> Floats:
    """Samples (m, 6) with another vertical specific force (m,)."""
    changed = values.copy(order="K")
    changed[:, 2] = vertical_mps2
    return changed


def harmonic(cosine: float, sine: float, frequency_hz: float, t_s: Floats | float) -> Floats:
    """``cosine cos 2 pi f t + sine sin 2 pi f t`` at each instant (m,)."""
    phase = 2.0 * np.pi * frequency_hz * np.asarray(t_s)
    return np.asarray(cosine * np.cos(phase) + sine * np.sin(phase))


def on_halves(motion: ModalMotion, law: Callable[[Floats, Floats], Floats]) -> Floats:
    """Apply a force law to each tip's deflection and speed, and give its loads (n, ...) on the first modes.

    With w = s - a on the left and s + a on the right the loads are the mean and the half difference. Second modes
    hardly bend the tips but move them fast: to the first ones a friction is the weaker for it, as under any dither.
    """
    lift = motion.structure.lift
    tips = [np.tensordot(lift, modal, 1) for modal in (motion.offset_m, motion.qdot_mps)]
    return from_halves(motion, np.stack([law(w, v) for w, v in zip(*tips, strict=True)]))


def halves(modal: Floats) -> Floats:
    """First modes (n, ...) as each wing half's motion, (2, ...): left, right; a single mode is one half, (1, ...)."""
    return np.stack([modal[0] - modal[1], modal[0] + modal[1]]) if len(modal) > 1 else modal[:1]


def from_halves(motion: ModalMotion, loads: Floats) -> Floats:
    """Modal loads (n, ...) of loads on each half."""
    added = np.zeros_like(motion.q_m)
    added[0] = 0.5 * (loads[0] + loads[-1])
    if len(loads) > 1:
        added[1] = 0.5 * (loads[1] - loads[0])
    return added


def _number(value: Any) -> float:
    return float(value)
