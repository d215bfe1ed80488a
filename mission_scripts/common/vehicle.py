"""The vehicle over MAVSDK: connect, command, upload. Every order is acknowledged or raises; nothing is sent unasked."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from threading import Event
from typing import Any

from companion.params.links import LinkAddress
from mission_scripts.common.outcome import Aborted, Exit, MissionError, Refused
from mission_scripts.common.places import Place, Route
from mission_scripts.common.recording import Tap
from mission_scripts.common.sdk import Action, MavlinkDirect, MavlinkMessage, MissionRaw, log_subscribe, mavsdk
from mission_scripts.common.watch import AUTOPILOT, KINDS, Watch

GUIDED, AUTO, RTL, LOITER = 15, 10, 11, 12  # ArduPlane
_RESULTS = ("accepted", "temporarily rejected", "denied", "unsupported", "failed", "in progress", "cancelled")
# MAV_CMD (MAVLink common.xml)
_SET_MESSAGE_INTERVAL, _DO_CHANGE_SPEED, _DO_REPOSITION, _DO_SET_MODE = 511, 178, 192, 176
# ArduPlane takes these from the quaternion, and leaves yaw and throttle alone
_ROLL, _ROLL_AND_PITCH = 0b11111110, 0b11111100
_FIXED_WING, _ARDUPILOT = 1, 3  # MAV_TYPE, MAV_AUTOPILOT (MAVLink common.xml)
_RELATIVE_FRAME = 6  # MAV_FRAME_GLOBAL_RELATIVE_ALT_INT (MAVLink common.xml)
_TRIES = 3  # all orders of ours may be given twice
_LOOK_S = 0.5


class NotAccepted(MissionError):
    """The autopilot refused an order, or did not answer."""


class Vehicle:
    """One autopilot on one link.

    Parameters
    ----------
    link : LinkAddress
        To the autopilot.
    watch : Watch
        Told what is heard.
    tap : Tap, optional
        Given every frame.

    timeout_s : float
        For the autopilot to speak.
    interrupted : Event
        Ends the waiting for it.

    Raises
    ------
    Refused
        The link cannot be opened, or no autopilot spoke in time.
    """

    def __init__(self, link: LinkAddress, watch: Watch, tap: Tap | None, timeout_s: float, interrupted: Event) -> None:
        log_subscribe(lambda *_: True)  # its log would run through our progress lines
        kind = mavsdk.ComponentType.GROUND_STATION
        self._sdk = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(kind))
        try:
            self._system = self._open(link, tap, timeout_s, interrupted)
        except MissionError:
            self._sdk.destroy()
            raise
        self._action, self._missions = Action(self._system), MissionRaw(self._system)
        self._direct = MavlinkDirect(self._system)
        for name in KINDS:
            self._direct.subscribe_message(name, lambda message, _: watch.take(message))
        self._system_id = self._system.get_system_id()

    def _open(self, link: LinkAddress, tap: Tap | None, timeout_s: float, interrupted: Event) -> Any:
        on = mavsdk.ForwardingOption.ON
        result = self._sdk.add_any_connection_with_forwarding(link.mavsdk_url, on)
        if result != mavsdk.ConnectionResult.SUCCESS:
            raise Refused(f"--connect {link}: {mavsdk.ConnectionResult(result).name.lower().replace('_', ' ')}")
        if tap is not None:
            # what comes on one connection is forwarded to all others: to this one, whose bytes are ours
            self._sdk.add_any_connection_with_forwarding("raw://", on)
            self._sdk.subscribe_raw_bytes_to_be_sent(tap.take)
        system, ends_s = None, time.monotonic() + timeout_s
        while system is None and time.monotonic() < ends_s:
            if interrupted.is_set():
                raise Aborted("Ctrl-C", code=Exit.INTERRUPTED)
            system = self._sdk.first_autopilot(_LOOK_S)
        if system is None:
            raise Refused(f"no autopilot on {link} within {timeout_s:g} s: is it powered, and is the link free?")
        return system

    def close(self) -> None:
        """Release the link."""
        self._sdk.destroy()

    # ------------------------------------------------------------------------------------------ orders

    def command(self, what: str, number: int, *params: float) -> None:
        """Send a COMMAND_LONG and wait for its final acknowledgement; MAVSDK repeats it if it is lost."""
        values = [*params, *[0.0] * (7 - len(params))]
        fields = {f"param{index}": value for index, value in enumerate(values, 1)}
        self._acknowledged(what, "COMMAND_LONG", {"command": number, "confirmation": 0, **fields})

    def mode(self, what: str, number: int) -> None:
        """Change the flight mode (ArduPlane's number)."""
        self.command(what, _DO_SET_MODE, 1.0, float(number))

    def arm(self) -> None:
        """Arm."""
        self._try("arm", self._action.arm)

    def disarm(self) -> None:
        """Disarm; an autopilot that thinks that it flies refuses."""
        self._try("disarm", self._action.disarm)

    def hold(self) -> None:
        """Circle here (LOITER on ArduPlane)."""
        self._try("hold", self._action.hold)

    def return_home(self) -> None:
        """RTL."""
        self._try("return to launch", self._action.return_to_launch)

    def airspeed(self, airspeed_mps: float) -> None:
        """Change the airspeed in AUTO and GUIDED; refused outside the autopilot's own limits."""
        self.command(f"airspeed {airspeed_mps:g} m/s", _DO_CHANGE_SPEED, 0.0, airspeed_mps, -1.0)

    def circle_at(self, place: Place, height_m: float) -> None:
        """GUIDED about a place, at a height above home."""
        fields = {
            "command": _DO_REPOSITION, "frame": _RELATIVE_FRAME, "current": 0, "autocontinue": 0, "param1": -1.0,
            "param2": 1.0, "param3": 0.0, "param4": 0.0, "x": round(place.latitude_deg * 1e7),
            "y": round(place.longitude_deg * 1e7), "z": height_m,
        }  # fmt: skip
        self._acknowledged("reposition", "COMMAND_INT", fields)

    def attitude(self, roll_rad: float, pitch_rad: float | None) -> None:
        """Ask for roll and pitch in GUIDED; held for three seconds at most, so a lost link ends it by itself.

        Without a pitch the autopilot keeps its own (height and airspeed).
        """
        mask = _ROLL if pitch_rad is None else _ROLL_AND_PITCH
        pitch_rad = pitch_rad or 0.0
        cr, sr = math.cos(roll_rad / 2), math.sin(roll_rad / 2)
        cp, sp = math.cos(pitch_rad / 2), math.sin(pitch_rad / 2)
        fields = {
            "time_boot_ms": 0, "type_mask": mask, "q": [cr * cp, sr * cp, cr * sp, -sr * sp],
            "body_roll_rate": 0.0, "body_pitch_rate": 0.0, "body_yaw_rate": 0.0, "thrust": 0.0,
            "thrust_body": [0.0, 0.0, 0.0],
        }  # fmt: skip
        self._direct.send_message(self._message("SET_ATTITUDE_TARGET", fields))

    def ask_rate(self, number: int, period_s: float) -> bool:
        """Ask for a message at an interval; False if the autopilot will not."""
        try:
            self.command(f"rate of message {number}", _SET_MESSAGE_INTERVAL, float(number), period_s * 1e6)
        except NotAccepted:
            return False
        return True

    # ------------------------------------------------------------------------------------------ missions

    def upload(self, route: Route) -> None:
        """Replace the vehicle's mission."""
        self._try("mission upload", lambda: self._missions.upload_mission(route.items))

    def start(self, number: int = 1) -> None:
        """Fly the mission from an item on, in AUTO."""
        self.fly_item(number)
        self.mode("AUTO", AUTO)

    def fly_item(self, number: int) -> None:
        """Go on with this item."""
        self._try(f"mission item {number}", lambda: self._missions.set_current_mission_item(number))

    # ------------------------------------------------------------------------------------------ inside

    def _try(self, what: str, order: Callable[[], Any]) -> None:
        """Give an order; again if it timed out, for all of ours may be given twice."""
        for tries_remaining in reversed(range(_TRIES)):
            try:
                order()
                return
            except mavsdk.MavsdkError as error:
                result = getattr(error, "result", None)
                name = result.name.lower().replace("_", " ") if result else str(error)
                if name != "timeout" or not tries_remaining:
                    raise NotAccepted(f"{what}: {name}") from error

    def _acknowledged(self, what: str, kind: str, fields: dict[str, Any]) -> None:
        message = self._message(kind, fields)
        answers: list[Any] = []
        self._try(what, lambda: answers.append(self._direct.send_command(message)))
        result = int(json.loads(answers[0].fields_json)["result"])
        if result != 0:
            raise NotAccepted(f"{what}: {_RESULTS[result] if result < len(_RESULTS) else result}")

    def _message(self, name: str, fields: dict[str, Any]) -> Any:
        addressed = {"target_system": self._system_id, "target_component": AUTOPILOT, **fields}
        return MavlinkMessage(name, 0, 0, self._system_id, AUTOPILOT, json.dumps(addressed))


def check_kind(watch: Watch, timeout_s: float = 3.0) -> None:
    """Refuse what is no ArduPlane: the modes and the doublets are its own."""
    ends = time.monotonic() + timeout_s
    while watch.mode < 0 and time.monotonic() < ends:
        time.sleep(0.05)
    if watch.vehicle_type != (_FIXED_WING, _ARDUPILOT):
        kind, autopilot = watch.vehicle_type
        raise Refused(f"MAV_TYPE {kind} with MAV_AUTOPILOT {autopilot}: these missions are for ArduPlane (1 with 3)")
