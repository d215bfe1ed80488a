"""Terms of a model: named effects at some values."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from companion.core.wing.effect import Effect


@dataclass(frozen=True, slots=True)
class EffectTerm:
    """One named effect in a model, with the recorded channel that it follows, if any.

    ``log_trials`` is the logarithm of how many places were tried before it was begun where it was (look-elsewhere).
    Prior sigmas of its strengths are ``wider`` times the declared ones.
    """

    effect: Effect
    channel: str = ""
    log_trials: float = 0.0
    wider: float = 1.0

    @property
    def name(self) -> str:
        """The effect's stable name."""
        return self.effect.name

    @property
    def key(self) -> str:
        """A model holds each effect once."""
        return self.effect.name

    @property
    def values(self) -> list[float]:
        """Parameters of the effect, in the order in which it declares them."""
        return [float(getattr(self.effect, entry.name)) for entry in self.effect.parameters()]

    def with_values(self, values: Mapping[str, float]) -> EffectTerm:
        """The same effect with other values."""
        return dataclasses.replace(self, effect=type(self.effect).from_values(dict(values)))
