"""The live view in the terminal: what the service knows, four times a second."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from companion.cli.terminal.waiting import waiting_text
from companion.errors import missing_extra
from companion.evaluation.plan_outcomes import PlanOutcomes
from companion.records import (
    CorrectedRange,
    Health,
    ModeEstimate,
    ModeState,
    NoRange,
    Notice,
    Record,
    Reject,
    ServiceStatus,
)

_RECENT = 4  # chosen: sentences that stay on the screen and leave room for the figures
_TRUSTED = "trusted"


@dataclass(slots=True)
class View:
    """Collects records; :meth:`render` draws them. Plain lines are used where there is no terminal.

    ``progress`` stands in the place of the seconds that have passed, where those mean nothing.
    ``limit_s`` is when the run ends by itself, None where it does not.
    ``began`` says that the service ever got further than waiting for the vehicle.
    """

    title: str
    limit_s: float | None = None
    mode: ModeState | None = None
    range: CorrectedRange | None = None
    no_range: NoRange | None = None
    status: ServiceStatus | None = None
    plan_outcomes: PlanOutcomes = field(default_factory=PlanOutcomes)
    ranges: Counter[str] = field(default_factory=Counter)
    recent: list[str] = field(default_factory=list)
    progress: str = ""
    unprinted: list[str] = field(default_factory=list)
    began: bool = False
    _said_here: list[str] = field(default_factory=list)
    _refused: dict[str, int] = field(default_factory=dict)

    def take(self, record: Record) -> None:
        """Remember what the next drawing needs."""
        self.plan_outcomes.take(record)
        if isinstance(record, ModeState):
            self.mode = record
        elif isinstance(record, CorrectedRange):
            self.range = record
            self.ranges[_TRUSTED if record.trusted else str(record.reject)] += 1
        elif isinstance(record, NoRange):
            self.no_range = record
        elif isinstance(record, ServiceStatus):
            self.status = record
            self.began |= record.health is not Health.BOOT
        elif isinstance(record, Notice) and record.text not in self._said_here:
            self.say(record.text)

    def say(self, sentence: str, *, here: bool = False) -> None:
        """Show a sentence among the recent ones; one said ``here`` may come back as the ground heard it."""
        if here:
            self._said_here = [*self._said_here[-_RECENT + 1 :], sentence]
        self.recent = [*self.recent[-_RECENT + 1 :], sentence]
        self.unprinted.append(sentence)

    def sentences(self) -> list[str]:
        """Sentences since the last call, for printing line by line."""
        taken, self.unprinted = self.unprinted, []
        return taken

    def refusals(self) -> str | None:
        """One sentence of what was refused since the last call; None where nothing was."""
        counters = {} if self.status is None else self.status.counters
        now = {str(reason): counters[reason] for reason in Reject if counters.get(reason)}
        fresh = {reason: count - self._refused.get(reason, 0) for reason, count in now.items()}
        self._refused = now
        parts = [f"{count} {reason}" for reason, count in sorted(fresh.items()) if count > 0]
        return f"refused: {', '.join(parts)}" if parts else None

    def render(self, elapsed_s: float) -> Any:
        """Screen of a terminal, as something that rich draws."""
        from rich.console import Group  # an extra; plain lines do without
        from rich.table import Table
        from rich.text import Text

        table = Table.grid(padding=(0, 2))
        table.add_column(style="bold", width=10)
        table.add_column()
        for name, text in self._rows(elapsed_s):
            table.add_row(name, text)
        head = Text(f"{self.title}   {self.progress or f'{elapsed_s:5.1f} s'}", style="bold cyan")
        return Group(head, table, *(Text(f"  {line}", style="yellow") for line in self.recent))

    def line(self, elapsed_s: float) -> str:
        """One line for a log or a pipe."""
        return f"{self.progress or f'{elapsed_s:6.1f} s'}  " + " | ".join(
            f"{name} {text}" for name, text in self._rows(elapsed_s)
        )

    def waiting(self, elapsed_s: float) -> str | None:
        """Sentence of what is waited for; None where the service is at work, or shows a progress of its own."""
        return None if self.progress else waiting_text(self.status, elapsed_s, self.limit_s)

    def _rows(self, elapsed_s: float) -> list[tuple[str, str]]:
        if (awaited := self.waiting(elapsed_s)) is not None:
            return [("state", awaited)]
        rows = [("state", f"{self.status.health.value}: {self.status.reason}" if self.status else "starting")]
        if self.mode is not None:
            rows.append(("bending", _mode(self.mode.symmetric)))
            rows.append(("antisym.", _mode(self.mode.antisymmetric)))
        if plan_outcomes := self.plan_outcomes.counts():
            rows.append(("shots", ", ".join(f"{count} {outcome}" for outcome, count in plan_outcomes.items())))
        if self.range is not None:
            rows.append(("range", _range(self.range)))
            rows.append(("ranges", _ranges(self.ranges)))
        elif self.no_range is not None:
            rows.append(("range", f"none: {self.no_range.reject}"))
        return rows


def _mode(mode: ModeEstimate) -> str:
    return (
        f"{mode.frequency_hz:5.2f} ±{mode.frequency_sigma_hz:4.2f} Hz  damping {100 * mode.damping:4.1f} %  "
        f"amplitude {1e3 * mode.amplitude_m:5.2f} ±{1e3 * mode.amplitude_sigma_m:4.2f} mm  "
        f"phase {math.degrees(mode.phase_rad) % 360:5.1f}°"
    )


def _ranges(counts: Mapping[str, int]) -> str:
    """How many ranges went out, and how many did not, by reason."""
    withheld = ", ".join(f"{count} {kind}" for kind, count in counts.items() if kind != _TRUSTED)
    return f"{counts.get(_TRUSTED, 0)} published" + (f"; withheld: {withheld}" if withheld else "")


def _range(measured: CorrectedRange) -> str:
    if measured.range_m <= 0.0:  # the record's way to say that there is none
        return f"none: {measured.reject}"
    rigid = f"{measured.rigid_range_m:.1f} m" if measured.rigid_range_m > 0 else "beyond infinity"
    trust = "" if measured.trusted else f"  not published: {measured.reject}"
    return (
        f"{measured.range_m:6.2f} ±{measured.sigma_m:4.2f} m corrected by {1e3 * measured.toe_rad:+6.2f} mrad "
        f"(rigid stereo: {rigid}){trust}"
    )


def console() -> Any:
    """Terminal that rich draws on."""
    from rich.console import Console

    return Console(highlight=False)


def live_view_possible(*, plain: bool) -> bool:
    """Whether there is a terminal to draw on; where only the extra is missing for it, say so on standard error."""
    if plain or not sys.stdout.isatty():
        return False
    try:
        import rich  # noqa: F401 (looked for)
    except ImportError:
        print(f"{missing_extra('live views', 'report')}; plain lines meanwhile", file=sys.stderr)
        return False
    return True
