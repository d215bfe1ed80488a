"""Traffic on the link: the newest message of each kind that matters, when it came, and every range."""

from __future__ import annotations

import json
import math
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from mission_scripts.common.places import Place

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1 (MAVLink common.xml)
KINDS = (
    "HEARTBEAT",
    "GLOBAL_POSITION_INT",
    "ATTITUDE",
    "VFR_HUD",
    "SYS_STATUS",
    "MISSION_CURRENT",
    "MISSION_ITEM_REACHED",
    "DISTANCE_SENSOR",
    "NAMED_VALUE_FLOAT",
    "TERRAIN_REPORT",
    "EXTENDED_SYS_STATE",
    "HOME_POSITION",
    "STATUSTEXT",
)
_NO_RANGE_QUALITY = 1  # DISTANCE_SENSOR.signal_quality: invalid (MAVLink common.xml)
_READY = (3, 4)  # MAV_STATE standby and active
_ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED (MAVLink common.xml)
_PREARM_CHECK = 1 << 28  # MAV_SYS_STATUS_PREARM_CHECK (MAVLink common.xml)
_UNKNOWN_HEADING = 65_535  # UINT16_MAX: GLOBAL_POSITION_INT's "unknown" (MAVLink common.xml)
_UNKNOWN_COVARIANCE = 255  # UINT8_MAX (MAVLink common.xml)
_RECENT_S, _LANDED_S = 2.0, 3.0
_MOST_RANGES = 20_000  # bound of memory: half an hour at 10 Hz
_LONGEST_CARRY_S = 2.0
_ON_GROUND = 1  # MAV_LANDED_STATE_ON_GROUND (MAVLink common.xml)


@dataclass(frozen=True, slots=True)
class Range:
    """One DISTANCE_SENSOR of the companion, with what the autopilot believed of itself when it came.

    ``sigma_m`` is NaN where nobody told it, ``least_m`` the least distance that can be told. ``trusted`` means a
    distance inside its own limits with a quality that says so; what it is then compared with is the mission's business.
    """

    at_s: float
    distance_m: float
    sigma_m: float
    trusted: bool
    height_m: float
    place: Place
    tilt_rad: float
    least_m: float = 0.0


class Watch:
    """Thread-safe store of what MAVSDK's callbacks bring. Times are of the monotonic clock, in seconds.

    Parameters
    ----------
    companion : int
        MAVLink component of the service.
    orientation : int
        MAV_SENSOR_ORIENTATION of its ranges.
    """

    def __init__(self, companion: int, orientation: int) -> None:
        self.companion, self.orientation = companion, orientation
        self.ranges: deque[Range] = deque(maxlen=_MOST_RANGES)
        self.texts: deque[str] = deque(maxlen=200)
        self.reached: set[int] = set()
        self.named: dict[str, tuple[float, float]] = {}
        self._newest: dict[str, tuple[float, dict[str, Any]]] = {}
        self._companion_beat: tuple[float, int] = (-math.inf, 0)
        self._reported_at_m = 0.0  # height above home at the last TERRAIN_REPORT
        self._lock = threading.Lock()

    def take(self, message: Any) -> None:
        """Store one message of MAVSDK's mavlink_direct."""
        fields, now_s = json.loads(message.fields_json), time.monotonic()
        name, component = message.message_name, message.component_id
        with self._lock:
            if component == AUTOPILOT:
                self._newest[name] = (now_s, fields)
                if name == "TERRAIN_REPORT":
                    self._reported_at_m = self._height()
                if name == "MISSION_ITEM_REACHED":
                    self.reached.add(fields["seq"])
                elif name == "STATUSTEXT":
                    self.texts.append(fields["text"])
            elif component == self.companion:
                self._from_companion(name, fields, now_s)

    def _from_companion(self, name: str, fields: dict[str, Any], now_s: float) -> None:
        if name == "HEARTBEAT":
            self._companion_beat = (now_s, fields["system_status"])
        elif name == "STATUSTEXT":
            self.texts.append(f"companion: {fields['text']}")
        elif name == "NAMED_VALUE_FLOAT":
            self.named[fields["name"]] = (now_s, fields["value"])
        elif name == "DISTANCE_SENSOR" and fields["orientation"] == self.orientation:
            self.ranges.append(self._range(fields, now_s))

    def _range(self, fields: dict[str, Any], now_s: float) -> Range:
        least, most, distance = (fields[key] * 0.01 for key in ("min_distance", "max_distance", "current_distance"))
        covariance = fields["covariance"]
        sigma = math.sqrt(covariance) * 0.01 if 0 < covariance < _UNKNOWN_COVARIANCE else math.nan
        sigma_at_s, named_sigma_m = self.named.get("rng_sig_m", (-math.inf, math.nan))
        if math.isnan(sigma) and now_s - sigma_at_s < 1.0:  # a covariance of cm^2 in a byte ends at 16 cm
            # that value may be of a range that was not trusted; the quality is what this one's sigma leaves of 100
            by_quality_m = (1.005 - 0.01 * fields["signal_quality"]) * distance
            sigma = min(named_sigma_m, by_quality_m)
        attitude = self._fields("ATTITUDE")
        tilt = math.acos(math.cos(attitude.get("roll", 0.0)) * math.cos(attitude.get("pitch", 0.0)))
        trusted = least <= distance <= most and fields["signal_quality"] != _NO_RANGE_QUALITY
        return Range(now_s, distance, sigma, trusted, *self._then(int(fields["time_boot_ms"])), tilt, least)

    def _then(self, boot_ms: int) -> tuple[float, Place]:
        """Height and place at an exposure, carried there from the newest position: both come on their own time."""
        fields = self._fields("GLOBAL_POSITION_INT")
        apart_s = (boot_ms - int(fields.get("time_boot_ms", 0))) * 1e-3
        if not fields or abs(apart_s) > _LONGEST_CARRY_S:
            apart_s = 0.0  # its clock is not the autopilot's
        north, east, down = (float(fields.get(axis, 0)) * 0.01 * apart_s for axis in ("vx", "vy", "vz"))
        return self._height() - down, self._place().offset(north, east)

    # ------------------------------------------------------------------------------------------ the newest

    def age_s(self, name: str) -> float:
        """Seconds since the autopilot last said this; infinite if never."""
        with self._lock:
            return time.monotonic() - self._newest.get(name, (-math.inf, {}))[0]

    def companion_age_s(self) -> float:
        """Seconds since the companion's last heartbeat."""
        return time.monotonic() - self._companion_beat[0]

    @property
    def companion_ready(self) -> bool:
        """Whether the companion lives and has its clocks: its state is past BOOT, and not CRITICAL."""
        return self._companion_beat[1] in _READY and self.companion_age_s() < 3.0

    def _fields(self, name: str) -> dict[str, Any]:
        return self._newest.get(name, (0.0, {}))[1]

    def _height(self) -> float:
        return float(self._fields("GLOBAL_POSITION_INT").get("relative_alt", 0)) * 0.001

    def _place(self) -> Place:
        fields = self._fields("GLOBAL_POSITION_INT")
        return Place(fields.get("lat", 0) * 1e-7, fields.get("lon", 0) * 1e-7)

    @property
    def mode(self) -> int:
        """Custom mode of the autopilot, -1 before it spoke."""
        return int(self._fields("HEARTBEAT").get("custom_mode", -1))

    @property
    def vehicle_type(self) -> tuple[int, int]:
        """MAV_TYPE and MAV_AUTOPILOT."""
        fields = self._fields("HEARTBEAT")
        return int(fields.get("type", 0)), int(fields.get("autopilot", 8))

    @property
    def armed(self) -> bool:
        """Motors may turn."""
        return bool(int(self._fields("HEARTBEAT").get("base_mode", 0)) & _ARMED)

    @property
    def on_ground(self) -> bool:
        """Whether the autopilot says that it stands; False where it does not tell."""
        state = int(self._fields("EXTENDED_SYS_STATE").get("landed_state", 0))
        return state == _ON_GROUND and self.age_s("EXTENDED_SYS_STATE") < _LANDED_S

    @property
    def out_of_sight(self) -> bool:
        """Whether nothing recent is known of the vehicle: an order would meet it in another state than it was in."""
        return max(self.age_s("HEARTBEAT"), self.age_s("GLOBAL_POSITION_INT")) > _RECENT_S

    @property
    def system_status(self) -> int:
        """MAV_STATE of the autopilot."""
        return int(self._fields("HEARTBEAT").get("system_status", 0))

    @property
    def height_m(self) -> float:
        """Above home, as the autopilot believes."""
        return self._height()

    @property
    def place(self) -> Place:
        """Where it believes to be."""
        return self._place()

    @property
    def climb_mps(self) -> float:
        """Upward speed."""
        return float(self._fields("VFR_HUD").get("climb", 0.0))

    @property
    def airspeed_mps(self) -> float:
        """Airspeed."""
        return float(self._fields("VFR_HUD").get("airspeed", 0.0))

    @property
    def pitch_rad(self) -> float:
        """Pitch, nose up."""
        return float(self._fields("ATTITUDE").get("pitch", 0.0))

    @property
    def heading_deg(self) -> float:
        """Heading, clockwise from north; the attitude's where the position comes without one."""
        heading_cdeg = self._fields("GLOBAL_POSITION_INT").get("hdg", _UNKNOWN_HEADING)
        if heading_cdeg == _UNKNOWN_HEADING:
            return math.degrees(float(self._fields("ATTITUDE").get("yaw", 0.0))) % 360.0
        return float(heading_cdeg) * 0.01

    @property
    def battery(self) -> float | None:
        """Remaining charge, 0 to 1; None where the autopilot does not know."""
        remaining_percent = int(self._fields("SYS_STATUS").get("battery_remaining", -1))
        return remaining_percent * 0.01 if remaining_percent >= 0 else None

    @property
    def may_arm(self) -> bool:
        """Whether the autopilot's pre-arm checks pass; True where it does not tell."""
        fields = self._fields("SYS_STATUS")
        reports_prearm = int(fields.get("onboard_control_sensors_present", 0)) & _PREARM_CHECK
        return not reports_prearm or bool(int(fields.get("onboard_control_sensors_health", 0)) & _PREARM_CHECK)

    @property
    def item(self) -> int:
        """Mission item that is being flown."""
        return int(self._fields("MISSION_CURRENT").get("seq", 0))

    def terrain_m(self, height_m: float) -> float | None:
        """Height above the autopilot's terrain data at a height above home; None where there are none.

        The last report is carried there from the height above home at which it came.
        """
        fields = self._fields("TERRAIN_REPORT")
        fresh = self.age_s("TERRAIN_REPORT") < 2.0 and fields.get("loaded", 0) > 0 and fields.get("pending", 1) == 0
        return float(fields["current_height"]) + height_m - self._reported_at_m if fresh else None

    def newest_range(self) -> Range | None:
        """The last range of any kind."""
        return self.ranges[-1] if self.ranges else None

    def ranges_since(self, at_s: float) -> list[Range]:
        """Every range that came since then."""
        with self._lock:
            return [entry for entry in self.ranges if entry.at_s >= at_s]

    def named_value(self, name: str, within_s: float = 1.0) -> float | None:
        """Value that the companion sends for graphs, if it is fresh."""
        at_s, value = self.named.get(name, (-math.inf, math.nan))
        return value if time.monotonic() - at_s < within_s else None
