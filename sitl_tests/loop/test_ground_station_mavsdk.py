"""A MAVSDK client in this process lists, reads and sets our parameters over an air that loses a tenth of all frames."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.params.settings import tunables
from companion.records import ParameterChange
from sitl_tests.loop.ground_stations import COMPANION, STEP, SYSTEM, Air, S, Station

mavsdk = pytest.importorskip("mavsdk")
param = pytest.importorskip("mavsdk.plugins.param.param")
_CLASSIC = 0


class Sdk(Station):
    """MAVSDK as a ground station: our air carries its raw bytes, and the autopilot's heartbeat to it."""

    def __init__(self) -> None:
        super().__init__()
        self.greets = False
        kind = mavsdk.ComponentType.GROUND_STATION
        self.sdk = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(kind))
        self.sdk.add_any_connection("raw://")
        self.sdk.subscribe_raw_bytes_to_be_sent(lambda frame: self.outbox.append(bytes(frame)))
        self.beats = mavlink.MAVLink(None, SYSTEM, 1)
        self.beat_ns = 0

    def hear(self, message: Any, now_ns: int) -> None:
        super().hear(message, now_ns)
        self.sdk.pass_received_raw_bytes(bytes(message.get_msgbuf()))

    def turn(self, now_ns: int) -> None:
        if now_ns - self.beat_ns >= S:
            self.beat_ns = now_ns
            beat = mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
            self.sdk.pass_received_raw_bytes(bytes(beat.pack(self.beats)))


@contextlib.contextmanager
def in_real_time(air: Air) -> Iterator[None]:
    """Run simulated time with the real one, for a client that keeps its own."""
    stop = threading.Event()

    def run() -> None:
        while not stop.is_set():
            air.run(STEP / S)
            time.sleep(STEP / S)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def read(client: Any, name: str) -> float:
    """Ask again where a late refusal, of a set that was sent twice, passes for the answer to this question."""
    for _ in range(3):
        with contextlib.suppress(param.ParamError):
            return float(client.get_param_float(name))
    raise AssertionError(f"{name} is not told")


@pytest.mark.realtime
def test_mavsdk_lists_reads_and_sets_under_loss() -> None:
    station = Sdk()
    air = Air(station, loss=0.1)
    with in_real_time(air):
        system = station.sdk.first_autopilot(60.0)
        ends = time.monotonic() + 60.0
        while COMPANION not in system.component_ids() and time.monotonic() < ends:
            time.sleep(0.1)
        client = param.Param(system)
        # 4.1 reports "unknown" although the component is selected: the lists below are ours, not the autopilot's
        with contextlib.suppress(param.ParamError):
            client.select_component(COMPANION, _CLASSIC)
        listed = {entry.name: entry.value for entry in client.get_all_params().float_params}
        assert listed.keys() in ({row.name for row in tunables()}, {row.name.encode() for row in tunables()})
        for row in tunables():
            value = listed.get(row.name, listed.get(row.name.encode()))
            assert np.float32(value) == np.float32(row.default)
        client.set_param_float("TRG_RATE", 12.5)
        assert read(client, "TRG_RATE") == 12.5
        with pytest.raises(param.ParamError, match="VALUE_OUT_OF_RANGE"):
            client.set_param_float("TRG_RATE", 500.0)
        assert read(client, "TRG_RATE") == 12.5
    changes = [record for record in air.records if isinstance(record, ParameterChange)]
    assert [(change.name, change.value) for change in changes] == [("TRG_RATE", 12.5)]
    assert air.lost > 0
