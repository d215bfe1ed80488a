"""The tracker follows the rate that streams really have, and is not misled by loss or by a short silence."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from companion.core.pipeline import start, step
from companion.core.rate_monitor import StreamRateMonitor
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Axis, ClockName, ImuBatch, ModeState, Notice, Station, Tick, Validity
from sitl_tests.unit import tracking_samples
from sitl_tests.unit.pipeline_flight import S, inputs, run
from sitl_tests.unit.tracking_samples import plain_airframe, swinging

AIRFRAME = load_airframe("nadir-2m")
TOO_LATE = "left samples come later than TRK_WINDOW: not used"
WRONG = dataclasses.replace(AIRFRAME, left=dataclasses.replace(AIRFRAME.left, rate_hz=100.0))


def settled_on(t_s: np.ndarray, rng: np.random.Generator | None = None, loss: float = 0.0) -> list[float]:
    """Rates that a left node's samples at these instants would have the tracker adopt."""
    delivery, rates_hz = StreamRateMonitor(), []
    for window_s in np.array_split(t_s, max(len(t_s) // 20, 1)):
        received_s = window_s if rng is None else window_s[rng.random(len(window_s)) >= loss]
        if len(received_s):
            t_ns = np.round(received_s * S).astype(np.int64)
            values = np.zeros((len(t_ns), 6))
            delivery.note(ImuBatch(Station.LEFT, ClockName.NODE_LEFT, t_ns, values, Axis.ALL, int(t_ns[-1])))
        rates_hz += [rate for _, rate in delivery.changed(AIRFRAME)]
    return rates_hz


@pytest.mark.parametrize("rate_hz", [40.0, 250.0, 2000.0])
def test_another_rate_is_adopted_once_it_has_settled(rate_hz: float) -> None:
    rates_hz = settled_on(np.arange(0.0, 9.0, 1.0 / rate_hz))
    assert rates_hz
    assert rates_hz[0] == pytest.approx(rate_hz, rel=0.02)


def test_the_believed_rate_stays_under_loss_jitter_and_silence() -> None:
    t_s, rng = np.arange(0.0, 20.0, 0.001), np.random.default_rng(1)
    assert AIRFRAME.left.rate_hz == 1000.0
    assert settled_on(t_s) == []
    assert settled_on(t_s, rng, loss=0.4) == []
    assert settled_on(np.sort(t_s + rng.uniform(0, 0.004, len(t_s)))) == []
    assert settled_on(t_s[(t_s < 5.0) | (t_s > 6.5)]) == []
    assert settled_on(np.concatenate([t_s[:4000], np.arange(4.0, 5.0, 0.01), t_s[5000:]])) == [], "for a second only"


def test_stamps_in_steps_or_bursts_are_no_other_rate() -> None:
    t_s = np.arange(0.0, 12.0, 0.001)
    assert settled_on(np.floor(t_s * 500.0) / 500.0) == [], "steps of 2 ms"
    assert settled_on(np.floor(t_s * 200.0) / 200.0 + 5e-5 * (np.arange(len(t_s)) % 5)) == [], "bursts of five"


def _stand_still(stamps_ns: np.ndarray, seconds: int) -> Iterator[ImuBatch]:
    """Batches of these stamps for so long, 25 a second."""
    for number in range(25 * seconds):
        values = np.zeros((len(stamps_ns), 6))
        received_ns = 10 * S + 40_000_000 * number
        yield ImuBatch(Station.LEFT, ClockName.NODE_LEFT, stamps_ns + number, values, Axis.ALL, received_ns)


def test_stamps_that_stand_still_fill_no_memory() -> None:
    """However long the flight is: a clock that stands, or that counts nanoseconds for milliseconds."""
    state = start(AIRFRAME, Settings())
    for batch in _stand_still(np.full(4, 5 * S, np.int64), 150):
        state, _ = step(state, batch)
        state, _ = step(state, Tick(batch.received_host_ns))
    alignment = state.unsynced_nodes._alignments[ClockName.NODE_LEFT]
    assert len(state.rate_monitor._windows[Station.LEFT].stamps) <= 251
    assert len(alignment._node.stamps) == len(alignment._node.values) <= 1601
    assert len(alignment._arrivals) <= 1601


def test_a_restarted_clock_is_no_other_rate() -> None:
    assert settled_on(np.concatenate([np.arange(90.0, 93.0, 0.001), np.arange(0.0, 7.0, 0.001)])) == []


@pytest.mark.slow
def test_a_wrongly_believed_rate_is_told_and_tracked_with() -> None:
    driven = run(inputs(), airframe=WRONG)
    (notice,) = [record for record in driven.of(Notice) if "comes at" in record.text]
    assert notice.text == "left comes at 1000 Hz, not 100: tracker restarted"
    assert driven.state.airframe.left.rate_hz == pytest.approx(1000.0, rel=0.01)
    assert driven.of(ModeState)[-1].validity in (Validity.TRACKING, Validity.SETTLING)


@pytest.mark.parametrize(("late_ms", "said"), [(20, set()), (200, {TOO_LATE})])
def test_a_station_whose_samples_come_too_late_is_named(late_ms: int, said: set[str]) -> None:
    """They are refused, and counted; nobody would know which station's."""
    state, texts = start(plain_airframe(), Settings(), hub=ClockName.HOST), set()
    t_ns, values = swinging(3.0, 0.004)
    for first in range(0, len(t_ns) - 40, 40):
        now_ns = int(t_ns[first + 39])
        for station in Station:
            begin = first - (late_ms if station is Station.LEFT else 0)
            if begin >= 0:
                sent = slice(begin, begin + 40)
                late = tracking_samples.batch(station, t_ns[sent], values[station][sent])
                step(state, dataclasses.replace(late, received_host_ns=now_ns))
        texts |= {each.text for each in step(state, Tick(now_ns))[1] if isinstance(each, Notice)}
    assert {text for text in texts if "TRK_WINDOW" in text} == said
