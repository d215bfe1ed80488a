"""What the accelerations say: their spectrum under a model, what is left of them, and the smoothed wing."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from companion.core.wing.model import WingModel
from companion.diagnosis.linear import Linear
from companion.diagnosis.matrices import Complexes, adjoint, apply, inverse, product, triangle
from companion.diagnosis.part import Part
from companion.diagnosis.straighten import Straightener
from companion.diagnosis.transforms import Transforms
from companion.records import Floats


class Motion:
    """One model's view of the accelerations; what is dear is made when it is asked for, once.

    ``key`` equals another's where the two models are the same here. Frequencies run from 0 to the top of the band,
    which begins at index ``low``.
    """

    def __init__(
        self,
        key: object,
        wing: WingModel,
        parts: Sequence[Part],
        linear: Linear,
        straightener: Straightener,
        transforms: Transforms,
        low: int,
        recorded: tuple[Complexes, Complexes],
    ) -> None:
        self.key, self.linear = key, linear
        self._transforms, self._low, self._recorded = transforms, low, recorded
        self._top = linear.seen.shape[-1]
        effects = tuple(part.effect for part in parts)
        self._up_mps2 = straightener.straight_mps2(effects)
        self._bent = self._up_mps2 is not straightener.recorded_mps2
        per_load = product(linear.seen, linear.receptance)
        loaded = product(per_load, linear.load)
        self.cross = adjoint(product(loaded, adjoint(linear.receptance)))  # (n, c, f): q with what is seen
        self.spectrum = product(loaded[..., low:], adjoint(per_load[..., low:]))
        self.spectrum[np.diag_indices(len(linear.noise))] += linear.noise[:, None]
        self.inverse = inverse(self.spectrum)
        self._push: Complexes | None = None
        if any(part.effect.forces_modes() for part in parts):
            push = straightener.push_mps2(wing, parts, *self._smoothed(self._modal_unforced))
            self._push = None if push is None else transforms.spectrum(push)[:, : self._top]

    @cached_property
    def smoother(self) -> Complexes:
        """Modal deflection per acceleration seen, (n, c, f), zero below the band."""
        found = np.zeros_like(self.cross)
        found[..., self._low :] = product(self.cross[..., self._low :], self.inverse)
        return found

    @cached_property
    def whitener(self) -> Complexes:
        """Lower triangular L with L L^H the inverse spectrum: L^H whitens, (c, c, b)."""
        return triangle(self.inverse)

    @cached_property
    def modal(self) -> Complexes:
        """Spectrum of the smoothed modal deflection, (n, f)."""
        if self._push is None:
            return self._modal_unforced
        left = self._straight - apply(self.linear.seen, self._forced)
        return np.asarray(apply(self.smoother, left) + self._forced)

    @cached_property
    def residual(self) -> Complexes:
        """Tapered spectrum in the band of what is left once crooked sensors and forces are out, (c, b)."""
        if self._push is None and not self._bent:
            return self._recorded[1]
        up = self._up_mps2
        if self._push is not None:
            up = up - self._transforms.in_time(apply(self.linear.seen, self._forced))
        return self._transforms.tapered(up)[:, self._low : self._top]

    @cached_property
    def in_time(self) -> tuple[Floats, Floats]:
        """Smoothed modal deflection and speed, (n, m) each."""
        return self._smoothed(self.modal)

    @cached_property
    def _straight(self) -> Complexes:
        if not self._bent:
            return self._recorded[0]
        return self._transforms.spectrum(self._up_mps2)[:, : self._top]

    @cached_property
    def _modal_unforced(self) -> Complexes:
        return apply(self.smoother, self._straight)

    @cached_property
    def _forced(self) -> Complexes:
        assert self._push is not None
        return apply(self.linear.receptance, self._push)

    def _smoothed(self, modal: Complexes) -> tuple[Floats, Floats]:
        omega = 2j * np.pi * self._transforms.f_hz[: self._top]
        return self._transforms.in_time(modal), self._transforms.in_time(modal * omega)
