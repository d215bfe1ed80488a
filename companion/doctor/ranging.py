"""Use that the autopilot makes of our ranges: rangefinder, proximity, limits, orientation, rivals."""

from __future__ import annotations

from collections.abc import Iterator

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.doctor.evidence import Evidence, Finding, Fix

# convention: MAVLink's drivers in RNGFND1_TYPE and PRX1_TYPE (ArduPilot)
_MAVLINK_RANGEFINDER, _MAVLINK_PROXIMITY = 10, 2
_NUMBERS = range(1, 5)  # of ArduPilot's range finders that are asked for (choice: boards have few ports)
_PROXIMITY_USERS = frozenset(
    (
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_TYPE_HELICOPTER,
        mavlink.MAV_TYPE_HEXAROTOR,
        mavlink.MAV_TYPE_OCTOROTOR,
        mavlink.MAV_TYPE_TRICOPTER,
        mavlink.MAV_TYPE_COAXIAL,
        mavlink.MAV_TYPE_DODECAROTOR,
        mavlink.MAV_TYPE_GROUND_ROVER,
        mavlink.MAV_TYPE_SURFACE_BOAT,
    )
)


def check_ranging(evidence: Evidence) -> Iterator[Finding]:
    """Whether a range of ours would be used."""
    if evidence.airframe.left_camera is None or evidence.airframe.right_camera is None:
        yield Finding.note("range", f"airframe '{evidence.airframe.name}' has no camera pair: no ranges go out")
        return
    if evidence.px4:
        yield Finding.note("range", "PX4 takes DISTANCE_SENSOR as it comes; RNGFND1_* are ArduPilot's")
        text = "EKF2_RNG_CTRL is 0: PX4 records our ranges, and its height does not use them"
        yield from _switched_off(evidence, "EKF2_RNG_CTRL", text)
    else:
        yield from _rangefinder(evidence)
        text = "RNGFND_LANDING is 0: ArduPlane records our ranges, and they steer no landing"
        yield from _switched_off(evidence, "RNGFND_LANDING", text)
        yield from _proximity(evidence)
    yield from _other_senders(evidence)


def _rangefinder(evidence: Evidence) -> Iterator[Finding]:
    if evidence.parameter("RNGFND1_TYPE") is None:
        yield evidence.missing("range", "RNGFND1_TYPE")
        return
    name = f"RNGFND{_our_rangefinder(evidence)}"
    kind = evidence.parameter(f"{name}_TYPE")
    if kind is not None and kind[1] == _MAVLINK_RANGEFINDER:
        yield Finding.ok("range", f"{name}_TYPE is {_MAVLINK_RANGEFINDER} (MAVLink)")
    else:
        value = "not told" if kind is None else f"{kind[1]:g}"
        text = f"{name}_TYPE is {value}, not {_MAVLINK_RANGEFINDER} (MAVLink): our ranges are not used"
        yield Finding.fix("range", text, Fix(f"{name}_TYPE", _MAVLINK_RANGEFINDER, reboot=True))
    wanted = evidence.airframe.orientation
    place = evidence.parameter(f"{name}_ORIENT")
    if place is not None and place[1] == wanted:
        yield Finding.ok("range", f"{name}_ORIENT is {place[1]:g}")
    elif place is not None:
        text = f"{name}_ORIENT is {place[1]:g}, but the cameras look to {wanted}"
        yield Finding.fix("range", text, Fix(f"{name}_ORIENT", wanted))
    yield from _limits(evidence, name)


def _our_rangefinder(evidence: Evidence) -> int:
    """Number of the instance that takes our ranges, or else of one that could without another sensor's loss."""
    kinds = {number: evidence.parameter(f"RNGFND{number}_TYPE") for number in _NUMBERS}
    of_mavlink = [number for number, kind in kinds.items() if kind is not None and kind[1] == _MAVLINK_RANGEFINDER]
    ours = [number for number in of_mavlink if _looks_where_we_do(evidence, number)]
    free = [number for number, kind in kinds.items() if kind is not None and kind[1] == 0.0]
    return next(iter([*ours, *of_mavlink, *free, 1]))


def _looks_where_we_do(evidence: Evidence, number: int) -> bool:
    place = evidence.parameter(f"RNGFND{number}_ORIENT")
    return place is not None and place[1] == evidence.airframe.orientation


def _switched_off(evidence: Evidence, name: str, text: str) -> Iterator[Finding]:
    """A warning where the use of ranges to the ground is off; a vehicle without that parameter has no such switch."""
    value = evidence.parameter(name)
    if evidence.airframe.looks_down and value is not None and value[1] == 0.0:
        yield Finding.note("range", text, Fix(name, 1))


def _limits(evidence: Evidence, name: str) -> Iterator[Finding]:
    wanted_m = (evidence.settings.min_range_m, evidence.settings.max_range_m)
    for names, ours_m, upper in (
        ((f"{name}_MIN", f"{name}_MIN_CM"), wanted_m[0], False),
        ((f"{name}_MAX", f"{name}_MAX_CM"), wanted_m[1], True),
    ):
        value = evidence.parameter(*names)
        if value is None:
            continue
        # the names that end in _CM are of versions before 4.7
        scale = 100.0 if value[0].endswith("_CM") else 1.0
        limit_m = value[1] / scale
        if limit_m < ours_m if upper else limit_m > ours_m:
            side = "beyond" if upper else "below"
            border = f"{'to' if upper else 'from'} {ours_m:g} m"
            text = f"{value[0]} is {value[1]:g}: nothing {side} {limit_m:g} m is used, and we publish {border}"
            yield Finding.fix("range", text, Fix(value[0], ours_m * scale))
        else:
            yield Finding.ok("range", f"{value[0]} is {value[1]:g}")


def _proximity(evidence: Evidence) -> Iterator[Finding]:
    if not evidence.airframe.looks_forward or evidence.pilot is None:
        return
    if evidence.pilot.kind not in _PROXIMITY_USERS:
        text = "this vehicle has no proximity library: OBSTACLE_DISTANCE is only passed on to ground stations and logs"
        yield Finding.note("proximity", text)
        return
    kind = evidence.parameter("PRX1_TYPE", "PRX_TYPE")
    if kind is None:
        yield evidence.missing("proximity", "PRX1_TYPE")
    elif kind[1] != _MAVLINK_PROXIMITY:
        text = f"{kind[0]} is {kind[1]:g}, not {_MAVLINK_PROXIMITY} (MAVLink): obstacles are not used"
        yield Finding.fix("proximity", text, Fix(kind[0], _MAVLINK_PROXIMITY, reboot=True))
    else:
        yield Finding.ok("proximity", f"{kind[0]} is {_MAVLINK_PROXIMITY} (MAVLink)")


def _other_senders(evidence: Evidence) -> Iterator[Finding]:
    """Two senders on one orientation overwrite each other; the autopilot tells them apart by nothing else."""
    ours = evidence.airframe.orientation
    for (system, component, orientation), count in sorted(evidence.range_senders.items()):
        if orientation != ours or (component == 1 and _echoes_us(evidence)):
            continue
        text = f"{system}/{component} also sends DISTANCE_SENSOR of orientation {ours} ({count} heard): turn one off"
        yield Finding.fix("range", text)
    for number in sorted(set(_NUMBERS) - {_our_rangefinder(evidence)}):
        kind = evidence.parameter(f"RNGFND{number}_TYPE")
        rival = kind is not None and kind[1] not in (0.0, _MAVLINK_RANGEFINDER)
        if rival and _looks_where_we_do(evidence, number):
            text = f"RNGFND{number} looks to {ours} too: the autopilot may use it in place of ours"
            yield Finding.fix("range", text, Fix(f"RNGFND{number}_TYPE", 0, reboot=True))


def _echoes_us(evidence: Evidence) -> bool:
    """The autopilot reports its rangefinders with the same message; that which takes ours repeats them."""
    kind = evidence.parameter(f"RNGFND{_our_rangefinder(evidence)}_TYPE")
    return kind is None or kind[1] == _MAVLINK_RANGEFINDER
