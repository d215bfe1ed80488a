"""The bench of applied effects: flights whose ranges nobody would have published count for nothing."""

from __future__ import annotations

import math

import pytest

from tools.bench.apply import HeldOut, Row, table

CALM = HeldOut(
    "baseline-error", ("baseline-error",), True, ((5e-3, 1e-3), (1.1e-3, 1e-3), (1e-3, 1e-3), (5e-4, 5e-4)), 1800.0, 0.9
)
WITHHELD = HeldOut("baseline-error", (), True, ((math.nan, math.nan),) * 4, 1800.0, 0.0)


def test_a_flight_without_a_trusted_instant_moves_no_error() -> None:
    row = Row((CALM, WITHHELD))
    assert row.excess == pytest.approx(Row((CALM,)).excess) == pytest.approx(0.1)
    assert "45%" in table([row])


def test_flights_that_were_all_withheld_meet_no_target_and_say_so() -> None:
    row = Row((WITHHELD, WITHHELD))
    assert not row.good
    assert "nothing judged" in table([row])
