"""Every tunable of the service, declared once: attribute, MAVLink name, unit, range, default, meaning, live or reboot.

TOML files, the MAVLink parameter protocol, component metadata and ``config/PARAMETERS.md`` are views of this table.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from companion.errors import ConfigError

_RETIRED = ("RNG_ORIENT",)  # of earlier versions, without effect: the airframe says where its cameras look
_MAVLINK_NAME_LENGTH = 16  # characters of PARAM_VALUE.param_id (by definition)


@dataclass(frozen=True, slots=True)
class Tunable:
    """One row of the table; ``flown`` is the wider range of earlier versions, where it was one."""

    attribute: str
    name: str
    unit: str
    minimum: float
    maximum: float
    default: float
    doc: str
    live: bool
    integer: bool
    choices: tuple[str, ...]
    flown: tuple[float, float] | None

    def check(self, value: float, *, flown: bool = False) -> str | None:
        """Say what is wrong with ``value``, or nothing; with ``flown``, a value that an earlier version took is good."""
        if not math.isfinite(value):
            return f"{self.name} must be a finite number"
        earlier = flown and self.flown is not None and self.flown[0] <= value <= self.flown[1]
        if not earlier and not self.minimum <= value <= self.maximum:
            return f"{self.name} = {value:g} is outside {self.minimum:g} to {self.maximum:g} {self.unit}".rstrip()
        if self.integer and value != int(value):
            return f"{self.name} = {value:g} must be a whole number"
        return None


def _tunable(
    name: str,
    unit: str,
    minimum: float,
    maximum: float,
    default: float,
    doc: str,
    *,
    live: bool = True,
    choices: tuple[str, ...] = (),
    flown: tuple[float, float] | None = None,
) -> Any:
    if len(name) > _MAVLINK_NAME_LENGTH:
        raise ValueError(f"{name} is longer than a MAVLink parameter name")
    row = {
        "name": name,
        "unit": unit,
        "minimum": minimum,
        "maximum": maximum,
        "doc": doc,
        "live": live,
        "choices": choices,
        "flown": flown,
    }
    return field(default=default, metadata=row)


@dataclass(frozen=True, slots=True)
class Conflict:
    """Settings, by MAVLink name, that are each in range and together leave nothing to publish; and why, in words."""

    names: tuple[str, ...]
    text: str


@dataclass(frozen=True, slots=True)
class Settings:
    """The values in force. Attribute names carry the unit; see :func:`tunables` for the rest of each row."""

    # identity (restart)
    component_id: int = _tunable(
        "SW_COMPID",
        "",
        2,
        255,
        191,
        "MAVLink component id of this service (1 is the autopilot)",
        live=False,
        flown=(1, 255),
    )
    system_id: int = _tunable(
        "SW_SYSID", "", 0, 255, 0, "MAVLink system id of the vehicle; 0 is the autopilot that is there", live=False
    )

    # tracking
    smoother_lag_s: float = _tunable(
        "TRK_LAG",
        "s",
        0.1,
        1.0,
        0.5,
        "Lag of the smoother that corrects ranges; more is more accurate and later",
        live=False,
    )
    reorder_window_s: float = _tunable(
        "TRK_WINDOW", "s", 0.01, 0.25, 0.05, "How late an inertial sample may arrive and still be used", live=False
    )
    track_rate_hz: float = _tunable(
        "TRK_RATE", "Hz", 100, 500, 250, "Rate of the tracker; faster streams are averaged exactly to it", live=False
    )
    adapt: int = _tunable(
        "TRK_ADAPT", "", 0, 1, 1, "Adapt frequency, damping and gust spectrum in flight", choices=("off", "on")
    )
    calm_rms_m: float = _tunable(
        "TRK_CALM", "m", 0, 0.01, 0.0002, "Below this deflection rms the wing is calm: fire on the timer"
    )
    stale_s: float = _tunable("TRK_STALE", "s", 0.05, 2.0, 0.2, "A stream silent for so long is stale")

    # triggering
    trigger_policy: int = _tunable(
        "TRG_POLICY", "", 0, 2, 0, "When to fire", choices=("peaks, timer when calm", "timer", "off")
    )
    trigger_aim: int = _tunable(
        "TRG_AIM", "", 0, 1, 0, "What a shot is aimed at", choices=("least blur", "deflection peak")
    )
    trigger_rate_hz: float = _tunable(
        "TRG_RATE",
        "Hz",
        1,
        30,
        10,
        "Most shots per second; ranges over 2 s apart would not vouch for each other",
        flown=(0.5, 30),
    )
    trigger_sigma_s: float = _tunable(
        "TRG_SIGMA", "s", 0.0005, 0.05, 0.025, "Skip a peak whose time is less certain than this"
    )
    trigger_blur_px: float = _tunable("TRG_BLUR", "px", 0.05, 10, 3.0, "Skip a shot with more predicted blur than this")

    # ranging
    min_range_m: float = _tunable("RNG_MIN", "m", 0.5, 100, 4, "Shortest range that is published")
    max_range_m: float = _tunable("RNG_MAX", "m", 5, 500, 200, "Longest range that is published")
    trust_ratio: float = _tunable("RNG_TRUST", "", 0.005, 0.2, 0.03, "Largest sigma/range that is trusted")
    min_matches: int = _tunable(
        "RNG_MATCHES",
        "",
        4,
        100,
        12,
        "Fewest matches for a range; of 200 corners that are tried, about half match",
        flown=(4, 500),
    )
    product: int = _tunable(
        "RNG_PRODUCT", "", 0, 2, 0, "Which range is published", choices=("median", "nearest", "centre")
    )
    hold_slow: int = _tunable(
        "RNG_EPIPOLAR",
        "",
        0,
        1,
        1,
        "Estimate the slow misalignment of the cameras (pitch, toe, roll) from matched features",
        choices=("off", "on"),
    )
    fill: int = _tunable(
        "RNG_DENSE",
        "",
        0,
        1,
        1,
        "Fill a forward pair's obstacle picture by dense disparity where no feature was found",
        choices=("off", "on"),
    )

    # outputs
    publish_rate_hz: float = _tunable(
        "OUT_RATE", "Hz", 4, 50, 10, "Rate of DISTANCE_SENSOR and OBSTACLE_DISTANCE", flown=(2, 50)
    )
    obstacles: int = _tunable(
        "OUT_OBSTACLES",
        "",
        0,
        2,
        1,
        "How obstacles go out; an autopilot wants one form of them, not both",
        choices=("not at all", "OBSTACLE_DISTANCE", "OBSTACLE_DISTANCE_3D"),
    )
    debug_rate_hz: float = _tunable("OUT_DEBUG", "Hz", 0, 25, 4, "Rate of NAMED_VALUE_FLOAT for graphs; 0 is off")

    # rates asked of the autopilot
    imu_rate_hz: float = _tunable(
        "IMU_RATE", "Hz", 25, 1000, 333, "Rate of inertial messages asked of the autopilot", live=False
    )

    def replace(self, name: str, value: float, *, flown: bool = False) -> Settings:
        """Give the settings with one value changed, by MAVLink name; raise :class:`ConfigError` for a bad one.

        With ``flown``, which is for recordings, a value is good that the version took which flew it.
        """
        for row in tunables():
            if name == row.name:
                problem = row.check(value, flown=flown)
                if problem:
                    raise ConfigError(problem)
                change: dict[str, Any] = {row.attribute: int(value) if row.integer else float(value)}
                return dataclasses.replace(self, **change)
        if flown and name in _RETIRED:
            return self
        near = difflib.get_close_matches(name.upper(), [row.name for row in tunables()], n=1)
        hint = f"is it {near[0]}? " if near else ""
        raise ConfigError(f"no parameter '{name}'; {hint}spanwise params lists them")

    def with_values(self, values: Mapping[str, float], *, flown: bool = False) -> Settings:
        """Give the settings with several values changed, as :meth:`replace` changes one."""
        settings = self
        for name, value in values.items():
            settings = settings.replace(name, value, flown=flown)
        return settings

    def values(self) -> dict[str, float]:
        """Every value, by MAVLink name, in the order of the table."""
        return {row.name: getattr(self, row.attribute) for row in tunables()}

    def changed(self) -> dict[str, float]:
        """The values that are not their defaults, by MAVLink name."""
        return {row.name: value for row in tunables() if (value := getattr(self, row.attribute)) != row.default}

    def conflict(self, reserved: Collection[int] = ()) -> Conflict | None:
        """Say which settings contradict each other; ``reserved`` are component ids that belong to others."""
        if self.min_range_m >= self.max_range_m:
            text = f"RNG_MIN {self.min_range_m:g} m must be below RNG_MAX {self.max_range_m:g} m"
            return Conflict(("RNG_MIN", "RNG_MAX"), text)
        if self.component_id in reserved:
            return Conflict(("SW_COMPID",), f"SW_COMPID {self.component_id} is a sensor's component id")
        return None

    def agreeing(self, values: Mapping[str, float]) -> tuple[dict[str, float], list[str]]:
        """Leave out of stored values those that would contradict the rest, with a sentence for each contradiction."""
        clash = self.with_values(values).conflict()
        dropped = [] if clash is None else sorted(values.keys() & set(clash.names))
        if clash is None or not dropped:
            return dict(values), []
        rest, problems = self.agreeing({name: value for name, value in values.items() if name not in dropped})
        return rest, [f"{clash.text}: {', '.join(dropped)} not used", *problems]


def tunables() -> Iterator[Tunable]:
    """The table, in declaration order, which is the MAVLink parameter index."""
    for entry in dataclasses.fields(Settings):
        default: Any = entry.default
        yield Tunable(attribute=entry.name, default=default, integer=entry.type == "int", **entry.metadata)
