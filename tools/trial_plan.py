"""Which blind trials are flown: what is hidden, how strong, at which noise, and how each recording is judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tools.trial_generators import FIRST, GENERATORS, STRANGER, Generator
from tools.trial_truths.cases import Hidden
from tools.trial_truths.strengths import IN_SAMPLES, SIGMA

STRONG = (8.0, 14.0)
_TOGETHER = 60
CURVE = (2.0, 4.0, 5.0, 6.0, 8.0)
_STRANGERS_TOGETHER = 10


@dataclass(frozen=True)
class Trial:
    """One recording and how it is judged.

    Attributes
    ----------
    kind : str
        single, pair, triple, curve, nothing, or outside (of the catalogue).
    label : Hidden
    snr_db : float
    corner_hz : float
        Of the believed gust; 0 is white.
    judged : tuple of bool
        With the whole catalogue (False), and with what is hidden taken from it (True).
    oracle : bool
        Whether the gain of the true effect is measured too.
    generator : str
        Who flies it.
    """

    kind: str
    label: Hidden
    snr_db: float = 20.0
    corner_hz: float = 0.0
    judged: tuple[bool, ...] = (False,)
    oracle: bool = False
    generator: str = FIRST.name

    @property
    def hand(self) -> Generator:
        """Who flies it."""
        return GENERATORS[self.generator]


def singles(
    rng: np.random.Generator,
    snr_db: float = 20.0,
    names: Sequence[str] = (*SIGMA, *IN_SAMPLES),
    strength: tuple[float, float] = STRONG,
    judged: tuple[bool, ...] = (False,),
    oracle: bool = False,
    kind: str = "single",
    hand: Generator = FIRST,
) -> list[Trial]:
    """One trial for every name."""
    return [
        Trial(kind, hand.hide([name], strength, rng, snr_db), snr_db, 0.0, judged, oracle, hand.name) for name in names
    ]


def several(
    rng: np.random.Generator, count: int, how_many: int, strength: tuple[float, float] = STRONG, hand: Generator = FIRST
) -> list[Trial]:
    """``how_many`` trials with ``count`` effects each, which no sample gives away."""
    kind = {2: "pair", 3: "triple"}[count]
    names = [name for name in hand.names if name not in IN_SAMPLES]
    return [
        Trial(
            kind, hand.hide(rng.choice(names, count, replace=False).tolist(), strength, rng, 20.0), generator=hand.name
        )
        for _ in range(how_many)
    ]


def nothing(
    rng: np.random.Generator, how_many: int, snr_db: float = 20.0, first: int = 0, hand: Generator = FIRST
) -> list[Trial]:
    """Recordings in which nothing is hidden; gusts white and coloured inside their specification."""
    corners = [hand.corners_hz[(first + k) % len(hand.corners_hz)] for k in range(how_many)]
    return [
        Trial("nothing", hand.hide([], STRONG, rng, snr_db), snr_db, corner, generator=hand.name) for corner in corners
    ]


def outside(rng: np.random.Generator, hand: Generator) -> list[Trial]:
    """One trial for everything that no catalogue has."""
    return [
        Trial("outside", hand.hide([name], STRONG, rng, 20.0), judged=(True,), generator=hand.name)
        for name in hand.outside
    ]


def strangers_acceptance(seed: int) -> list[list[Trial]]:
    """Trials that are promised of the other hand, 238 judgements in batches of ten, every kind from the first on."""
    rng = np.random.default_rng(seed)
    mixed = [
        *singles(rng, names=STRANGER.names, judged=(False, True), hand=STRANGER),
        *outside(rng, STRANGER),
        *outside(rng, STRANGER),
        *several(rng, 2, 20, hand=STRANGER),
        *nothing(rng, 100, hand=STRANGER),
    ]
    mixed = [mixed[i] for i in rng.permutation(len(mixed))]
    return [mixed[first : first + _STRANGERS_TOGETHER] for first in range(0, len(mixed), _STRANGERS_TOGETHER)]


def acceptance(seed: int) -> list[list[Trial]]:
    """Everything that the project promises, in batches that are flown together; every kind of trial from the first on.

    Only the bulk of the recordings in which nothing is hidden comes last.
    """
    rng = np.random.default_rng(seed)
    fitted = list(SIGMA)

    def some(count: int) -> list[str]:
        return list(rng.choice(fitted, count, replace=False).tolist())

    mixed = [
        *singles(rng, judged=(False, True), oracle=True),
        *singles(rng, judged=(False, True), oracle=True),
        *singles(rng, 10.0),
        *singles(rng, 30.0, some(20), judged=(True,)),
        *several(rng, 2, 25),
        *several(rng, 3, 10),
        *_curve(rng, some(12)),
        *nothing(rng, 120),
    ]
    mixed = [mixed[i] for i in rng.permutation(len(mixed))]
    batches = [mixed[first : first + _TOGETHER] for first in range(0, len(mixed), _TOGETHER)]
    return [*batches, *(nothing(rng, 90) for _ in range(2))]


def _curve(rng: np.random.Generator, names: Sequence[str]) -> list[Trial]:
    return [
        trial for strength in CURVE for trial in singles(rng, names=names, strength=(strength, strength), kind="curve")
    ]
