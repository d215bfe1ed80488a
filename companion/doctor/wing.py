"""Wing nodes and cameras: what arrives, whether the link can carry it, and what accuracy those axes allow."""

from __future__ import annotations

from collections.abc import Iterator

from companion.adapters.mavlink.decode.source_map import AUTOPILOT_COMPONENT
from companion.adapters.mavlink.link.dialect import ID_OF, payload_size
from companion.doctor.evidence import Evidence, Finding, FindingLevel, Fix
from companion.evaluation.plan_outcomes import FAILED, FIRED, LATE, UNANSWERED
from companion.params.airframe import Sensor
from companion.records import Axis, Station

_NONE = "no wingtip is measured: there is nothing to correct ranges with; only 'alive, no range' goes out"
_LOSSES = {
    "loop_lost": "readings lost because its loop came too late: its firmware is too slow for this rate",
    "line_lost": "readings lost because its line is too slow: raise the baud rate or lower the rate",
    "line_bad": "damaged TIMESYNC requests: mend the cable",
}
_ENOUGH = 0.75  # of the believed rate: below, the stream does not come as set (choice)
_UNPAIRED = 0.05  # convention: share of frames worth a warning
_LOST = 0.05  # convention: share of plans worth a warning
_OVERHEAD_BYTES = 12  # header and checksum of MAVLink 2
_BITS_PER_BYTE = 10  # start, eight of data, stop (by definition)
# smoothed relative slope of a 5 Hz, 5 mm wing with drifting biases, mrad: sitl_tests/physics/test_reference_limits.py
_SLOPE_MRAD = {(False, False): 0.47, (True, False): 0.26, (False, True): 0.33, (True, True): 0.24}


def check_nodes(evidence: Evidence) -> Iterator[Finding]:
    """Both wingtips: alive, fast enough, all axes, enough bandwidth."""
    sides = (Station.LEFT, Station.RIGHT)
    alive = [side for side in sides if evidence.rate_hz.get(side)]
    for side in sides:
        yield from _node(evidence, side)
    if len(alive) == 2:
        yield Finding.ok("wing", _accuracy(evidence))
    elif any(_is_beyond(evidence, side) for side in sides):
        return
    elif alive:
        text = (
            f"only the {alive[0].name.lower()} tip is measured: antisymmetric bending cannot be told from symmetric; "
            "ranges go out with the larger sigma that this leaves, and are trusted where it is small enough"
        )
        yield Finding.fix("wing", text)
    else:
        yield Finding.fix("wing", _NONE)
    yield from _lines(evidence)
    yield from _losses(evidence)


def _is_beyond(evidence: Evidence, side: Station) -> bool:
    """Whether a log cannot hold that side: an autopilot's own has the samples of its own sensors alone."""
    return evidence.onboard and evidence.airframe.sensor(side).source.component != AUTOPILOT_COMPONENT


def _node(evidence: Evidence, side: Station) -> Iterator[Finding]:
    sensor = evidence.airframe.sensor(side)
    source, rate_hz, name = sensor.source, evidence.rate_hz.get(side, 0.0), side.name.lower()
    wired = source.component == AUTOPILOT_COMPONENT
    if not rate_hz:
        if not wired:
            yield _silent(evidence, side)
        return
    missing = (sensor.axes & ~evidence.axes[side]).letters
    if missing:
        text = f"{name}: axes {missing} never come, though the airframe says they do: correct 'sends', or the node"
        yield Finding.fix("wing", text)
    if not wired:
        text = f"{name} {source.message} of {source.component} at {rate_hz:.0f} Hz"
        if rate_hz < _ENOUGH * sensor.rate_hz:
            yield Finding.fix("wing", f"{text}, not {sensor.rate_hz:.0f}{_bandwidth(evidence, sensor)}")
        else:
            yield Finding.ok("wing", text)


def _silent(evidence: Evidence, side: Station) -> Finding:
    source, name = evidence.airframe.sensor(side).source, side.name.lower()
    if _is_beyond(evidence, side):
        text = f"{name}: component {source.component} is not in an autopilot's own log"
        return Finding("wing", FindingLevel.UNKNOWN, text)
    beats = (evidence.system, source.component) in evidence.beats
    text = f"{name}: component {source.component} {f'beats but sends no {source.message}' if beats else 'is silent'}"
    others = [what for what in evidence.foreign_imu if what.startswith(source.message)]
    text += f"; {', '.join(others)} is not mapped: see [{name}].source in the airframe" if others else ""
    return Finding.fix("wing", text)


def _lines(evidence: Evidence) -> Iterator[Finding]:
    """Serial lines on which nodes were heard, against what the streams of these need together."""
    sensors = [evidence.airframe.sensor(side) for side in (Station.LEFT, Station.RIGHT)]
    # stations that one stream carries are one entry
    streams = {(sensor.source.message, sensor.source.component, sensor.source.instance): sensor for sensor in sensors}
    for link, baud in evidence.serial_baud.items():
        nodes = evidence.link_components.get(link, set()) - {AUTOPILOT_COMPONENT}
        behind = [sensor for sensor in streams.values() if sensor.source.component in nodes]
        if not behind:
            continue
        needed = sum(map(_needed_baud, behind))
        streams_need = "a node's stream needs" if len(behind) == 1 else "the streams of two nodes need"
        text = f"{link}: {streams_need} {needed:.0f} baud of {baud}"
        if baud < needed:
            yield Finding.fix("wing", text + ": raise the baud rate, or lower the node's rate")
        else:
            yield Finding.ok("wing", text)


def _losses(evidence: Evidence) -> Iterator[Finding]:
    """Losses that the nodes themselves count (tools/wing_node) while they are heard."""
    for (component, name), count in sorted(evidence.node_losses.items()):
        if count and name in _LOSSES:
            yield Finding.fix("wing", f"node {component}: {count} {_LOSSES[name]}")


def _needed_baud(sensor: Sensor) -> float:
    frame_bytes = payload_size(ID_OF[sensor.source.message]) + _OVERHEAD_BYTES
    return sensor.rate_hz * frame_bytes * _BITS_PER_BYTE


def _bandwidth(evidence: Evidence, sensor: Sensor) -> str:
    """Bit rate that the stream needs of a serial line (1 kHz of HIGHRES_IMU is 750 kbaud), where one is in use."""
    needed = _needed_baud(sensor)
    links = evidence.link_components.items()
    heard = [link for link, components in links if sensor.source.component in components]
    for link, baud in evidence.serial_baud.items():
        if baud < needed and (link in heard or not heard):
            return f": {link} has {baud} baud and this stream alone needs {needed:.0f}"
    return ""


def _accuracy(evidence: Evidence) -> str:
    axes = evidence.axes[Station.LEFT] & evidence.axes[Station.RIGHT]
    lateral, gyro = bool(axes & Axis.Y), bool(axes & Axis.P)
    sigma = f"{_SLOPE_MRAD[lateral, gyro]:.2f} mrad (5 Hz, 5 mm wing)"
    text = f"both tips send {axes.letters}: relative slope to about {sigma}"
    return text if lateral and gyro else text + "; with lateral axis and gyro 0.24"


def check_cameras(evidence: Evidence) -> Iterator[Finding]:
    """Whether pictures come in pairs: of the autopilot's cameras, where they are used, and of a recording's shots."""
    if evidence.airframe.left_camera is None:
        return
    if evidence.feedback:
        yield from _feedback(evidence)
    if evidence.shots or evidence.pairs or evidence.unpaired:
        yield _pairing(evidence)
    if counts := evidence.plan_outcomes.counts():
        yield _planned(counts)


def _feedback(evidence: Evidence) -> Iterator[Finding]:
    # ArduPilot numbers its cameras from 0 here, and from 1 in commands and parameters
    counts = [len(evidence.feedback[number]) for number in sorted(evidence.feedback)]
    if len(counts) == 1:
        text = f"CAMERA_FEEDBACK comes of one camera only ({counts[0]} pictures): set CAM2_TYPE like CAM1_TYPE"
        yield Finding.fix("camera", text)
    elif abs(counts[0] - counts[1]) > 1:
        yield Finding.fix("camera", f"CAMERA_FEEDBACK does not pair: {counts[0]} left, {counts[1]} right")
    else:
        yield Finding.ok("camera", f"CAMERA_FEEDBACK pairs: {counts[0]} and {counts[1]}")
    shots_hz = evidence.settings.trigger_rate_hz
    for name in ("CAM1_DURATION", "CAM2_DURATION"):
        value = evidence.parameter(name)
        if value is not None and value[1] * shots_hz >= 1.0:
            text = f"{name} {value[1]:g} s refuses shots that come faster, and TRG_RATE is {shots_hz:g} Hz"
            yield Finding.fix("camera", text, Fix(name, round(0.5 / shots_hz, 3)))


def _planned(counts: dict[str, int]) -> Finding:
    """Outcomes of a recording's plans to fire, and the fix where too many came to nothing."""
    text = f"{sum(counts.values())} plans: " + ", ".join(f"{count} {outcome}" for outcome, count in counts.items())
    tried = sum(counts.get(outcome, 0) for outcome in (FIRED, LATE, FAILED, UNANSWERED))
    if counts.get(FAILED, 0) > _LOST * tried:
        return Finding.fix("shots", text + ": is a camera set up on that line, and free at TRG_RATE?")
    if counts.get(LATE, 0) > _LOST * tried:
        return Finding.fix("shots", text + ": the computer is too busy, or has no real-time priority")
    if counts.get(UNANSWERED, 0) > _LOST * tried:
        return Finding.fix("shots", text + ": does the trigger process run, and its board answer?")
    return Finding.ok("shots", text)


def _pairing(evidence: Evidence) -> Finding:
    """Outcomes of a recording's shots."""
    text = f"{evidence.shots} shots, {evidence.pairs} matched pairs, {evidence.unpaired} images without a partner"
    text += f", {evidence.lost} that never came" if evidence.lost else ""
    if evidence.shots and not evidence.pairs:
        return Finding.fix("camera", text + ": check the trigger line, and that both cameras obey it")
    if evidence.lost > _UNPAIRED * 2 * max(evidence.pairs, 1):
        why = "the cameras, their link or this computer are too slow for so many shots"
        return Finding.fix("camera", f"{text}: {why}; lower TRG_RATE")
    if evidence.unpaired > _UNPAIRED * 2 * max(evidence.pairs, 1):
        return Finding.fix("camera", text + ": one camera misses shots, or the exposures are too far apart")
    return Finding.ok("camera", text)
