"""When fits are held: from a sudden contradiction until the ringing has faded, and not for a wing that has changed."""

from __future__ import annotations

import numpy as np

from companion.core.tracking.blow import BlowWatch

STEP_S = 0.1
CALM = np.array([0.002, 0.001])


def _usual(nis: float) -> BlowWatch:
    watch = BlowWatch()
    for _ in range(200):
        assert not watch.update(nis, CALM, CALM, STEP_S)
    assert not watch.under_way
    return watch


def _lasts_s(watch: BlowWatch, nis: float, rms_ratio: float) -> tuple[float, bool]:
    """How long a contradiction with ringing is held, when both fade with a second, and whether it ended as a blow."""
    for step in range(1, 200):
        faded = float(np.exp(-step * STEP_S))
        over = watch.update(1.0 + nis * faded, CALM, CALM * (1.0 + rms_ratio * faded), STEP_S)
        if not watch.under_way:
            return step * STEP_S, over
    raise AssertionError("held for ever")


def test_fits_are_held_until_the_ringing_has_faded() -> None:
    watch = _usual(1.0)
    assert not watch.update(9.0, CALM, CALM, STEP_S)
    assert watch.under_way
    by_nis, over = _lasts_s(watch, 8.0, 0.0)
    assert over
    watch = _usual(1.0)
    watch.update(9.0, CALM, CALM, STEP_S)
    by_ringing, over = _lasts_s(watch, 8.0, 30.0)
    assert over
    assert 1.9 < by_nis < 2.3  # ln 8 s: NIS below twice the usual one
    assert 3.2 < by_ringing < 3.6  # ln 30 s: vibration below twice that before


def test_a_wing_that_has_changed_is_fitted_again_after_four_seconds_though_it_contradicts_on() -> None:
    watch = _usual(1.0)
    held = [watch.under_way for _ in range(300) if not watch.update(6.0, CALM, CALM, STEP_S)]
    assert len(held) == 300  # no blow that faded
    assert 4.0 <= sum(held) * STEP_S < 4.3
    assert not any(held[50:])


def test_a_model_that_explains_a_little_too_little_all_the_time_holds_nothing() -> None:
    watch = _usual(1.6)
    for _ in range(300):
        assert not watch.update(2.8, CALM, CALM, STEP_S)
        assert not watch.under_way
