"""The one super-model in the frequency domain: what it expects of a recording, and how far the recording is from that.

The tips' accelerations are a stationary process with spectral matrix S(f) (Whittle); forces that depend on state or
time and sensors that are not straight are taken back out of the data first. The toe at each exposure is judged given
the accelerations: its mean through the Wiener smoother of the same model, its covariance through the posterior's
spectrum.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve

from companion.core.wing.effect import CameraView, Effect, Group, ModalMotion, viewed
from companion.core.wing.model import WingModel
from companion.core.wing.structure import structure_of
from companion.diagnosis.belief import Belief
from companion.diagnosis.observations import Observations
from companion.records import Floats, Side, Station

Complexes = npt.NDArray[np.complex128]
_TAPER = 0.05  # share of the recording over which each end fades
_FINER = 16
_RANGE_ONLY = frozenset({"toe_rad", "focal", "match", "trim_bend_m", "bend_per_g_m"})
_LOW = 0.15
_STATIONS = {Side.LEFT: Station.LEFT, Side.RIGHT: Station.RIGHT}
GRAVITY_MPS2 = 9.80665


@dataclass(frozen=True, slots=True)
class Part:
    """One named effect in a model, with the recorded channel that it follows, if any."""

    effect: Effect
    channel: str = ""


@dataclass(frozen=True, slots=True)
class Expectation:
    """A model held against a recording.

    Attributes
    ----------
    spectrum : (b, c, c)
        Two-sided density of the accelerations in the band.
    inverse : (b, c, c)
    residual : (b, c)
        What is left of the data's spectrum once all that is not stationary Gaussian is out.
    toe_residual_rad : (k,)
    toe_posterior : (k, k)
        Covariance of the toe that the accelerations leave.
    toe_variance : (k,)
        Of the matching, and of exposures that wander.
    rest_residual, rest_variance : (c,)
        The sensors at rest: what is left of the mean, and its variance.
    q_m, qdot_mps : (n, m)
        Smoothed modal coordinates.
    """

    spectrum: Complexes
    inverse: Complexes
    residual: Complexes
    toe_residual_rad: Floats
    toe_posterior: Floats
    toe_variance: Floats
    rest_residual: Floats
    rest_variance: Floats
    q_m: Floats
    qdot_mps: Floats

    @property
    def toe_covariance(self) -> Floats:
        """Of the toe residual, (k, k)."""
        return self.toe_posterior + np.diag(self.toe_variance)


@dataclass(frozen=True, slots=True)
class _Linear:
    """Everything that follows from the linear model on all bins: receptance, load, sensing."""

    receptance: Complexes  # (f, n, n) modal deflection per load
    load: Complexes  # (f, n, n) two-sided load density
    seen: Complexes  # (f, c, n) accelerometer channel per modal deflection
    noise: Floats  # (c,) two-sided density


@dataclass(frozen=True, slots=True)
class _Motion:
    """What the accelerations have a say in."""

    linear: _Linear
    cross: Complexes
    smoother: Complexes
    spectrum: Complexes
    inverse: Complexes
    residual: Complexes
    modal: Complexes
    q_m: Floats
    qdot_mps: Floats


class SuperModel:
    """A belief and a recording, ready to be asked about any parameters and any effects."""

    def __init__(self, belief: Belief, seen: Observations, top_hz: float) -> None:
        self.belief, self.seen, self.top_hz = belief, seen, top_hz
        m = len(seen.up_mps2)
        self._dt_s = 1.0 / seen.rate_hz
        self.f_hz: Floats = np.asarray(np.fft.rfftfreq(m, self._dt_s), dtype=np.float64)
        low_hz = _LOW * belief.airframe.wing.symmetric.frequency_hz.value
        self.band = np.flatnonzero((self.f_hz >= low_hz) & (self.f_hz <= min(top_hz, 0.45 * seen.rate_hz)))
        self.band_hz = self.f_hz[self.band]
        self._taper = _tukey(m, _TAPER)
        self._norm = np.sqrt(self._dt_s / np.sum(self._taper**2))
        # neighbouring bins of a tapered periodogram share information: count them once
        self.weight = float(np.sum(self._taper**2) ** 2 / (m * np.sum(self._taper**4)))
        self._spectrum = np.fft.rfft(seen.up_mps2, axis=0)
        self._level = self._reference_levels()
        self._kept: tuple[object, _Motion] | None = None

    # ------------------------------------------------------------------------------------------- public

    def expect(self, deviations: Floats, parts: Sequence[Part] = (), posterior: Floats | None = None) -> Expectation:
        """Hold a model against the recording.

        Parameters
        ----------
        deviations : (p,)
            Nuisances, in the belief's order.
        parts : sequence of Part
            Named effects in force.
        posterior : (k, k), optional
            ``toe_posterior`` of a neighbouring model, where that will do: it is the dear part.
        """
        deviation = self.belief.named(deviations)
        effects = tuple(part.effect for part in parts)
        wing = WingModel(self.belief.wing(deviation), effects)
        motion = self._motion(wing, parts, deviation)
        slope = self._slope(wing, effects)
        toe, toe_variance = self._toe(wing, effects, deviation, slope, motion.modal)
        if posterior is None:
            posterior = self._toe_posterior(slope, motion)
        rest, rest_variance = self._rest(effects, deviation)
        return Expectation(
            motion.spectrum,
            motion.inverse,
            motion.residual,
            toe,
            posterior,
            toe_variance,
            rest,
            rest_variance,
            motion.q_m,
            motion.qdot_mps,
        )

    def log_likelihood(self, found: Expectation) -> float:
        """Log likelihood of the recording under an expectation, up to a constant."""
        return float(sum(self.log_scores(found).values()))

    def log_scores(self, found: Expectation) -> dict[str, float]:
        """Log likelihood by channel: accelerations, toe given them, and the sensors' mean."""
        _, log_det = np.linalg.slogdet(found.spectrum)
        misfit = np.einsum("fi,fij,fj->", found.residual.conj(), found.inverse, found.residual).real
        scores = {"acceleration": self.weight * float(-np.sum(log_det) - misfit)}
        if len(found.toe_residual_rad):
            factor = cho_factor(found.toe_covariance, lower=True)
            whitened = found.toe_residual_rad @ cho_solve(factor, found.toe_residual_rad)
            scores["range"] = float(-np.sum(np.log(np.diag(factor[0]))) - 0.5 * whitened)
        rest = found.rest_residual**2 / found.rest_variance
        scores["rest"] = float(-0.5 * np.sum(rest + np.log(found.rest_variance)))
        return scores

    def data_in_band(self) -> Complexes:
        """The recorded accelerations' tapered spectrum, (b, c); its squared size estimates the two-sided density."""
        return self._tapered(self._spectrum)

    def time_shift(self, effect: Effect) -> Floats | None:
        """How a unit of the effect's first parameter shifts the channels' time, (c, m) seconds; None if not at all."""
        kind = type(effect)
        if kind.sample_time is Effect.sample_time or kind.response is not Effect.response:
            return None
        declared = effect.parameters()[0]
        unit = kind.from_values({declared.name: declared.sigma})
        t_s = self.seen.t_s
        return np.stack([unit.sample_time(_STATIONS[side], t_s) - t_s for side in self.seen.sides]) / declared.sigma

    # ------------------------------------------------------------------------------------------- pieces

    def _motion(self, wing: WingModel, parts: Sequence[Part], deviation: Mapping[str, float]) -> _Motion:
        """What the accelerations have a say in; kept, for half of all parameters are of the cameras alone."""
        inner = tuple(part for part in parts if part.effect.group is not Group.CAMERA)
        key = (inner, tuple(value for name, value in deviation.items() if not _of_range(name)))
        if self._kept is None or self._kept[0] != key:
            self._kept = (key, self._moved(wing, inner, deviation))
        return self._kept[1]

    def _moved(self, wing: WingModel, parts: Sequence[Part], deviation: Mapping[str, float]) -> _Motion:
        effects = tuple(part.effect for part in parts)
        linear = self._linear(wing, effects, deviation)
        motion_per_load = linear.seen @ linear.receptance
        cross = linear.receptance @ linear.load @ _adjoint(motion_per_load)  # (f, n, c): q with what is seen
        spectrum = (motion_per_load @ linear.load @ _adjoint(motion_per_load))[self.band]
        spectrum += np.diag(linear.noise)
        inverse = _inverse(spectrum)
        smoother = np.zeros_like(cross)
        smoother[self.band] = cross[self.band] @ inverse
        straight = self._straighten(effects)
        modal = (smoother @ straight[..., None])[..., 0]
        q, qdot = self._in_time(modal), self._in_time(modal * (2j * np.pi * self.f_hz[:, None]))
        push = self._push(wing, parts, q, qdot)
        left = straight
        if push is not None:
            forced = (linear.receptance @ push[..., None])[..., 0]
            left = straight - (linear.seen @ forced[..., None])[..., 0]
            modal = (smoother @ left[..., None])[..., 0] + forced
        return _Motion(linear, cross, smoother, spectrum, inverse, self._tapered(left), modal, q, qdot)

    def _reference_levels(self) -> Floats:
        """Load density that gives each believed mode the believed rms deflection, (n,)."""
        wing = self.belief.airframe.wing
        structure = structure_of(wing)
        shape = self._load_shape({})
        receptance = _receptance(structure.stiffness_radps2, structure.damping_radps, self.f_hz)
        step = self.f_hz[1]
        power = 2.0 * step * np.sum(np.abs(np.einsum("fii->fi", receptance)) ** 2 * shape[:, None], 0)
        level = wing.gust.deflection_rms_m.value**2 / power
        first = np.array([0 if slot % 2 == 0 else min(1, len(level) - 1) for slot in structure.slots])
        return np.asarray(level[first])  # second modes are thought to be loaded as densely as the first

    def _load_shape(self, deviation: Mapping[str, float]) -> Floats:
        shape = np.ones_like(self.f_hz)
        for i, corner in enumerate(self.belief.airframe.wing.gust.corners_hz):
            if corner:
                shape /= 1.0 + (self.f_hz / (corner * np.exp(deviation.get(f"corner{i}", 0.0)))) ** 2
        return shape

    def _linear(self, wing: WingModel, effects: Sequence[Effect], deviation: Mapping[str, float]) -> _Linear:
        structure = wing.structure
        omega = 2.0 * np.pi * self.f_hz
        receptance = _receptance(structure.stiffness_radps2, structure.damping_radps, self.f_hz)
        sides = list(self.seen.sides)
        seen = -(omega**2)[:, None, None] * structure.lift[sides]
        gains = [self._response(side, effects, deviation) for side in sides]
        noise = np.array([self._noise(side, deviation) for side in sides])
        load = self._load(structure.slots, effects, deviation)
        return _Linear(receptance, load, seen * np.stack(gains, 1)[..., None], noise)

    def _slope(self, wing: WingModel, effects: Sequence[Effect]) -> Complexes:
        """Slope of either camera per modal deflection, (f, 2, n)."""
        omega = 2.0 * np.pi * self.f_hz
        follows = [_steady_view(effects, side) for side in Side]
        gains = np.stack([view.slope_gain / (1.0 + 1j * omega * view.lag_s) for view in follows], 1)
        return np.asarray(gains[..., None] * wing.structure.slope_radpm)

    def _load(self, slots: tuple[int, ...], effects: Sequence[Effect], deviation: Mapping[str, float]) -> Complexes:
        names = ("symmetric", "antisymmetric", "second_symmetric", "second_antisymmetric")
        believed = len(self._level)
        level = np.empty(len(slots))
        for i, slot in enumerate(slots):
            # a mode that an effect has added is loaded like the first of its symmetry
            k, name = (i, names[slot]) if i < believed else (slot % 2 if believed > 1 else 0, names[slot % 2])
            level[i] = self._level[k] * np.exp(2.0 * deviation.get(f"{name}.level", 0.0))
        load = np.zeros((len(self.f_hz), len(slots), len(slots)), dtype=np.complex128)
        load[:, range(len(slots)), range(len(slots))] = self._load_shape(deviation)[:, None] * level
        for effect in effects:
            gain = effect.load_gain(self.f_hz, len(slots))
            if gain is not None:
                load = gain @ load @ _adjoint(gain)
        return load

    def _response(self, side: Side, effects: Sequence[Effect], deviation: Mapping[str, float]) -> Complexes:
        name = side.name.lower()
        delay_s = deviation.get(f"{name}.delay_s", 0.0)
        gain = (1.0 + deviation.get(f"{name}.scale", 0.0)) * np.exp(-2j * np.pi * self.f_hz * delay_s)
        gain *= _butterworth(self.f_hz, self.belief.airframe.sensor(_STATIONS[side]).lowpass_accel_hz)
        for effect in effects:
            own = effect.response(_STATIONS[side], self.f_hz)
            gain = gain if own is None else gain * own
        return np.asarray(gain)

    def _noise(self, side: Side, deviation: Mapping[str, float]) -> float:
        density = self.belief.airframe.sensor(_STATIONS[side]).accel_noise_mps2_rthz
        return float(0.5 * density**2 * np.exp(2.0 * deviation.get(f"{side.name.lower()}.noise", 0.0)))

    def _straighten(self, effects: Sequence[Effect]) -> Complexes:
        """Undo, to first order, what effects do to samples that no linear response describes."""
        bent = [effect for effect in effects if type(effect).response is Effect.response and _acts_on_samples(effect)]
        if not bent:
            return self._spectrum
        up, t_s = self.seen.up_mps2, self.seen.t_s
        for effect in bent:
            change = np.stack([self._sampled(effect, side, t_s, up[:, i]) for i, side in enumerate(self.seen.sides)], 1)
            change -= up
            if type(effect).sample_time is Effect.sample_time:
                # its linear part is a scale, which is free
                change -= up @ np.linalg.lstsq(up, change, rcond=None)[0]
            up = up - change
        return np.asarray(np.fft.rfft(up, axis=0))

    def _sampled(self, effect: Effect, side: Side, t_s: Floats, up: Floats) -> Floats:
        """What a station would have shown of ``up`` with the effect in force."""
        shown = up
        if type(effect).sample_time is not Effect.sample_time:
            # what is shown at t is taken back to where it belongs: up - (shown - up) is up at the mirrored instant
            shown = 2.0 * up - self._at(np.fft.rfft(up), 2.0 * t_s - effect.sample_time(_STATIONS[side], t_s))
        values = np.zeros((len(up), 6))
        values[:, 2] = -GRAVITY_MPS2 - shown
        return np.asarray(-GRAVITY_MPS2 - effect.sense(_STATIONS[side], t_s, values)[:, 2])

    def _push(self, wing: WingModel, parts: Sequence[Part], q: Floats, qdot: Floats) -> Complexes | None:
        """Spectrum of the forces that depend on state or time, their linear part taken out, (f, n)."""
        total = np.zeros_like(q)
        pushed = False
        for part in parts:
            if type(part.effect).force is Effect.force:
                continue
            force = self._force(wing, part, q, qdot)
            if force is None:
                continue
            pushed = True
            other = self._force(wing, part, q[:, ::-1], qdot[:, ::-1])
            both = self._force(wing, part, q + q[:, ::-1], qdot + qdot[:, ::-1])
            assert other is not None
            assert both is not None
            # what is linear and only swings in time about the middle of the recording has no steady part to take out
            swings = np.allclose(both, force + other, rtol=1e-7, atol=1e-9 * float(np.abs(both).max()))
            total += force if swings else _without_linear(force, q, qdot)
        return np.asarray(np.fft.rfft(total, axis=1).T) if pushed else None

    def _force(self, wing: WingModel, part: Part, q: Floats, qdot: Floats) -> Floats | None:
        t_s: Any = self.seen.t_s - self.seen.centre_s
        static = np.zeros((wing.count, 1))
        motion = ModalMotion(t_s, q, qdot, static, 1.0, wing.structure, self._covariate(part.channel))
        return part.effect.force(motion)

    def _covariate(self, channel: str) -> Floats:
        values = self.seen.covariates.get(channel)
        return np.zeros(len(self.seen.up_mps2)) if values is None else values

    def _toe(
        self,
        wing: WingModel,
        effects: Sequence[Effect],
        deviation: Mapping[str, float],
        slopes: Complexes,
        modal: Complexes,
    ) -> tuple[Floats, Floats]:
        toe = self.seen.toe
        if toe is None:
            return np.zeros(0), np.zeros(0)
        expected = np.zeros(len(toe.t_s))
        rate = np.zeros(len(toe.t_s))
        baseline_m = focal = rotation = jitter_s = 0.0
        for side in Side:
            view = _steady_view(effects, side)
            slope = np.sum(slopes[:, side] * modal, axis=1)
            at_s = toe.t_s + view.exposure_delay_s
            expected += self._at(slope, at_s) + view.slope_gain * self._static(wing, side, at_s)
            if view.jitter_s:
                rate += self._at(slope * 2j * np.pi * self.f_hz, at_s)
            sign = 1.0 if side is Side.RIGHT else -1.0
            baseline_m += sign * float(view.shift_m[1])
            rotation += sign * float(view.rotation_rad[1])
            focal += 0.5 * (view.focal_ratio - 1.0)
            jitter_s = max(jitter_s, view.jitter_s)
        expected += rotation + deviation.get("toe_rad", 0.0)
        whole = self.baseline_m * toe.inverse_m
        expected += (focal + deviation.get("focal", 0.0)) * (whole + expected) + baseline_m * toe.inverse_m
        residual = toe.toe_rad - expected
        if not toe.has_reference:
            residual = residual - residual.mean()
        noise = self.belief.match_sigma_rad() * np.exp(deviation.get("match", 0.0))
        return residual, noise**2 + (jitter_s * rate) ** 2

    @property
    def baseline_m(self) -> float:
        """Believed distance of the cameras."""
        left, right = self.belief.airframe.left_camera, self.belief.airframe.right_camera
        assert left is not None
        assert right is not None
        return right.position_m[1] - left.position_m[1]

    def _static(self, wing: WingModel, side: Side, at_s: Floats) -> Floats:
        structure = wing.structure
        load = np.interp(at_s, self.seen.t_s, self.seen.load_factor) - 1.0
        bend = structure.static_trim_m[:, None] + structure.static_per_g_m[:, None] * load
        return np.asarray(structure.slope_radpm[side] * np.array([1.0]) @ bend)

    def _toe_posterior(self, slope: Complexes, motion: _Motion) -> Floats:
        """Covariance of the toe that the accelerations leave, (k, k)."""
        if self.seen.toe is None:
            return np.zeros((0, 0))
        linear = motion.linear
        row = slope.sum(1)[:, None, :]
        prior = linear.receptance @ linear.load @ _adjoint(linear.receptance)
        left = (row @ (prior - motion.smoother @ _adjoint(motion.cross)) @ _adjoint(row))[:, 0, 0].real
        left[0] = 0.0  # the constant part is trim and toe, which are parameters
        m = _FINER * len(self.seen.up_mps2)
        lags = np.fft.irfft(np.maximum(left, 0.0), m) * m * self.f_hz[1]
        apart = np.abs(np.subtract.outer(self.seen.toe.t_s, self.seen.toe.t_s))
        # periodic like the transform, which keeps it positive definite
        return np.asarray(np.interp(apart, np.arange(m) * (self._dt_s / _FINER), lags))

    def _rest(self, effects: Sequence[Effect], deviation: Mapping[str, float]) -> tuple[Floats, Floats]:
        shown = self.seen.mean_force_mps2.copy()
        for i, side in enumerate(self.seen.sides):
            name = side.name.lower()
            shown[i] -= deviation.get(f"{name}.bias_mps2", 0.0) - GRAVITY_MPS2 * deviation.get(f"{name}.scale", 0.0)
            shown[i] -= sum(effect.bias(_STATIONS[side]) for effect in effects)
        # without a root sensor the mean load factor itself is in doubt, on both sides alike
        doubt = 1e-3 if self.seen.has_root else 3e-3 * GRAVITY_MPS2
        return shown, np.full(len(shown), doubt**2)

    # ------------------------------------------------------------------------------------------- transforms

    def _in_time(self, spectrum: Complexes) -> Floats:
        return np.asarray(np.fft.irfft(spectrum, len(self.seen.up_mps2), axis=0).T)

    def _at(self, spectrum: Complexes, at_s: Floats) -> Floats:
        """A band-limited signal at any instants: fine grid by zero padding, then a straight line."""
        m = _FINER * len(self.seen.up_mps2)
        fine = np.fft.irfft(spectrum, m) * _FINER
        return np.asarray(np.interp(at_s - self.seen.start_s, np.arange(m) * (self._dt_s / _FINER), fine))

    def _tapered(self, spectrum: Complexes) -> Complexes:
        in_time = np.fft.irfft(spectrum, len(self._taper), axis=0) * self._taper[:, None]
        return np.asarray(np.fft.rfft(in_time, axis=0)[self.band] * self._norm)


def with_values(part: Part, values: Mapping[str, float]) -> Part:
    """The same effect with other values."""
    return dataclasses.replace(part, effect=type(part.effect).from_values(dict(values)))


def _without_linear(force: Floats, q: Floats, qdot: Floats) -> Floats:
    """A force without what is linear in the state: that is stiffness or damping, which are free."""
    basis = np.vstack([q, qdot])
    gram = basis @ basis.T
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    weights = np.linalg.lstsq(gram / np.outer(scale, scale), (basis / scale[:, None]) @ force.T, rcond=1e-9)[0]
    return np.asarray(force - (weights / scale[:, None]).T @ basis)


def _of_range(name: str) -> bool:
    """Whether a nuisance concerns the ranges or the sensors at rest alone."""
    return name in _RANGE_ONLY or name.endswith((".slope", ".bias_mps2"))


def _acts_on_samples(effect: Effect) -> bool:
    return type(effect).sense is not Effect.sense or type(effect).sample_time is not Effect.sample_time


def _steady_view(effects: Sequence[Effect], side: Side) -> CameraView:
    return viewed(effects, side, 0.0)


def _receptance(stiffness: Floats, damping: Floats, f_hz: Floats) -> Complexes:
    omega = 2.0 * np.pi * f_hz[:, None, None]
    return _inverse(np.asarray(stiffness - omega**2 * np.eye(len(stiffness)) + 1j * omega * damping))


def _adjoint(matrix: Complexes) -> Complexes:
    return np.asarray(matrix.conj().swapaxes(-1, -2))


def _inverse(matrix: Complexes) -> Complexes:
    """Of many small matrices; written out for two, the common case, which is several times faster."""
    if matrix.shape[-1] != 2:
        return np.asarray(np.linalg.inv(matrix), dtype=np.complex128)
    a, b, c, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 0], matrix[:, 1, 1]
    share = 1.0 / (a * d - b * c)
    found = np.empty_like(matrix)
    found[:, 0, 0], found[:, 0, 1], found[:, 1, 0], found[:, 1, 1] = d * share, -b * share, -c * share, a * share
    return found


def _butterworth(f_hz: Floats, corner_hz: float) -> Complexes:
    if not corner_hz:
        return np.ones(len(f_hz), dtype=np.complex128)
    s = 1j * f_hz / corner_hz
    return np.asarray(1.0 / (1.0 + np.sqrt(2.0) * s + s * s))


def _tukey(count: int, share: float) -> Floats:
    window = np.ones(count)
    width = max(int(share * count), 1)
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(width) + 0.5) / width)
    window[:width], window[-width:] = ramp, ramp[::-1]
    return window
