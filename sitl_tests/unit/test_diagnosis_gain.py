"""The fit over which a gain is measured, where no block foretells another's share of a term."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.diagnosis.selection import diagnosis
from companion.diagnosis.selection.block_bootstrap import share_gone
from companion.diagnosis.selection.recordings import SelectionPath

KICK, TONE = SimpleNamespace(key="kick"), SimpleNamespace(key="tone")


class _Recordings:
    """Recordings whose fits are their terms, and which count them."""

    def __init__(self) -> None:
        self.fitted: list[list[str]] = []

    def foretells(self, term: Any) -> bool:
        return bool(term.key != "kick")

    def fit(self, terms: Any, near: Any) -> Any:
        self.fitted.append([term.key for term in terms])
        return SimpleNamespace(terms=terms, near=near)


def _path(*terms: Any) -> Any:
    stages = tuple(SimpleNamespace(terms=terms[:count]) for count in range(len(terms) + 1))
    return SelectionPath(stages[-1], (), stages)  # type: ignore[arg-type]


@pytest.mark.parametrize("terms", [(TONE,), (KICK,)])
def test_a_gain_is_over_the_belief_where_all_terms_are_alike(terms: Any) -> None:
    recordings, path = _Recordings(), _path(*terms)
    assert diagnosis._base_of_gain(recordings, path) is path.stages[0]  # type: ignore[arg-type]
    assert not recordings.fitted


def test_beside_impulses_a_gain_is_over_a_belief_that_knows_them() -> None:
    recordings, path = _Recordings(), _path(KICK, TONE)
    assert diagnosis._base_of_gain(recordings, path) is path.stages[1]  # type: ignore[arg-type]
    assert not recordings.fitted, "the search had fitted it"
    later = _path(TONE, KICK)
    base: Any = diagnosis._base_of_gain(recordings, later)  # type: ignore[arg-type]
    assert recordings.fitted == [["kick"]]
    assert base.near is later.stages[0]


def test_of_nothing_held_out_nothing_is_gone() -> None:
    assert share_gone(np.zeros(20), np.zeros(20)) == (0.0, 0.0, 0.0)
    rare = np.array([1.0, 0.0, 0.0])  # some draws of the bootstrap hold none of it
    assert share_gone(rare, 0.5 * rare) == pytest.approx((0.5, 0.5, 0.5))
