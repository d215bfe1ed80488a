"""Comparison of a replay with what was published: identical, the same to rounding, or different, by field and time."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from companion.adapters.recordings.mcap.channels import CHANNELS
from companion.adapters.recordings.mcap.codec import plain_values
from companion.records import Record

ROUNDING_RATIO = 1e-6
"""Largest difference that counts as rounding, of a field's largest value so far: 0.06 mm of 60 m (choice)."""
_OFF_DIAGONAL = re.compile(r"(?P<field>.*covariance)\[(?P<row>\d+)\]\[(?P<column>\d+)\]")
_STAMP_SCALE = 1e9  # of integers that are stamps, ns: the ratio allows 1 us (choice)


@dataclass(slots=True)
class ReplayComparison:
    """Published outputs held against replayed ones, one by one.

    ``tolerance`` is the largest difference that is rounding: :data:`ROUNDING_RATIO` between two machines, 0 on an equal
    one. ``difference`` is the first one beyond it, or in anything that is no number: field, time and values.
    ``largest_ratio`` is the largest within it, relative to the largest value so far of its field, ``largest_field``.
    ``behind_loss`` says that the recorded outputs ended where something is missing.
    """

    tolerance: float = ROUNDING_RATIO
    compared: int = 0
    difference: str | None = None
    largest_ratio: float = 0.0
    largest_field: str = ""
    behind_loss: bool = False
    _first_ns: int | None = None
    _scales: dict[str, float] = field(default_factory=dict)

    @property
    def identical(self) -> bool:
        """Whether every bit agrees."""
        return self.difference is None and self.largest_ratio == 0.0

    def compare(self, recorded: Record | None, replayed: Record | None, *, lossy: bool = False) -> None:
        """Hold a replayed output against the recorded one.

        With ``lossy``, the recorded ones end where something is missing, and the replay's go on without them.
        """
        self.behind_loss |= lossy and recorded is None
        if self.behind_loss:
            return
        self.compared += 1
        if self.difference is not None:
            return
        if recorded is None or replayed is None or type(recorded) is not type(replayed):
            self.difference = f"output {self.compared}: recorded {recorded!r}, replayed {replayed!r}"[:2000]
            return
        for name, before, after in _leaves(type(recorded).__name__, plain_values(recorded), plain_values(replayed)):
            self._hold(name, before, after, self._at_s(recorded))

    def sentence(self) -> str:
        """The verdict."""
        if self.difference is not None:
            return "NOT as published"
        if self.identical:
            return "identical to what was published"
        return (
            f"same to rounding as what was published (largest relative difference {self.largest_ratio:.1e}, "
            f"{self.largest_field}; {self.tolerance:.0e} is allowed)"
        )

    def _hold(self, name: str, before: object, after: object, at_s: float) -> None:
        ratio = self._ratio(name, before, after)
        if ratio > self.tolerance and self.difference is None:
            self.difference = f"output {self.compared}, {at_s:.3f} s: {name} recorded {before!r}, replayed {after!r}"
        elif self.largest_ratio < ratio <= self.tolerance:
            self.largest_ratio, self.largest_field = ratio, f"{name} at {at_s:.3f} s"

    def _ratio(self, name: str, before: object, after: object) -> float:
        if isinstance(before, float) and isinstance(after, float):
            finite = [abs(value) for value in (before, after) if math.isfinite(value)]
            self._scales[name] = max([self._scales.get(name, 0.0), *finite])
            if before == after:
                return 0.0
            return abs(before - after) / self._scale(name) if len(finite) == 2 else math.inf
        if before == after:
            return 0.0
        if name.endswith("_ns") and isinstance(before, int) and isinstance(after, int):
            return abs(before - after) / _STAMP_SCALE
        return math.inf

    def _scale(self, name: str) -> float:
        """Largest value of a field so far; for a covariance what its two variances allow (Cauchy and Schwarz)."""
        entry = _OFF_DIAGONAL.fullmatch(name)
        if entry is None or entry["row"] == entry["column"]:
            return self._scales[name]
        variances = [self._scales.get(f"{entry['field']}[{at}][{at}]", 0.0) for at in (entry["row"], entry["column"])]
        return max(self._scales[name], math.sqrt(variances[0] * variances[1]))

    def _at_s(self, record: Record) -> float:
        at_ns = int(getattr(record, CHANNELS[type(record)].time))
        if self._first_ns is None:
            self._first_ns = at_ns
        return (at_ns - self._first_ns) * 1e-9


def _leaves(name: str, before: Any, after: Any) -> Iterator[tuple[str, object, object]]:
    """Entries of two trees of mappings and lists side by side; where their shapes part, the branches themselves."""
    if isinstance(before, dict) and isinstance(after, dict) and before.keys() == after.keys():
        for key in before:
            yield from _leaves(f"{name}.{key}", before[key], after[key])
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for i, (entry, other) in enumerate(zip(before, after, strict=True)):
            yield from _leaves(f"{name}[{i}]", entry, other)
    else:
        yield name, before, after
