"""Messages made of output records: each row's rate, and whose turn a record takes."""

from __future__ import annotations

import dataclasses
from typing import Any, get_args

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.component import message_outputs
from companion.adapters.mavlink.component.message_outputs import MessageOutput, OutputPublisher
from companion.params.settings import Settings
from companion.records import CorrectedRange, Firing, OutputRecord, TriggerPlan

MS = 1_000_000  # ns
SETTINGS = Settings()


def a_range(at_ms: int, *, trusted: bool) -> CorrectedRange:
    return CorrectedRange(1, 1, at_ms * MS, 25, 40.0, 0.1, 0.004, 1e-4, 35.0, 50, trusted, None)


def a_plan(at_ms: int) -> TriggerPlan:
    return TriggerPlan(1, Firing.PEAK, (at_ms + 30) * MS, (at_ms + 40) * MS, 0, 0.5, (at_ms + 40) * MS, at_ms * MS)


def published(monkeypatch: pytest.MonkeyPatch, nothing: list[Any], ranges: list[CorrectedRange]) -> list[int | None]:
    """Boot times at which an encoder of trusted ranges sends at 10 Hz, ``nothing`` for an untrusted one; refusals."""

    def trusted_only(record: CorrectedRange, time_boot_ms: int) -> list[Any]:
        return [time_boot_ms] if record.trusted else nothing

    monkeypatch.setattr(message_outputs, "OUTPUTS", (MessageOutput(CorrectedRange, trusted_only, lambda _: 10.0),))
    publisher = OutputPublisher()
    return [message for record in ranges for message in publisher.messages(record, SETTINGS, 0)]


@pytest.mark.parametrize("nothing", [[], [None]], ids=["no message", "one that is refused"])
def test_a_record_that_says_nothing_takes_no_other_s_turn(monkeypatch: pytest.MonkeyPatch, nothing: list[Any]) -> None:
    ranges = [a_range(1000, trusted=False), a_range(1050, trusted=True)]
    assert published(monkeypatch, nothing, ranges) == [*nothing, 1050]


def test_a_row_keeps_its_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    ranges = [a_range(1000 + 50 * k, trusted=k != 2) for k in range(6)]
    assert published(monkeypatch, [], ranges) == [1000, 1150, 1250]


def test_refusals_keep_the_rate_of_their_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """A state that is not finite is counted as often as a finite one would be sent, not with every record."""
    ranges = [a_range(1000 + 20 * k, trusted=False) for k in range(11)]
    assert published(monkeypatch, [None], ranges) == [None] * 3


@pytest.mark.parametrize("offset_ns", [-(10**12), 50 * 86_400 * 10**9], ids=["before its boot", "fifty days after"])
def test_a_time_that_an_encoder_takes_as_it_is_fits_its_field(monkeypatch: pytest.MonkeyPatch, offset_ns: int) -> None:
    """An autopilot that restarted, or that has run longer than a uint32 of milliseconds."""

    def as_it_is(record: CorrectedRange, time_boot_ms: int) -> list[Any]:
        return [mavlink.MAVLink_named_value_float_message(time_boot_ms, b"range_m", record.range_m)]

    monkeypatch.setattr(message_outputs, "OUTPUTS", (MessageOutput(CorrectedRange, as_it_is, lambda _: 10.0),))
    (message,) = OutputPublisher().messages(a_range(1000, trusted=True), SETTINGS, offset_ns)
    assert message.pack(mavlink.MAVLink(None, 1, 191))
    assert message.time_boot_ms == (1000 + offset_ns // MS) % 2**32


def test_every_output_record_has_an_instant() -> None:
    """One without would be sent once, with the vehicle's boot for its time."""
    instants = set(message_outputs._STAMPS)
    kinds = get_args(OutputRecord)
    assert [kind for kind in kinds if not instants & {field.name for field in dataclasses.fields(kind)}] == []


def test_a_plan_is_stamped_when_it_was_made(monkeypatch: pytest.MonkeyPatch) -> None:
    row = MessageOutput(TriggerPlan, lambda record, time_boot_ms: [time_boot_ms], lambda _: 10.0)
    monkeypatch.setattr(message_outputs, "OUTPUTS", (row,))
    publisher = OutputPublisher()
    sent = [message for k in range(6) for message in publisher.messages(a_plan(1000 + 40 * k), SETTINGS, 5 * MS)]
    assert sent == [1005, 1125]
