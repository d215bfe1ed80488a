"""Heartbeat, damage on the wire, routing, ids."""

from __future__ import annotations

from collections.abc import Iterator

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.link.signing import refusal_text
from companion.adapters.mavlink.vehicle.absence import absence_text
from companion.doctor.evidence import Evidence, Finding, FindingLevel

_LEAST_BEATS_HZ = 0.7  # chosen: heartbeats come once a second; three of ten lost are a bad link
_DAMAGE = 0.01  # convention: share of damaged frames worth a warning


def check_link(evidence: Evidence) -> Iterator[Finding]:
    """Whether an autopilot is there, heard whole, answers us, and whether our id is ours alone."""
    pilot = evidence.pilot
    if pilot is None and not evidence.live:
        text = "no MAVLink heartbeat is in this log (an autopilot's own log has none)"
        yield Finding("link", FindingLevel.UNKNOWN, text)
        return
    if pilot is None:
        text = absence_text(evidence.beats, junk=bool(evidence.skipped_bytes), refused=evidence.refused)
        yield Finding.fix("link", text)
        return
    rate_hz = pilot.count / evidence.seconds if evidence.seconds else 0.0
    names = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: " ArduPilot", mavlink.MAV_AUTOPILOT_PX4: " PX4"}
    text = f"autopilot {evidence.system}/1{names.get(pilot.autopilot, '')} beats at {rate_hz:.1f} Hz"
    if evidence.live and rate_hz < _LEAST_BEATS_HZ:
        text += ": frames are lost on the way, or a simulated vehicle's computer is too busy"
        yield Finding.fix("heartbeat", text)
    else:
        yield Finding.ok("heartbeat", text)
    yield from _wire(evidence)
    if evidence.live:
        yield from _routing(evidence)
        yield from _ids(evidence)


def _wire(evidence: Evidence) -> Iterator[Finding]:
    damaged = evidence.crc_errors / max(evidence.frames + evidence.crc_errors, 1)
    if damaged > _DAMAGE:
        text = f"{damaged:.1%} of the frames have a wrong checksum: lower the baud rate, or mend the cable"
        yield Finding.fix("wire", text)
    elif evidence.frames:
        yield Finding.ok("wire", f"{evidence.frames} frames, {damaged:.2%} damaged")
    if evidence.refused:
        yield Finding.fix("wire", refusal_text(evidence.refused))


def _routing(evidence: Evidence) -> Iterator[Finding]:
    if evidence.acknowledged or evidence.parameters:
        yield Finding.ok("routing", f"the autopilot answers component {evidence.settings.component_id}")
    else:
        text = (
            f"the autopilot answers nothing that {evidence.system}/{evidence.settings.component_id} asks: "
            "is the link one-way, or signed (--sign-key)?"
        )
        yield Finding.fix("routing", text)
    stations = [f"{s}/{c}" for (s, c), beat in evidence.beats.items() if beat.kind == mavlink.MAV_TYPE_GCS]
    if stations:
        yield Finding.ok("routing", f"ground station {', '.join(stations)} is heard")
    else:
        text = "no ground station is heard on this link: its parameter requests would not arrive"
        text += "; PX4 passes them on where MAV_n_FORWARD is 1" if evidence.px4 else ""
        yield Finding.note("routing", text)


def check_computer(evidence: Evidence) -> Iterator[Finding]:
    """Whether this computer lets the trigger be punctual, and samples wait for a busy reader."""
    if evidence.buffer_shortfall is not None:
        granted, wanted = evidence.buffer_shortfall
        text = (
            f"{granted:,} bytes may wait in a UDP socket, {wanted:,} are wanted: samples are lost in a pause of 0.2 s; "
            "`sudo sysctl -w net.core.rmem_max=4194304`, and for good /etc/sysctl.d (`spanwise setup` writes it)"
        )
        yield Finding.note("computer", text)
    if evidence.realtime is None or evidence.airframe.left_camera is None:
        return
    if evidence.realtime:
        yield Finding.ok("computer", "the trigger may take a real-time priority")
    else:
        text = "no real-time priority for this user: shots may be late by milliseconds"
        yield Finding.note("computer", f"{text}; LimitRTPRIO=50 in the service unit")


def _ids(evidence: Evidence) -> Iterator[Finding]:
    ours = evidence.settings.component_id
    if evidence.twice:
        text = f"another component speaks as {evidence.system}/{ours}: stop it (a second spanwise?), or set SW_COMPID"
        yield Finding.fix("ids", text)
    else:
        yield Finding.ok("ids", f"{evidence.system}/{ours} is ours alone")
    pilots = [
        f"{system}/{component}"
        for (system, component), beat in sorted(evidence.beats.items())
        if component == 1 and beat.autopilot != mavlink.MAV_AUTOPILOT_INVALID
    ]
    if len(pilots) > 1:
        text = f"several autopilots on this link ({', '.join(pilots)}): {pilots[0]} may not be the one meant"
        yield Finding.note("ids", text)
