"""Cost of the live view to the process that flies: nobody looks, a page is open, all is followed, nothing is read.

A producer hands over the records of a flight (counts a second of the demo's recording) at twice its pace; figures are
processor time of that process, its sending thread included, per second of flight, and the time that handing over one
record takes, exceeded by one in a thousand: so long can a plan or a shot be held up. Each is the least of five rounds.
"""

from __future__ import annotations

import multiprocessing
import socket
import sys
import time
from collections.abc import Callable

import numpy as np

from companion.adapters.recordings.mcap.channels import Recordable
from companion.adapters.recordings.mcap.recorder_client import RecorderReceiver, recorder_channel
from companion.live.feed import ALWAYS, BIT, RECORDED, FeedEnd, Interest, LiveFeed
from companion.records import (
    Axis,
    ClockName,
    ClockState,
    CorrectedRange,
    Firing,
    Health,
    ImuBatch,
    MatchSet,
    ModeEstimate,
    ModeState,
    NoRange,
    RawChunk,
    ServiceStatus,
    Shot,
    Station,
    Tick,
    TriggerPlan,
    Validity,
    VehicleState,
)

LONGEST_MS = 1.0  # of handing over a record: plans are made tens of milliseconds ahead
TARGET_MS = 1.0  # of processor time a second while nobody looks: a thousandth of a core
_FLOWN_S = 6.0
_REPEATS = 5  # flights in every state, of which the cheapest counts (choice)
_PACE = 2.0  # times the flight's own
_TURN_S = 0.01
_PAGE = (ModeState, CorrectedRange, NoRange, TriggerPlan, Shot, ServiceStatus, ClockState, MatchSet)
_NO_MASK = 0


def flight_second() -> list[Recordable]:
    """Records of one second, in the numbers of the demo's recording."""
    mode = ModeEstimate(5.0, 0.1, 0.03, 0.01, 0.005, 0.0002, 0.1, 0.1, 5.0, 0.1, 0.003)
    axes, pair_px = (Axis.ALL,) * 3, np.zeros((180, 2))
    t_ns, values = np.arange(3) * 1_000_000, np.zeros((3, 6))
    kinds: list[tuple[int, Recordable]] = [
        (787, ImuBatch(Station.LEFT, ClockName.HOST, t_ns, values, Axis.ALL, 0)),
        (287, RawChunk(0, 0, bytes(220))),
        (105, Tick(0)),
        (22, TriggerPlan(0, Firing.PEAK, 0, 0, 0, 0.5, 0, 0)),
        (20, VehicleState(0, 0, 0.0, 0.0, 0.0, 17.0, 0.0, 0.5, True)),
        (8, Shot(0, 0, 0)),
        (8, MatchSet(0, 0, (ClockName.HOST,) * 2, np.zeros(2, np.int64), 0, 0, pair_px, pair_px, np.ones(180), 0)),
        (8, CorrectedRange(0, 0, 0, 25, 60.0, 0.3, 0.04, 0.0, 27.0, 170, True, None)),
        (4, ModeState(0, mode, mode, Validity.TRACKING, np.zeros(2), np.zeros(2), tuple(Station), axes)),
        (3, ClockState(ClockName.BOOT, 0, 0, 0.0, 0, True)),
        (1, ServiceStatus(0, Health.ACTIVE, "tracking", {"samples left": 1000})),
    ]
    return [record for count, record in kinds for _ in range(count)]


def run() -> list[tuple[str, float, float, int]]:
    """Give a row per state: name, ms of processor time a second of flight, ms of a hand-over, records dropped."""
    second = flight_second()
    page = ALWAYS
    for kind in _PAGE:
        page |= BIT[kind]
    states: list[tuple[str, int | None, bool]] = [
        ("no live view", None, True),
        ("nobody looks", ALWAYS, True),
        ("a page is open", page, True),
        ("everything is followed", ALWAYS | RECORDED, True),
        ("everything, and never read", ALWAYS | RECORDED, False),
    ]
    rounds = [[_measured(second, mask, is_read=is_read) for _, mask, is_read in states] for _ in range(_REPEATS)]
    return [(name, *map(min, zip(*(row[place] for row in rounds), strict=True))) for place, (name, _, _) in
            enumerate(states)]  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    del arguments
    rows = run()
    bare_ms = rows[0][1]
    for name, cost_ms, longest_ms, dropped in rows:
        lost = f", {dropped} records dropped" if dropped else ""
        print(
            f"{name:28s} {cost_ms:7.2f} ms of processor time a second ({cost_ms - bare_ms:+.2f} ms), "
            f"{longest_ms:.3f} ms a record (99.9 %){lost}"
        )
    print(f"targets: nobody looks <= {TARGET_MS:g} ms a second more than no live view; a record <= {LONGEST_MS:g} ms")
    return int(rows[1][1] - bare_ms > TARGET_MS or max(row[2] for row in rows) > LONGEST_MS)


def _measured(second: list[Recordable], mask: int | None, *, is_read: bool) -> tuple[float, float, int]:
    end, theirs = recorder_channel()
    spawn = multiprocessing.get_context("spawn")
    reader = spawn.Process(target=_drain, args=(theirs,), daemon=True) if is_read and mask is not None else None
    if reader is not None:
        reader.start()
    interest = Interest()
    interest.mask = _NO_MASK if mask is None else mask
    feed = LiveFeed(FeedEnd(end, interest))
    cost_s, longest_s = _handed_over(second, _forget if mask is None else feed.write)
    dropped = feed.dropped
    theirs.close()
    if reader is not None:
        reader.terminate()
        reader.join()
    feed.close()
    end.close()
    return 1e3 * cost_s / _FLOWN_S, 1e3 * longest_s, dropped


def _handed_over(second: list[Recordable], write: Callable[[Recordable], None]) -> tuple[float, float]:
    """Processor time of handing over the flight in turns of the loop, and the time exceeded by a thousandth, s."""
    took_ns = []
    turns = round(1.0 / _TURN_S)
    began_s, used_s = time.monotonic(), time.process_time()
    for turn in range(round(_FLOWN_S / _TURN_S)):
        for record in second[turn % turns :: turns]:
            at_ns = time.perf_counter_ns()
            write(record)
            took_ns.append(time.perf_counter_ns() - at_ns)
        time.sleep(max(0.0, began_s + (turn + 1) * _TURN_S / _PACE - time.monotonic()))
    return time.process_time() - used_s, 1e-9 * float(np.percentile(took_ns, 99.9))


def _forget(record: Recordable) -> None:
    del record


def _drain(end: socket.socket) -> None:
    receiver = RecorderReceiver(end)
    while (batch := receiver.receive()) is None or batch.records or not batch.last:
        pass


if __name__ == "__main__":
    sys.exit(main())
