"""Heartbeat, damage on the wire, routing, ids."""

from __future__ import annotations

from collections.abc import Iterator

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.vehicle.absence import absence_text
from companion.doctor.evidence import Evidence, Finding, FindingLevel

_SUBJECT = "link"
_LEAST_BEATS_HZ = 0.7  # chosen: heartbeats come once a second; three of ten lost are a bad link
_DAMAGE = 0.01  # convention: share of damaged frames worth a warning


def check_link(evidence: Evidence) -> Iterator[Finding]:
    """Whether an autopilot is there, heard whole, answers us, and whether our id is ours alone."""
    pilot = evidence.pilot
    if pilot is None and not evidence.live:
        yield Finding(
            _SUBJECT, FindingLevel.UNKNOWN, "no MAVLink heartbeat is in this log (an autopilot's own log has none)"
        )
        return
    if pilot is None:
        text = absence_text(evidence.beats, junk=bool(evidence.skipped_bytes))
        yield Finding(_SUBJECT, FindingLevel.FIX, text)
        return
    rate_hz = pilot.count / evidence.seconds if evidence.seconds else 0.0
    names = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: " ArduPilot", mavlink.MAV_AUTOPILOT_PX4: " PX4"}
    name = names.get(pilot.autopilot, "")
    slow = evidence.live and rate_hz < _LEAST_BEATS_HZ
    text = f"autopilot {evidence.system}/1{name} beats at {rate_hz:.1f} Hz" + (
        ": frames are lost on the way, or a simulated vehicle's computer is too busy" if slow else ""
    )
    yield Finding("heartbeat", FindingLevel.FIX if slow else FindingLevel.OK, text)
    yield from _wire(evidence)
    if evidence.live:
        yield from _routing(evidence)
        yield from _ids(evidence)


def _wire(evidence: Evidence) -> Iterator[Finding]:
    damaged = evidence.crc_errors / max(evidence.frames + evidence.crc_errors, 1)
    if damaged > _DAMAGE:
        text = f"{damaged:.1%} of the frames have a wrong checksum: lower the baud rate, or mend the cable"
        yield Finding("wire", FindingLevel.FIX, text)
    elif evidence.frames:
        yield Finding("wire", FindingLevel.OK, f"{evidence.frames} frames, {damaged:.2%} damaged")


def _routing(evidence: Evidence) -> Iterator[Finding]:
    if evidence.acknowledged or evidence.parameters:
        yield Finding("routing", FindingLevel.OK, f"the autopilot answers component {evidence.settings.component_id}")
    else:
        text = (
            f"the autopilot answers nothing that {evidence.system}/{evidence.settings.component_id} asks: "
            "is the link one-way, or signed (--sign-key)?"
        )
        yield Finding("routing", FindingLevel.FIX, text)
    stations = [key for key, beat in evidence.beats.items() if beat.kind == mavlink.MAV_TYPE_GCS]
    text = "no ground station is heard on this link: its parameter requests would not arrive"
    if evidence.px4:
        text += "; PX4 passes them on where MAV_n_FORWARD is 1"
    if stations:
        text = "ground station " + ", ".join(f"{system}/{component}" for system, component in stations) + " is heard"
    yield Finding("routing", FindingLevel.OK if stations else FindingLevel.NOTE, text)


def check_computer(evidence: Evidence) -> Iterator[Finding]:
    """Whether this computer lets the trigger be punctual, and samples wait for a busy reader."""
    if evidence.buffer_shortfall is not None:
        granted, wanted = evidence.buffer_shortfall
        text = (
            f"{granted:,} bytes may wait in a UDP socket, {wanted:,} are wanted: samples are lost in a pause of 0.2 s; "
            "`sudo sysctl -w net.core.rmem_max=4194304`, and for good /etc/sysctl.d (`spanwise setup` writes it)"
        )
        yield Finding("computer", FindingLevel.NOTE, text)
    if evidence.realtime is None or evidence.airframe.left_camera is None:
        return
    if evidence.realtime:
        yield Finding("computer", FindingLevel.OK, "the trigger may take a real-time priority")
    else:
        text = (
            "no real-time priority for this user: shots may be late by milliseconds; LimitRTPRIO=50 in the service unit"
        )
        yield Finding("computer", FindingLevel.NOTE, text)


def _ids(evidence: Evidence) -> Iterator[Finding]:
    ours = evidence.settings.component_id
    if evidence.twice:
        text = f"another component speaks as {evidence.system}/{ours}: stop it (a second spanwise?), or set SW_COMPID"
        yield Finding("ids", FindingLevel.FIX, text)
    else:
        yield Finding("ids", FindingLevel.OK, f"{evidence.system}/{ours} is ours alone")
    pilots = [
        f"{system}/{component}"
        for (system, component), beat in sorted(evidence.beats.items())
        if component == 1 and beat.autopilot != mavlink.MAV_AUTOPILOT_INVALID
    ]
    if len(pilots) > 1:
        text = f"several autopilots on this link ({', '.join(pilots)}): {pilots[0]} may not be the one meant"
        yield Finding("ids", FindingLevel.NOTE, text)
