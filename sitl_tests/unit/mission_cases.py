"""A vehicle for tests of the missions: what it says is the test's, what is ordered of it is kept."""

from __future__ import annotations

import json
import types
from threading import Event
from typing import Any

from mission_scripts.common.guard import Guard, Limits
from mission_scripts.common.outcome import Response
from mission_scripts.common.places import Place
from mission_scripts.common.vehicle import LOITER, RTL
from mission_scripts.common.watch import Watch

HERE = Place(47.0, 8.0)
DISARM = -1
"""Stands for the order to disarm among the modes that are ordered."""


def heard(watch: Watch, name: str, component: int = 1, **fields: Any) -> None:
    watch.take(types.SimpleNamespace(message_name=name, component_id=component, fields_json=json.dumps(fields)))


def flying(height_m: float = 60.0, mode: int = 10, battery: int = 80, status: int = 4, base: int = 217) -> Watch:
    watch = Watch(191, 25)
    heard(watch, "HEARTBEAT", custom_mode=mode, base_mode=base, system_status=status, type=1, autopilot=3)
    heard(
        watch, "GLOBAL_POSITION_INT", lat=470000000, lon=80000000, relative_alt=round(height_m * 1000), time_boot_ms=0
    )
    heard(watch, "SYS_STATUS", battery_remaining=battery)
    return watch


def guard(watch: Watch, **limits: float) -> Guard:
    watching = Guard(watch, Limits(**{"link_s": 60.0, **limits}), Event(), HERE)
    watching.mode = 10
    return watching


def engaged(watch: Watch) -> tuple[Any, list[int]]:
    """A flight that was commanded, whose vehicle obeys, and the modes that are ordered of it."""
    orders: list[int] = []

    def order(mode: int) -> None:
        orders.append(mode)
        heard(watch, "HEARTBEAT", custom_mode=mode, base_mode=217, system_status=4, type=1, autopilot=3)

    said: list[str] = []
    vehicle = types.SimpleNamespace(hold=lambda: order(LOITER), return_home=lambda: order(RTL), disarm=lambda: disarm())

    def disarm() -> None:
        orders.append(DISARM)
        heard(watch, "HEARTBEAT", custom_mode=watch.mode, base_mode=89, system_status=3, type=1, autopilot=3)

    options = types.SimpleNamespace(on_abort=Response.HOLD)
    flight = types.SimpleNamespace(
        engaged=True, stands=False, watch=watch, guard=guard(watch), vehicle=vehicle, options=options,
        say=said.append, said=said, hear=lambda: None, where=lambda: "here",
    )  # fmt: skip
    return flight, orders
