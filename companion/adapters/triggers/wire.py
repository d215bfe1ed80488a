"""Wire format between the service and the trigger process: small messages with a checksum."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from companion.records import Firing, Reject, Rejected, Shot, TriggerPlan

LARGEST = 512  # chosen: bytes of a message: a plan and a long reason fit in
_PLAN = struct.Struct("<Bqqqqqqdbb")
_SHOT = struct.Struct("<Bqqq")
_REJECTED = struct.Struct("<Bbqq")
_READY = struct.Struct("<B???")
_CHECK = struct.Struct("<I")
_FIRINGS = tuple(Firing)
_REJECTS = tuple(Reject)
_IS_PLAN, _IS_SHOT, _IS_REJECTED, _IS_READY = 1, 2, 3, 4  # first byte of a message (convention)


@dataclass(frozen=True, slots=True)
class Realtime:
    """Scheduling rights that the operating system granted to the trigger process."""

    fifo: bool
    memory_locked: bool
    timer_slack: bool

    def sentence(self) -> str:
        """Say it to the operator."""
        if self.fifo and self.memory_locked:
            return "trigger process runs with real-time priority and locked memory"
        missing = [
            name
            for name, granted in (
                ("real-time priority (CAP_SYS_NICE or rtprio)", self.fifo),
                ("locked memory (memlock)", self.memory_locked),
            )
            if not granted
        ]
        return f"trigger process has no {' and no '.join(missing)}: shots may be late by milliseconds under load"


Report = Shot | Rejected | Realtime


def pack_plan(plan: TriggerPlan) -> bytes:
    """Encode a plan."""
    reject = -1 if plan.reject is None else _REJECTS.index(plan.reject)
    return _sealed(
        _PLAN.pack(
            _IS_PLAN,
            plan.plan_id,
            plan.command_host_ns,
            plan.exposure_host_ns,
            plan.sigma_ns,
            plan.expires_host_ns,
            plan.planned_host_ns,
            plan.blur_px,
            _FIRINGS.index(plan.firing),
            reject,
        )
    )


def unpack_plan(message: bytes) -> TriggerPlan | None:
    """Decode a plan; None for anything that is not one."""
    body = _opened(message, _IS_PLAN, _PLAN.size)
    if body is None:
        return None
    _, plan_id, command, exposure, sigma, expires, planned, blur, firing, reject = _PLAN.unpack(body)
    if not (0 <= firing < len(_FIRINGS) and -1 <= reject < len(_REJECTS)):
        return None
    reason = None if reject < 0 else _REJECTS[reject]
    return TriggerPlan(plan_id, _FIRINGS[firing], command, exposure, sigma, blur, expires, planned, reason)


def pack_report(report: Report) -> bytes:
    """Encode what the trigger process says."""
    if isinstance(report, Shot):
        return _sealed(_SHOT.pack(_IS_SHOT, report.plan_id, report.planned_host_ns, report.fired_host_ns))
    if isinstance(report, Realtime):
        return _sealed(_READY.pack(_IS_READY, report.fifo, report.memory_locked, report.timer_slack))
    head = _REJECTED.pack(_IS_REJECTED, _REJECTS.index(report.reason), report.at_host_ns, report.count)
    return _sealed(head + report.what.encode()[: LARGEST - _REJECTED.size - _CHECK.size])


def unpack_report(message: bytes) -> Report | None:
    """Decode a report; None for anything that is not one."""
    kind = message[0] if message else 0
    if kind == _IS_SHOT and (body := _opened(message, _IS_SHOT, _SHOT.size)):
        return Shot(*_SHOT.unpack(body)[1:])
    if kind == _IS_READY and (body := _opened(message, _IS_READY, _READY.size)):
        return Realtime(*_READY.unpack(body)[1:])
    if kind == _IS_REJECTED and (body := _opened(message, _IS_REJECTED)) and len(body) >= _REJECTED.size:
        _, reason, at_ns, count = _REJECTED.unpack_from(body)
        if 0 <= reason < len(_REJECTS):
            return Rejected(_REJECTS[reason], body[_REJECTED.size :].decode(errors="replace"), at_ns, count)
    return None


def _sealed(body: bytes) -> bytes:
    return body + _CHECK.pack(zlib.crc32(body))


def _opened(message: bytes, kind: int, size: int | None = None) -> bytes | None:
    body, check = message[: -_CHECK.size], message[-_CHECK.size :]
    wrong_size = size is not None and len(body) != size
    if not body or wrong_size or body[0] != kind or check != _CHECK.pack(zlib.crc32(body)):
        return None
    return body
