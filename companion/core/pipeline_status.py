"""Self-description of the service, once a second: clocks, latency, health with its reason, counters."""

from __future__ import annotations

from companion.core.pipeline_state import PipelineState
from companion.core.silence import NO_PAIRS
from companion.params.airframe import Airframe
from companion.records import ClockName, Health, Notice, OutputRecord, Reject, ServiceStatus, Validity
from companion.units import Severity


def status(state: PipelineState, now_ns: int) -> list[OutputRecord]:
    """Records that tell how the service is: each clock, the trigger's latency, why no range comes, health."""
    health, reason = _health(state, now_ns)
    clocks = [state.clocks.state(name, now_ns) for name in _clocks_in_use(state.airframe)]
    latency = state.scheduling.latency.learned(now_ns) if state.scheduling is not None else None
    complaints = [*state.rate_monitor.complaints(), *state.tracker.complaints]
    say = reason if reason == NO_PAIRS else state.silence.due(reason, state.settings, now_ns)
    return [
        *clocks,
        *([] if latency is None else [latency]),
        *([] if say is None else [Notice(Severity.WARNING, say, now_ns)]),
        *(Notice(Severity.WARNING, text, now_ns) for text in state.complaints.due(complaints, now_ns)),
        ServiceStatus(now_ns, health, reason, dict(sorted(state.counters.items()))),
    ]


def _clocks_in_use(airframe: Airframe) -> list[ClockName]:
    names = {sensor.source.clock for sensor in (airframe.root, airframe.left, airframe.right)}
    return sorted(names - {ClockName.HOST})


def unsynced_clocks(state: PipelineState, now_ns: int) -> list[str]:
    """Names of the clocks that the airframe's sensors have and that are not synced."""
    return [str(name) for name in _clocks_in_use(state.airframe) if not state.clocks.state(name, now_ns).synced]


def _health(state: PipelineState, now_ns: int) -> tuple[Health, str]:
    unsynced = unsynced_clocks(state, now_ns)
    if state.validity is None:
        return Health.BOOT, "waiting for " + (", ".join(unsynced) + " clock" if unsynced else "inertial samples")
    if unsynced:
        return Health.CRITICAL, f"lost sync with {', '.join(unsynced)}"
    if state.scheduling is not None and state.scheduling.blind(now_ns):
        return Health.CRITICAL, NO_PAIRS
    if tracked(state):
        early = unlearned(state)
        if early is not None:
            return Health.STANDBY, f"{state.validity}; no range yet: {early}"
        silence = state.silence.reason(state.settings) if state.correction is not None else None
        return (Health.ACTIVE, motion_text(state)) if silence is None else (Health.STANDBY, silence)
    if state.validity is Validity.INCONSISTENT:
        return Health.CRITICAL, state.tracker.contradiction.sentence
    if state.validity is Validity.SETTLING:
        return Health.STANDBY, str(state.validity)
    return Health.CRITICAL, str(state.validity)


def tracked(state: PipelineState) -> bool:
    """Whether the wing is known well enough to plan shots, and so for ranges to come."""
    return state.validity in (Validity.TRACKING, Validity.CALM)


def unlearned(state: PipelineState) -> Reject | None:
    """Why the tracker would withhold every range for now, on an airframe that has cameras."""
    return state.tracker.distrust if state.correction is not None else None


def motion_text(state: PipelineState) -> str:
    """``tracking`` only where the stronger mode's swing stands out from its own sigma."""
    mode = state.tracker.describe()
    if state.validity is not Validity.TRACKING or mode is None:
        return str(state.validity)
    strongest = max(mode.symmetric, mode.antisymmetric, key=lambda each: each.rms_m)
    return str(state.validity) if strongest.swings else "swing within its uncertainty"
