"""Output records as MAVLink messages. Nothing that is not finite or not representable ever leaves.

Each encoder is a pure function that gives pymavlink's message object in wire units. What cannot be said becomes "alive,
no range" (DISTANCE_SENSOR), "unknown" (OBSTACLE_DISTANCE) or nothing at all (NAMED_VALUE_FLOAT).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.adapters.mavlink.link.dialect import mavlink
from companion.records import CorrectedRange, Health, ModeState, ObstacleSectors
from companion.units import Orientation

SECTORS = 72  # length of OBSTACLE_DISTANCE.distances (MAVLink common.xml)
_SECTOR_DEG = 5  # 360 degrees over 72 sectors (derived)
_FIRST = 4  # so many sectors left of straight ahead the circle begins: where ArduPilot's face ahead does
_CM = 100.0  # centimetres per metre (by definition)
_LARGEST_CM = 65_533  # UINT16_MAX less 2: one more says "beyond", UINT16_MAX "unknown" (derived)
_UNKNOWN_CM = 65_535  # UINT16_MAX: OBSTACLE_DISTANCE's "unknown" (MAVLink common.xml)
_ABOVE = 1.0 + 1e-6  # of the least distance: a point of it, in 32-bit floats, is not nearer than that (derived)
_NO_OBSTACLE_ID = 65_535  # UINT16_MAX: OBSTACLE_DISTANCE_3D's "no id" (MAVLink)
_UNKNOWN_COVARIANCE = 255  # UINT8_MAX: DISTANCE_SENSOR's "unknown" (MAVLink common.xml)
_LARGEST_COVARIANCE = 254  # the largest uint8 that is not "unknown" (derived)
NO_RANGE_QUALITY, _LEAST_QUALITY, _BEST_QUALITY = 1, 2, 100  # percent; 1 is MAVLink's "invalid", 0 its "unknown"
_UINT32 = 0xFFFFFFFF  # mask of the wire's uint32 (by definition)
_LARGEST_FLOAT32 = float(np.finfo(np.float32).max)
_NAME_CHARACTERS = 10  # char[10] of NAMED_VALUE_FLOAT (MAVLink common.xml)
_TEXT_CHARACTERS = 50  # char[50] of STATUSTEXT (MAVLink common.xml)
_MOST_TEXT_CHUNKS = 5  # bound of one sentence: 250 characters

_STATE = {
    Health.BOOT: mavlink.MAV_STATE_BOOT,
    Health.STANDBY: mavlink.MAV_STATE_STANDBY,
    Health.ACTIVE: mavlink.MAV_STATE_ACTIVE,
    Health.CRITICAL: mavlink.MAV_STATE_CRITICAL,
}


def heartbeat(health: Health) -> Any:
    """HEARTBEAT of an onboard computer; ``system_status`` tells our health."""
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, _STATE[health], 3
    )


def distance_sensor(record: CorrectedRange, min_m: float, max_m: float, time_boot_ms: int) -> Any:
    """DISTANCE_SENSOR of a range.

    A range that is not trusted, finite, positive and, in whole centimetres, inside the limits is sent as
    :func:`no_range`. The covariance is in cm^2, 1 to 254; a larger or unknown one is 255. The quality is what sigma
    leaves of 100, at least 2.
    """
    least, most = _limits_cm(min_m, max_m)
    good = record.trusted and math.isfinite(record.range_m) and math.isfinite(record.sigma_m) and record.sigma_m >= 0
    if not (good and record.range_m > 0 and least <= round(record.range_m * _CM) <= most):
        return no_range(record.orientation, min_m, max_m, time_boot_ms)
    quality = _clamp(_BEST_QUALITY * (1.0 - record.sigma_m / record.range_m), _LEAST_QUALITY, _BEST_QUALITY)
    distance = _clamp(record.range_m * _CM, least, most)
    covariance = _covariance_cm2(record.sigma_m)
    return _distance(record.orientation, (least, most), distance, covariance, quality, time_boot_ms)


def no_range(orientation: int, min_m: float, max_m: float, time_boot_ms: int) -> Any:
    """DISTANCE_SENSOR that says "alive, no range", with quality 1.

    Downward one centimetre beyond the largest distance. Ahead 0: PX4's collision prevention takes what is too far for
    a free way, whatever its quality, and passes over what is too near, until its map knows nothing. ArduPilot's
    proximity knows nothing ahead by either, and arms with both.
    """
    limits_cm = _limits_cm(min_m, max_m)
    distance_cm = limits_cm[1] + 1 if orientation == Orientation.DOWN else 0
    return _distance(orientation, limits_cm, distance_cm, _UNKNOWN_COVARIANCE, NO_RANGE_QUALITY, time_boot_ms)


def _distance(
    orientation: int, limits_cm: tuple[int, int], distance_cm: int, covariance: int, quality: int, time_boot_ms: int
) -> Any:
    return mavlink.MAVLink_distance_sensor_message(
        time_boot_ms & _UINT32,
        *limits_cm,
        distance_cm,
        mavlink.MAV_DISTANCE_SENSOR_UNKNOWN,
        0,
        orientation if 0 <= orientation <= 255 else mavlink.MAV_SENSOR_ROTATION_NONE,
        covariance,
        signal_quality=quality,
    )


def obstacle_distance(record: ObstacleSectors, time_usec: int, *, px4: bool = False) -> Any:
    """OBSTACLE_DISTANCE, the full circle of 72 sectors of 5 degrees in body FRD (frame 12), from 20 degrees left on.

    ArduPilot gathers the elements into faces of 45 degrees in their order, and what it reads of a face later takes the
    place of what it read before (AP_Proximity_MAV.cpp): in a circle that began ahead, the left half of the face ahead
    would hide a nearer obstacle in its right half.

    A known obstacle is clamped to the limits from below (never 0, which autopilots read as no data); beyond the largest
    distance, or clear, is largest + 1; everything else is unknown, 65535.

    A PX4 that keeps 36 directions reads every other sector (CollisionPrevention.cpp, ``ceil`` of bearing over
    increment). With ``px4`` these have the nearest obstacle of their neighbours, too: where a newer one keeps 72,
    obstacles are up to one sector wider on either side.
    """
    least, most = _limits_cm(record.min_m, record.max_m)
    finite = np.isfinite(record.distance_m) & (record.distance_m >= 0)
    distance = np.where(finite, np.minimum(record.distance_m, 2 * _LARGEST_CM / _CM), 0.0) * _CM
    measured = record.known & finite
    sectors = np.full(len(record.distance_m), _UNKNOWN_CM, dtype=np.int64)
    sectors[record.clear] = most + 1
    near = np.clip(np.rint(np.minimum(distance, most + 1)), max(least, 1), most + 1).astype(np.int64)
    sectors[measured & ~record.clear] = near[measured & ~record.clear]
    circle = np.full(SECTORS, _UNKNOWN_CM, dtype=np.int64)
    circle[: len(sectors)] = sectors[:SECTORS]
    circle = np.roll(_gathered(circle, most) if px4 else circle, _FIRST)
    return mavlink.MAVLink_obstacle_distance_message(
        max(time_usec, 0),
        mavlink.MAV_DISTANCE_SENSOR_UNKNOWN,
        circle.tolist(),
        _SECTOR_DEG,
        least,
        most,
        float(_SECTOR_DEG),
        float(-_FIRST * _SECTOR_DEG),
        mavlink.MAV_FRAME_BODY_FRD,
    )


def _gathered(circle: NDArray[np.int64], most_cm: int) -> NDArray[np.int64]:
    """A circle whose every other sector has the nearest obstacle of itself and its two neighbours, if they have any."""
    obstacles = np.where(circle <= most_cm, circle, _UNKNOWN_CM)
    nearest = np.minimum(np.minimum(np.roll(obstacles, 1), np.roll(obstacles, -1)), obstacles)
    read = (np.arange(SECTORS) % 2 == 0) & (nearest <= most_cm)
    return np.where(read, nearest, circle)


def obstacle_points(record: ObstacleSectors, time_boot_ms: int) -> list[Any]:
    """OBSTACLE_DISTANCE_3D, one for each known sector, level with the body, all of one stamp.

    ArduPilot takes points of one stamp for one look and uses it when the next stamp arrives. A look without a point
    therefore still says one, beyond the largest distance, which it ignores; nothing can say that a direction is clear.
    What is nearer than the least distance it ignores too: such an obstacle is put there.
    """
    least_m, most_m = (limit / _CM for limit in _limits_cm(record.min_m, record.max_m))
    distances = record.distance_m[:SECTORS]
    sectors = np.flatnonzero(record.known[:SECTORS] & (distances >= 0.0) & (distances <= most_m))
    least = least_m * _ABOVE
    points = [(math.radians(_SECTOR_DEG * index), max(float(distances[index]), least)) for index in sectors.tolist()]
    return [
        mavlink.MAVLink_obstacle_distance_3d_message(
            time_boot_ms & _UINT32,
            mavlink.MAV_DISTANCE_SENSOR_UNKNOWN,
            mavlink.MAV_FRAME_BODY_FRD,
            _NO_OBSTACLE_ID,
            distance * math.cos(bearing),
            distance * math.sin(bearing),
            0.0,
            least_m,
            most_m,
        )
        for bearing, distance in points or [(0.0, most_m + 1.0)]
    ]


def unknown_sectors(at_host_ns: int, min_m: float, max_m: float) -> ObstacleSectors:
    """Nothing is known in any direction: what stands for "alive, no range" among obstacles."""
    none = np.zeros(SECTORS, dtype=np.bool_)
    return ObstacleSectors(at_host_ns, np.zeros(SECTORS), np.zeros(SECTORS), none, none, min_m, max_m)


def named_value(name: str, value: float, time_boot_ms: int) -> Any | None:
    """NAMED_VALUE_FLOAT, the name cut at 10 characters; nothing where the value is no finite 32-bit float."""
    if not math.isfinite(value) or abs(value) > _LARGEST_FLOAT32:
        return None
    return mavlink.MAVLink_named_value_float_message(
        time_boot_ms & _UINT32, _ascii(name)[:_NAME_CHARACTERS].encode(), value
    )


def range_graphs(record: CorrectedRange, time_boot_ms: int) -> list[Any | None]:
    """NAMED_VALUE_FLOAT of a range's sigma (m), the correction's toe (mrad) and the range without it (m).

    Those of an untrusted range go out too: they are graphs for an eye that looks for the reason, and not the range.
    What the pair did not tell (too few matches, no finite answer) is left out: a zero would be drawn as a value.
    """
    values = (
        ("rng_sig_m", record.sigma_m, record.range_m != 0.0),
        ("toe_mrad", record.toe_rad * 1e3, record.toe_sigma_rad != 0.0),
        ("rigid_m", record.rigid_range_m, record.rigid_range_m != 0.0),
    )
    return [named_value(name, value, time_boot_ms) for name, value, is_told in values if is_told]


def mode_graphs(record: ModeState, time_boot_ms: int) -> list[Any | None]:
    """NAMED_VALUE_FLOAT of the modal coordinates (mm at the tip), and of the symmetric mode's frequency and phase."""
    values = (
        ("q_sym_mm", float(record.q_m[0]) * 1e3),
        ("q_anti_mm", float(record.q_m[1]) * 1e3),
        ("f_sym_hz", record.symmetric.frequency_hz),
        ("ph_sym_rad", record.symmetric.phase_rad),
    )
    return [named_value(name, value, time_boot_ms) for name, value in values]


def status_text(severity: int, text: str, identity: int) -> list[Any]:
    """STATUSTEXT, in chunks of 50 characters that share ``identity`` (1 to 65535) where one is not enough."""
    level = min(max(severity, mavlink.MAV_SEVERITY_EMERGENCY), mavlink.MAV_SEVERITY_DEBUG)
    plain = _ascii(text)[: _MOST_TEXT_CHUNKS * _TEXT_CHARACTERS - 1]
    if len(plain) <= _TEXT_CHARACTERS:
        return [mavlink.MAVLink_statustext_message(level, plain.encode())]
    # a text ends with the first chunk that is not full, so a last full one is followed by an empty one
    starts = range(0, len(plain) + 1, _TEXT_CHARACTERS)
    chunks = [plain[start : start + _TEXT_CHARACTERS].encode() for start in starts]
    shared = (identity - 1) % 65_535 + 1
    return [mavlink.MAVLink_statustext_message(level, chunk, shared, index) for index, chunk in enumerate(chunks)]


def sendable(message: Any) -> bool:
    """Whether no field of a message is NaN or infinite: the last gate before the link."""
    for name in message.get_fieldnames():
        value = getattr(message, name)
        for item in value if isinstance(value, list | tuple) else (value,):
            if isinstance(item, float) and not (math.isfinite(item) and abs(item) <= _LARGEST_FLOAT32):
                return False
    return True


def _limits_cm(min_m: float, max_m: float) -> tuple[int, int]:
    most = _clamp(max_m * _CM, 1, _LARGEST_CM)
    return _clamp(min_m * _CM, 0, most), most


def _clamp(value: float, least: int, most: int) -> int:
    """Round into the limits; not a number counts as the upper one."""
    return most if math.isnan(value) else round(min(max(value, least), most))


def _covariance_cm2(sigma_m: float) -> int:
    variance = (sigma_m * _CM) ** 2 if sigma_m < 1.0 else math.inf
    return math.ceil(max(variance, 1.0)) if variance <= _LARGEST_COVARIANCE else _UNKNOWN_COVARIANCE


def _ascii(text: str) -> str:
    return "".join(letter if " " <= letter <= "~" else "?" for letter in text)
