"""Accelerations under a model: their spectrum, their residual, and the smoothed motion of the wing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from companion.core.wing.model import WingModel
from companion.core.wing.structure import Structure
from companion.diagnosis.data.transforms import Transforms
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.linear_spectra import Linear
from companion.diagnosis.model.nonlinear_correction import SensorLineariser, StatisticalLinearisation
from companion.diagnosis.spectral_matrices import adjoint, apply, cholesky, full, inverse, product
from companion.records import Complexes, Floats

_PASSES = 2  # chosen: of smoothing and nonlinear correction in turn: a third moves little
_FADED = 0.3  # least fade by which the smoothed motion is divided: its errors grow alike (choice)


@dataclass(frozen=True, slots=True)
class RecordedSpectra:
    """Data that all models of a recording share: ``recorded`` is its spectrum, periodic from 0 or tapered in band.

    ``onset`` (f,) is the share of the smoother's gain that is taken at each frequency.
    """

    lineariser: SensorLineariser
    transforms: Transforms
    low: int
    recorded: tuple[Complexes, Complexes]
    onset: Floats


@dataclass(frozen=True, slots=True)
class _Forces:
    """Forces of state and time on a motion (n, m each): linearisation, and the spectrum of its residual (n, f).

    The motion is None where nothing acts but laws that follow none.
    """

    motion: tuple[Floats, Floats] | None
    sigma_m: float
    linearised: StatisticalLinearisation
    rest: Complexes | None


class SmoothedMotion:
    """Accelerations and smoothed motion under one model; slow parts are computed once, when they are needed.

    ``key`` equals another's where the two models are the same here; ``measured_mps2`` (n, m) are modal loads that were
    recorded, ``leaked_mps2`` (c, m) motion of the rigid aircraft in the accelerations. Frequencies run from 0 to the
    top of the band, which begins at index ``low``. With ``neighbour``, the model before one step of a difference
    quotient, forces act on its motion: the change of motion by the step is of second order in them.
    """

    def __init__(
        self,
        key: object,
        wing: WingModel,
        terms: Sequence[EffectTerm],
        grid: RecordedSpectra,
        linear_of: Callable[..., Linear],
        measured_mps2: Floats | None = None,
        leaked_mps2: Floats | None = None,
        neighbour: SmoothedMotion | None = None,
    ) -> None:
        self.key = key
        self._wing, self._terms = wing, tuple(term for term in terms if term.effect.forces_modes())
        self._forces: _Forces | None = None
        self._grid, self._transforms, self._low = grid, grid.transforms, grid.low
        effects = tuple(term.effect for term in terms)
        self._up_mps2, scale = grid.lineariser.corrected_mps2(effects)
        if leaked_mps2 is not None:
            self._up_mps2 = self._up_mps2 - leaked_mps2
        self._bent = self._up_mps2 is not grid.lineariser.recorded_mps2
        self._measured = None if measured_mps2 is None else grid.transforms.spectrum(measured_mps2)
        self._deterministic_load: Complexes | None = self._measured
        shared = None if neighbour is None else neighbour.forces_on(wing, self._terms)
        if shared is not None:
            self._apply(shared, lambda structure, filtered: linear_of(structure, scale, filtered))
            return
        self._take(linear_of(wing.structure, scale))
        if self._terms:
            self._linearise(lambda structure, filtered: linear_of(structure, scale, filtered))

    def _take(self, linear: Linear) -> None:
        """Spectra of what is seen under a linear model."""
        self.linear, self._top = linear, linear.sensing.shape[-1]
        low = self._low
        per_load = product(linear.sensing, linear.receptance)
        loaded = product(per_load, linear.load)
        self.cross = adjoint(product(loaded, adjoint(linear.receptance)))  # (n, c, f): q with what is seen
        self.spectrum = product(loaded[..., low:], adjoint(per_load[..., low:]))
        self.spectrum += linear.noise[..., low:]
        self.inverse = inverse(self.spectrum)

    def _linearise(self, linear_of: Callable[[Structure, Complexes | None], Linear]) -> None:
        """Add the linear part of forces to stiffness and damping, and keep the rest to be taken out of the data.

        A second pass has the motion by the rest of the first: a wing that is softer one way sags with its amplitude.
        Kicks and lines follow no motion, and need none.
        """
        if all(term.effect.transient or type(term.effect).additive for term in self._terms):
            still = np.zeros((self._wing.count, self._transforms.count))
            forces = self._forces_on_motion(self._wing, self._terms, (still, still), 0.0)
            self._add(replace(forces, motion=None))
            return
        for _ in range(_PASSES):
            smoother = self._smoother()
            motion, sigma_m = self._smoothed(smoother), self._posterior_sigma_m(smoother)
            self._apply(self._forces_on_motion(self._wing, self._terms, motion, sigma_m), linear_of)

    def _apply(self, forces: _Forces, linear_of: Callable[[Structure, Complexes | None], Linear]) -> None:
        """Forces in the linear model: mean slopes as stiffness and damping, their residual as a load."""
        structure, linearised = self._wing.structure, forces.linearised
        stiffness = structure.stiffness_radps2 - linearised.per_q
        damping = structure.damping_radps - linearised.per_qdot
        lasting = 0.0 if linearised.filtered is None else np.einsum("iif->if", linearised.filtered)[:, 0].real
        if np.any(np.diag(stiffness) <= lasting) or np.any(np.diag(damping) <= 0.0):
            raise ValueError("these forces make the wing unstable")
        effective = replace(structure, stiffness_radps2=stiffness, damping_radps=damping)
        self._take(linear_of(effective, linearised.filtered))
        self._add(forces)

    def _add(self, forces: _Forces) -> None:
        self._forces = forces
        if forces.rest is not None:
            self._deterministic_load = forces.rest if self._measured is None else forces.rest + self._measured

    def _forces_on_motion(
        self, wing: WingModel, terms: Sequence[EffectTerm], motion: tuple[Floats, Floats], sigma_m: float
    ) -> _Forces:
        linearised = self._grid.lineariser.linearise_forces(wing, terms, *motion, sigma_m)
        rest = self._transforms.spectrum(linearised.residual_mps2) if np.any(linearised.residual_mps2) else None
        return _Forces(motion, sigma_m, linearised, rest)

    def forces_on(self, wing: WingModel, terms: Sequence[EffectTerm]) -> _Forces | None:
        """Forces of a model beside this one, on the motion of this one; its own where they are the same.

        None where there are none to share: a law that acts here already may change the motion by its parameters. A
        mode that the step adds hardly takes part in the tips' motion yet.
        """
        forces, count = self._forces, len(self.modal)
        if not terms or count > wing.count or any(term not in terms for term in self._terms):
            return None
        same = len(terms) == len(self._terms) and _alike(wing.structure, self._wing.structure)
        if forces is not None and same:
            return forces if count == wing.count else _with_modes(forces, wing.count - count)
        if count < wing.count:
            return None
        if forces is None or forces.motion is None:
            return self._forces_on_motion(wing, terms, self.in_time, self._posterior_sigma_m(self.smoother))
        return self._forces_on_motion(wing, terms, forces.motion, forces.sigma_m)

    @cached_property
    def smoother(self) -> Complexes:
        """Modal deflection per acceleration seen, (n, c, f), zero below the band."""
        return self._smoother()

    @property
    def unknown(self) -> Complexes:
        """Density of the deflection that the accelerations leave, (n, n, f), m^2/Hz."""
        return self._unknown(self.smoother)

    @cached_property
    def whitener(self) -> Complexes:
        """Lower triangular L with L L^H the inverse spectrum: L^H whitens, (c, c, b)."""
        return cholesky(self.inverse)

    @cached_property
    def modal(self) -> Complexes:
        """Spectrum of the smoothed modal deflection, (n, f)."""
        return self._modal(self.smoother)

    @cached_property
    def residual(self) -> Complexes:
        """Tapered spectrum in the band of what is left once nonlinear sensors and forces are out, (c, b)."""
        if self._deterministic_load is None and not self._bent:
            return self._grid.recorded[1]
        return self._transforms.tapered(self._unforced_mps2())[:, self._low : self._top]

    @cached_property
    def force_score(self) -> Complexes:
        """Score by a force on each mode, G^H S^-1 residual through the receptance, (n, f)."""
        path = adjoint(product(self.linear.sensing, self.linear.receptance))
        score = np.zeros(path.shape[::2], dtype=np.complex128)
        score[:, self._low :] = apply(path[..., self._low :], apply(self.inverse, self.residual))
        return score

    @cached_property
    def in_time(self) -> tuple[Floats, Floats]:
        """Smoothed modal deflection and speed, (n, m) each."""
        return self._smoothed(self.smoother)

    @property
    def forced_mps2(self) -> Complexes | None:
        """Spectrum of the accelerations by forces and measured loads, (c, f); None where there are none."""
        return None if self._deterministic_load is None else apply(self.linear.sensing, self._forced())

    def _modal(self, smoother: Complexes) -> Complexes:
        within = self._within(smoother)
        return within if self._deterministic_load is None else within + self._forced()

    def _within(self, smoother: Complexes) -> Complexes:
        """Spectrum of the smoothed deflection beside the forced one; it fades at the ends, (n, f)."""
        if self._deterministic_load is None and not self._bent:
            return apply(smoother, self._grid.recorded[0])
        unforced = self._transforms.periodic(self._unforced_mps2())
        return apply(smoother, self._transforms.spectrum(unforced)[:, : self._top])

    def _unforced_mps2(self) -> Floats:
        """Accelerations without sensors' nonlinearity and motion by forces and measured loads, (c, m)."""
        forced = self.forced_mps2
        return self._up_mps2 if forced is None else self._up_mps2 - self._transforms.in_time(forced)

    def _forced(self) -> Complexes:
        assert self._deterministic_load is not None
        return apply(self.linear.receptance, self._deterministic_load[:, : self._top])

    def _smoother(self) -> Complexes:
        gain = np.zeros_like(self.cross)
        gain[..., self._low :] = product(self.cross[..., self._low :], self.inverse)
        return gain * self._grid.onset

    def _unknown(self, smoother: Complexes) -> Complexes:
        """Density of what a smoother leaves; with a share o of Wiener's gain it explains o (2 - o) of what he does."""
        linear = self.linear
        prior = full(product(product(linear.receptance, linear.load), adjoint(linear.receptance)))
        return prior - (2.0 - self._grid.onset) * product(smoother, adjoint(self.cross))

    def _posterior_sigma_m(self, smoother: Complexes) -> float:
        """Standard deviation that a smoother leaves of either half's first-mode deflection, m."""
        unknown = self._unknown(smoother)
        density = sum(unknown[k, k, 1:].real for k in range(min(2, len(unknown))))
        return float(np.sqrt(2.0 * self._transforms.f_hz[1] * np.sum(np.maximum(density, 0.0))))

    def _smoothed(self, smoother: Complexes) -> tuple[Floats, Floats]:
        """Smoothed modal deflection (m) and speed (m/s), (n, m) each, divided by the fade at the ends."""
        omega = 2j * np.pi * self._transforms.f_hz[: self._top]
        within, gain = self._within(smoother), 1.0 / np.maximum(self._transforms.fading, _FADED)
        deflection, speed = (gain * self._transforms.in_time(spectrum) for spectrum in (within, within * omega))
        if self._deterministic_load is None:
            return deflection, speed
        forced = self._forced()
        return deflection + self._transforms.in_time(forced), speed + self._transforms.in_time(forced * omega)


def _alike(further: Structure, structure: Structure) -> bool:
    """Whether forces see no difference between a structure and one that may have further modes."""
    names = ("stiffness_radps2", "damping_radps", "lift", "slope_radpm")
    both = [(getattr(further, name), getattr(structure, name)) for name in names]
    return all(np.array_equal(first[: len(second), : structure.count], second) for first, second in both)


def _with_modes(forces: _Forces, more: int) -> _Forces:
    """Forces on a motion to which modes at rest are added, on which nothing acts."""

    def longer(values: Any) -> Any:
        """Rows that are modes, and columns where these are modes too."""
        widths = [(0, 0)] * values.ndim
        widths[0] = (0, more)
        if values.shape[:2] == (len(forces.linearised.per_q),) * 2:
            widths[1] = (0, more)
        return np.pad(values, widths)

    linearised = forces.linearised
    wider = StatisticalLinearisation(
        longer(linearised.per_q),
        longer(linearised.per_qdot),
        longer(linearised.residual_mps2),
        None if linearised.filtered is None else longer(linearised.filtered),
    )
    motion = None if forces.motion is None else (longer(forces.motion[0]), longer(forces.motion[1]))
    return _Forces(motion, forces.sigma_m, wider, None if forces.rest is None else longer(forces.rest))
