"""Choice of the autopilot to serve: the configured one, else the first that beats and answers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from companion.records import Notice
from companion.units import Severity

_SILENT_NS = 5_000_000_000  # chosen: five heartbeats must be missing before another autopilot is served
_MOST_OTHERS = 8  # bound of memory and of sentences
_CONFIRMATIONS = 3  # heartbeats or answers: a stray frame moves nothing (choice)


class VehicleChoice:
    """Follows the autopilots' heartbeats and who answers our TIMESYNC.

    Another autopilot takes the place of one that has not beaten for 5 s, or that has not answered for 5 s while the
    other does. It must have beaten, or answered, three times meanwhile, so that one stray frame moves nothing. An
    autopilot that has answered, or beaten while armed, three times is ours for good: it may reboot in flight, and
    another aircraft in earshot must not get its ranges and commands.

    ``configured`` is the only system that may be served, 0 for any; ``system`` is the one that is served, and
    ``others`` are further systems whose autopilot was heard. ``candidate`` is one of them that beats while ours for
    good is silent.
    """

    def __init__(self, configured: int = 0) -> None:
        self.system: int | None = None
        self.others: set[int] = set()
        self.candidate: int | None = None
        self._proofs = 0  # answers and armed heartbeats of the served one
        self._configured = configured
        self._beat_host_ns = self._answer_host_ns = 0  # of the served one
        self._beats: Counter[int] = Counter()  # of others, since the served one's last
        self._answers: Counter[int] = Counter()  # likewise

    def beat(self, system: int, now_host_ns: int, *, armed: bool = False) -> bool:
        """Take note of an autopilot's heartbeat; True where it has taken the place of another."""
        if self.system is None and self._configured in (0, system):
            self._serve(system, now_host_ns)
        if system == self.system:
            self._beat_host_ns = now_host_ns
            self._beats.clear()
            self._proofs += armed
            self.candidate = None
            return False
        self.others.add(system)
        if self.system is None or self._configured:
            return False
        self._beats[system] += 1
        silent = now_host_ns - self._beat_host_ns > _SILENT_NS and self._beats[system] >= _CONFIRMATIONS
        mute = now_host_ns - self._answer_host_ns > _SILENT_NS and self._answers[system] >= _CONFIRMATIONS
        if self._proofs >= _CONFIRMATIONS:
            self.candidate = system if silent and self.candidate is None else self.candidate
            return False
        if silent or mute:
            self.others ^= {system, self.system}
            self._serve(system, now_host_ns)
        return silent or mute

    def answered(self, system: int, now_host_ns: int) -> None:
        """Take note of an answer to our TIMESYNC from an autopilot."""
        if system == self.system:
            self._answer_host_ns = now_host_ns
            self._answers.clear()
            self._proofs += 1
        else:
            self._answers[system] += 1

    def _serve(self, system: int, now_host_ns: int) -> None:
        self.system = system
        self._proofs = 0
        self._beat_host_ns = self._answer_host_ns = now_host_ns
        self._beats.clear()
        self._answers.clear()


class ChoiceNotices:
    """Says that another autopilot is heard too, once for each, and that the served one has changed or is silent."""

    def __init__(self) -> None:
        self._served: int | None = None
        self._candidate: int | None = None
        self._named: set[int] = set()

    def due(self, choice: VehicleChoice, now_host_ns: int) -> Iterator[Notice]:
        """Sentences of which the operator does not know yet."""
        served, candidate = choice.system, choice.candidate
        before, self._served = self._served, served
        candidate_before, self._candidate = self._candidate, candidate
        if candidate is not None and candidate != candidate_before:
            text = f"autopilot {served}/1 is silent; {candidate}/1 is not served: set SW_SYSID or restart Spanwise"
            yield Notice(Severity.WARNING, text, now_host_ns)
        if before is not None and before != served:
            yield Notice(Severity.WARNING, f"autopilot {before}/1 is silent: serving {served}/1 now", now_host_ns)
            self._named.add(before)
        for system in sorted(choice.others - self._named)[:_MOST_OTHERS]:
            self._named.add(system)
            if served is not None and len(self._named) <= _MOST_OTHERS:
                text = f"autopilot {system}/1 is heard too: serving {served}/1 (SW_SYSID chooses)"
                yield Notice(Severity.WARNING, text, now_host_ns)
