"""Kinds of response, and which of them the equation of motion fits.

A channel that is called a displacement and is an acceleration makes every coefficient wrong. It shows without a law:
the error of the force falls where the equation is written for what was recorded.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping

_CLEARER = 0.5  # of the stated kind's error: another kind with less is what was recorded (choice)
_POOR = 0.3  # of the force, from which the error of the stated kind is doubted (choice)


class ResponseKind(enum.IntEnum):
    """Time derivatives from the displacement to the response."""

    DISPLACEMENT = 0
    VELOCITY = 1
    ACCELERATION = 2

    @property
    def unit(self) -> str:
        """The unit at the end of a channel's name that says so."""
        return ("m", "mps", "mps2")[self]

    def __str__(self) -> str:
        return ("a displacement", "a velocity", "an acceleration")[self]

    @classmethod
    def of_channel(cls, name: str) -> ResponseKind:
        """The kind by the unit at the end of a channel's name, a displacement where none is there."""
        unit = name.rpartition("_")[2]
        return next((kind for kind in cls if kind.unit == unit), cls.DISPLACEMENT)


def another_kind(stated: ResponseKind, errors: Mapping[ResponseKind, float]) -> ResponseKind | None:
    """The kind of response that the error ratios name instead of the stated one, None: as stated."""
    kind = min(errors, key=lambda entry: errors[entry])
    clearer = errors[stated] > _POOR and errors[kind] < _CLEARER * errors[stated]
    return kind if clearer else None
