"""Health of the service over a recording: how long it was active, since when, and how it was with the last samples."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from companion.records import OVERLOADED, Health, ImuBatch, Notice, Reject, Rejected, ServiceStatus, Shot, Side

_END_S = 3.0  # a recorder that is stopped after the sensors writes on for so long: a flight's end, no fault (choice)
_LOST_RATIO = 0.05  # convention: of the images, as the doctor warns; beyond, cameras or computer are too slow
_MOSTLY = 0.9  # of the time after the first active status (choice)


@dataclass(slots=True)
class ServiceHealth:
    """Statuses in the order of time, one a second, and when the last sample was received, on the host's clock.

    ``overloads`` is how often the machine was said not to keep up; of ``shots``, ``lost_images`` never came.
    """

    statuses: list[ServiceStatus] = field(default_factory=list)
    last_sample_ns: int = 0
    overloads: int = 0
    shots: int = 0
    lost_images: int = 0

    def take(self, record: object) -> None:
        """Look at a record of any kind."""
        if isinstance(record, ServiceStatus):
            self.statuses.append(record)
        elif isinstance(record, ImuBatch) and record.t_ns.size:
            self.last_sample_ns = max(self.last_sample_ns, record.received_host_ns)
        elif isinstance(record, Notice):
            self.overloads += record.text.startswith(OVERLOADED)
        elif isinstance(record, Shot):
            self.shots += 1
        elif isinstance(record, Rejected) and record.reason is Reject.FRAME_LOST:
            self.lost_images += record.count

    @property
    def silence_s(self) -> float:
        """Time from the last sample to the last status, where that is longer than a flight's end; else 0."""
        if not self.statuses or not self.last_sample_ns:
            return 0.0
        silence_s = (self.statuses[-1].at_host_ns - self.last_sample_ns) * 1e-9
        return silence_s if silence_s > _END_S else 0.0

    def is_end(self, at_host_ns: int) -> bool:
        """Whether this was after the last sample, in the moment that ends every recording."""
        return 0 < self.last_sample_ns < at_host_ns and not self.silence_s

    def flown(self) -> list[ServiceStatus]:
        """Statuses that are not of the end: the streams had not been stopped yet."""
        return [status for status in self.statuses if not self.is_end(status.at_host_ns)] or self.statuses

    @property
    def active_ratio(self) -> float:
        """Share of the flight's statuses that were active; 0 without any."""
        flown = self.flown()
        return sum(status.health is Health.ACTIVE for status in flown) / max(len(flown), 1)

    @property
    def first_active_s(self) -> float | None:
        """Time from the flight's first status to its first active one; None where none was active before the end."""
        flown = self.flown()
        active_ns = [status.at_host_ns for status in flown if status.health is Health.ACTIVE]
        return (active_ns[0] - flown[0].at_host_ns) * 1e-9 if active_ns else None

    def summary(self) -> str:
        """How long it was active and how it was with the last samples, in a line; empty without statuses."""
        if not self.statuses:
            return ""
        state = f"with the last samples {_state(self.flown()[-1])}"
        if self.silence_s:
            state = f"no samples in the last {self.silence_s:.1f} s: {_state(self.statuses[-1])}"
        first_s = self.first_active_s
        if first_s is None:
            return f"never active; {state}"
        return f"active {100 * self.active_ratio:.0f} % of the time, first after {first_s:.1f} s; {state}"

    def answer(self) -> str:
        """Whether it was well, in a sentence that says what the warm-up has to do with its figure."""
        if not self.statuses:
            return "no status recorded"
        first_s = self.first_active_s
        if first_s is None:
            return f"no: it was never active; {self.summary().partition('; ')[2]}"
        text = f"{self._since_first()} after a warm-up of {first_s:.0f} s (clocks and wing are learned)"
        text += "".join(f"; {trouble}" for trouble in self._troubles())
        text += f"; no samples came in the last {self.silence_s:.0f} s" if self.silence_s else ""
        return f"{text}. With the warm-up, active {100 * self.active_ratio:.0f} % of the time"

    def _since_first(self) -> str:
        """How it was from the first active status on, with the most frequent states of the rest."""
        flown = self.flown()
        begun = flown[next(i for i, status in enumerate(flown) if status.health is Health.ACTIVE) :]
        others = Counter(_state(status) for status in begun if status.health is not Health.ACTIVE)
        if not others:
            return f"{'mostly' if self._troubles() else 'yes'}: active without a break"
        ratio = 1.0 - others.total() / len(begun)
        rest = ", ".join(f"{state} ({count} s)" for state, count in others.most_common(2))
        word = "mostly" if ratio >= _MOSTLY else "not always"
        return f"{word}: active {100 * ratio:.0f} % of the time (else {rest})"

    def _troubles(self) -> list[str]:
        """Losses that no status says: the state stays active while shots go without a range."""
        times = "once" if self.overloads == 1 else f"{self.overloads} times"
        troubles = [f"the machine could not keep up (said {times})"] if self.overloads else []
        if self.lost_images > _LOST_RATIO * len(Side) * self.shots:
            troubles.append(f"{self.lost_images} images of {self.shots} shots never came")
        return troubles


def _state(status: ServiceStatus) -> str:
    return f"{status.health}: {status.reason}" if status.reason else str(status.health)
