"""Whatever bytes a stranger sends to our component: no crash, no bad value, bounded answers."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.component import encode
from companion.adapters.mavlink.component.component import OnboardComponent
from companion.adapters.mavlink.component.parameter_server import ParameterServer
from companion.adapters.mavlink.decode.message_records import Heard
from companion.adapters.mavlink.link.dialect import ID_OF, build_message
from companion.params.settings import Settings, tunables
from sitl_tests.loop.ground_stations import COMPANION, MS, SYSTEM

KINDS = ("PARAM_SET", "PARAM_REQUEST_READ", "PARAM_REQUEST_LIST", "COMMAND_LONG", "COMMAND_INT", "HEARTBEAT")
NAMES = ("FILE_TRANSFER_PROTOCOL", *KINDS)
ROWS = list(tunables())


@pytest.mark.slow
@settings(deadline=None, max_examples=150)
@given(st.lists(st.tuples(st.sampled_from(NAMES), st.binary(max_size=255), st.booleans()), max_size=40))
def test_no_bytes_break_our_component(messages: list[tuple[str, bytes, bool]]) -> None:
    component = OnboardComponent(ParameterServer(Settings()))
    packer = mavlink.MAVLink(None, SYSTEM, COMPANION)
    now, sent = 0, 0
    for name, payload, ours in messages:
        message = build_message(ID_OF[name], payload)
        if ours and hasattr(message, "target_component"):
            message.target_system, message.target_component = SYSTEM, COMPANION
        component.hear(Heard(0, 255, 190, message, now), SYSTEM)
        now += 5 * MS
        for answer in component.due(now):
            assert encode.sendable(answer)
            assert answer.pack(packer)
            sent += 1
        component.events(now)
    # a command gives two messages at once; the rest is paced, one at a time
    assert sent <= 4 * len(messages)
    in_force = component.parameters.settings
    for row in ROWS:
        value = getattr(in_force, row.attribute)
        assert math.isfinite(value)
        assert row.check(value) is None
