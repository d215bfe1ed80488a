"""The fault table: each fault strikes a tracked flight; what happened, and how long it took to recover.

A fault lasts for two seconds where its name says nothing else.

``python -m sitl_tests.faults.vehicle_faults`` runs all and writes the table into ``sitl_tests/README.md``; with
``--seeds 2 3`` it strikes other flights and prints a line for each. The real loop, adapter and pipeline fly; vehicle,
wire and cameras are simulated (:mod:`sitl_tests.loop.simulated_service`).
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.params.files import load_airframe
from companion.records import CorrectedRange, Health, Rejected, ServiceStatus, Tick
from companion.sim.flight.aircraft import Jolt, demo_plan
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.vehicle.faults import Faults
from companion.sim.vehicle.lockstep import LockStepClock
from sitl_tests.faults import link_faults
from sitl_tests.faults.camera_faults import CameraFault, StruckCameras
from sitl_tests.faults.link_faults import LinkOutcome
from sitl_tests.faults.lying_samples import BLOWS_MPS2, HANDS
from sitl_tests.loop.simulated_service import EPOCH_NS, GROUND_M, SimulatedService

BEGIN_S, END_S, OVER_S = 13.0, 15.0, 24.0
SEED = 6  # of the flight whose table the README shows
_BEGIN_MARK, _END_MARK = "<!-- fault table: begin (generated) -->", "<!-- fault table: end -->"
_SIGMAS, _ERROR_RATIO = 5.0, 0.05

Meddle = Callable[[list[bytes], np.random.Generator], list[bytes]]


@dataclass(frozen=True)
class Fault:
    """Faults: the simulated vehicle's own, a hand on the frames that it sends, a blow to its cameras."""

    name: str
    faults: Faults = field(default_factory=Faults)
    meddle: Meddle | None = None
    deaf: bool = False
    cameras: CameraFault = field(default_factory=lambda: CameraFault("none"))
    hand: Callable[[], Meddle] | None = None  # makes what meddles: one that remembers since when
    blow_mps2: float = 0.0  # to the fuselage, for 20 ms; the wing answers
    begin_s: float = BEGIN_S


@dataclass(frozen=True)
class Outcome:
    """One row of the table.

    ``recovery_s`` is from the end of the fault to the range that ends the last pause; 0 where ranges never stopped for
    longer than the half second after which an autopilot forgets them. ``gap_s`` is the longest time without a trusted
    range from the fault on.
    """

    name: str
    recovery_s: float
    gap_s: float
    sent: int
    lost: int
    refused: dict[str, int]
    wrong: int
    trusted: int
    healths: tuple[Health, ...]


def _packer(component: int, system: int = 1) -> mavlink.MAVLink:
    return mavlink.MAVLink(None, system, component)


def _lost(frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
    return []


def _thinned(frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
    return [frame for frame in frames if rng.random() > 0.2]


def _garbage(frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
    out = []
    for frame in frames:
        cut = rng.random() < 0.05
        out += [rng.bytes(int(rng.integers(0, 40))), frame[: len(frame) // 2] if cut else frame]
    return out


def _doubled_and_shuffled(frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
    twice = [frame for frame in frames for _ in range(1 + (rng.random() < 0.3))]
    return [twice[k] for k in rng.permutation(len(twice))]


def _wild(component: int, system: int = 1) -> bytes:
    values = (90.0, -80.0, 70.0, 9.0, -9.0, 9.0)
    message = mavlink.MAVLink_highres_imu_message(123_456_789, *values, 0, 0, 0, 0, 0, 0, 0, 63)
    return bytes(message.pack(_packer(component, system)))


_SPOOFED = [_wild(158), _wild(202), _wild(200, system=77), _wild(1, system=77)]


def _spoofed(frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
    return [*frames, *_SPOOFED]


def _flood(frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
    return frames + 20 * max(len(frames), 1) * _SPOOFED[:1]


def _version_1(frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
    attitude = mavlink.MAVLink_attitude_message(1, 0.1, 0.1, 0.1, 0, 0, 0)
    return [*frames, bytes(attitude.pack(_packer(158), force_mavlink1=True))]


def _foreign_time(frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
    now = int(rng.integers(1, 1 << 40))
    answers = [mavlink.MAVLink_timesync_message(now, now).pack(_packer(c)) for c in (1, 200, 201)]
    asked = mavlink.MAVLink_timesync_message(0, now).pack(_packer(190, 255))
    return [*frames, *(bytes(frame) for frame in (*answers, asked))]


FAULTS = (
    Fault("none"),
    Fault("autopilot reboots, 2 s", Faults(reboots=((1, BEGIN_S, END_S - BEGIN_S),))),
    Fault("right node sends NaN", Faults(nans=((201, BEGIN_S, END_S),))),
    Fault("left node reboots, 2 s", Faults(reboots=((200, BEGIN_S, END_S - BEGIN_S),))),
    Fault("both nodes silent", Faults(silences=((200, BEGIN_S, END_S), (201, BEGIN_S, END_S)))),
    Fault("link silent both ways", meddle=_lost, deaf=True),
    Fault("a fifth of all frames lost", meddle=_thinned),
    Fault("garbage, truncated frames", meddle=_garbage),
    Fault("duplicated, reordered frames", meddle=_doubled_and_shuffled),
    Fault("flood at 20 x the rate", meddle=_flood),
    Fault("IMU spoofed by wrong components", meddle=_spoofed),
    Fault("MAVLink 1 frames among ours", meddle=_version_1),
    Fault("foreign TIMESYNC answers", meddle=_foreign_time),
    Fault("left node's stream stops", Faults(stops=((200, BEGIN_S, END_S),))),
    *(Fault(name, hand=hand) for name, hand in HANDS.items()),
    *(Fault(f"blow of {peak:g} m/s2 to the fuselage", blow_mps2=peak) for peak in BLOWS_MPS2),
)

_KNOCK = CameraFault("knock", 0.002, at_s=BEGIN_S)
CAMERA_FAULTS = (
    Fault("a camera knocked by 2 mrad", cameras=_KNOCK),
    Fault("a camera knocked by 2 mrad of toe alone", cameras=dataclasses.replace(_KNOCK, toe_only=True)),
    Fault("a fifth of the stamps 15 ms late, all the flight", cameras=CameraFault("late", late=0.2)),
)


def build(seed: int = SEED, jolts: tuple[Jolt, ...] = ()) -> Flight:
    """The flight that all faults strike."""
    plan = dataclasses.replace(demo_plan(OVER_S + 1.0), jolts=jolts)
    return build_flight(load_airframe("nadir-2m"), seed, plan=plan)


def strike(flight: Flight, fault: Fault) -> Outcome:
    """Fly, let the fault strike, and look."""
    if fault.blow_mps2:
        flight = build(flight.seed, (Jolt(fault.begin_s, fault.blow_mps2),))
    meddle = fault.hand() if fault.hand else fault.meddle
    end_s = fault.begin_s + END_S - BEGIN_S

    def struck(flight: Flight, clock: LockStepClock) -> StruckCameras:
        return StruckCameras(flight, clock, fault=fault.cameras)

    service = SimulatedService(flight, faults=fault.faults, cameras=struck)
    rng = np.random.default_rng(1)
    carry, drain = service.wire.send, service.wire.drain
    sent = 0

    def striking() -> bool:
        return fault.begin_s <= service.world.autopilot._tick_ns * 1e-9 < end_s

    def send(data: bytes | list[bytes]) -> bool:
        nonlocal sent
        if isinstance(data, bytes):
            return carry(data)
        sent += len(data)
        return carry(meddle(data, rng) if meddle and striking() else data)

    def heard() -> bytes:
        data = drain()
        return b"" if fault.deaf and striking() else data

    service.wire.send, service.wire.drain = send, heard  # type: ignore[method-assign]
    service.fly(OVER_S)
    service.close()
    return _judge(fault, service, sent)


def _judge(fault: Fault, service: SimulatedService, sent: int) -> Outcome:
    now_s, trusted_s, wrong, healths = 0.0, [fault.begin_s], 0, []
    refused: dict[str, int] = {}
    end_s = fault.begin_s + END_S - BEGIN_S
    for record in service.tape.records:
        if isinstance(record, Tick):
            now_s = (record.now_host_ns - EPOCH_NS) * 1e-9
        elif isinstance(record, CorrectedRange) and record.trusted:
            error_m = abs(record.range_m - GROUND_M)
            wrong += error_m > _SIGMAS * record.sigma_m and error_m > _ERROR_RATIO * GROUND_M
            if now_s >= fault.begin_s:
                trusted_s.append(now_s)
        elif isinstance(record, Rejected) and fault.begin_s <= now_s < OVER_S:
            refused[str(record.reason)] = refused.get(str(record.reason), 0) + record.count
        elif (
            isinstance(record, ServiceStatus)
            and now_s >= fault.begin_s
            and (not healths or healths[-1] is not record.health)
        ):
            healths.append(record.health)
    gaps_s = np.diff([*trusted_s, OVER_S])
    gap_s = float(np.max(gaps_s))
    stopped = np.flatnonzero(gaps_s > 0.5)
    ended_s = [*trusted_s, np.inf][int(stopped[-1]) + 1] if len(stopped) else end_s
    recovery_s = float(max(ended_s - end_s, 0.0))
    counters = service.autopilot.decoder.counters(0)
    lost = sent - counters.frames if fault.meddle in (_lost, _thinned, _garbage) else 0
    return Outcome(fault.name, recovery_s, gap_s, sent, lost, refused, wrong, len(trusted_s) - 1, tuple(healths))


def table(outcomes: list[Outcome]) -> str:
    """The rows as Markdown."""
    head = (
        "| fault | health told | longest time without a range | recovery after its end | frames lost | "
        "samples refused | ranges trusted / wrong |\n|---|---|---|---|---|---|---|\n"
    )
    rows = []
    for outcome in outcomes:
        health = " > ".join(str(entry) for entry in outcome.healths)
        refused = ", ".join(f"{count} {reason}" for reason, count in sorted(outcome.refused.items())) or "none"
        rows.append(
            f"| {outcome.name} | {health} | {outcome.gap_s:.2f} s | {outcome.recovery_s:.2f} s | {outcome.lost} | "
            f"{refused} | {outcome.trusted} / {outcome.wrong} |"
        )
    return head + "\n".join(rows) + "\n"


def write(outcomes: list[Outcome], page: Path, links: list[LinkOutcome] | None = None) -> None:
    """Put the tables into the page, between the marks (at the end, where it has none)."""
    text = page.read_text(encoding="utf-8")
    more = f"\nThe links' own faults, struck in real time:\n\n{link_faults.table(links)}" if links else ""
    block = f"{_BEGIN_MARK}\n{table(outcomes)}{more}{_END_MARK}"
    if _BEGIN_MARK in text:
        before, _, rest = text.partition(_BEGIN_MARK)
        _, _, after = rest.partition(_END_MARK)
        text = before + block + after
    else:
        text = f"{text.rstrip()}\n\n## Fault table\n\n{__doc__.splitlines()[0]}\n\n{block}\n"
    page.write_text(text, encoding="utf-8")


def strike_all(seed: int, name: str = "") -> Iterator[Outcome]:
    """Strike one flight with every fault whose name contains ``name``."""
    flight = build(seed)
    for fault in (*FAULTS, *CAMERA_FAULTS):
        if name in fault.name:
            yield strike(flight, fault)


def line(seed: int, outcomes: list[Outcome]) -> str:
    """One flight's faults in a line: ranges, wrong ones, and where the longest time without one was."""
    trusted, wrong = sum(entry.trusted for entry in outcomes), sum(entry.wrong for entry in outcomes)
    worst = max(outcomes, key=lambda entry: entry.gap_s)
    return (
        f"seed {seed}: {len(outcomes)} faults, {trusted} ranges trusted, {wrong} wrong; longest time without a range "
        f"{worst.gap_s:.2f} s ({worst.name})"
    )


def main(arguments: list[str] | None = None) -> int:
    """Strike with every fault and write the tables; 1 where a trusted range was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[], help="of other flights: printed, not written")
    parser.add_argument("--fault", default="", help="with --seeds: only those whose name contains this")
    options = parser.parse_args(arguments)
    outcomes = [_printed(seed, options.fault) for seed in options.seeds] if options.seeds else [_written()]
    return int(any(entry.wrong for flight in outcomes for entry in flight))


def _printed(seed: int, name: str) -> list[Outcome]:
    """Strike a flight and print a row for each fault, then the line."""
    outcomes = []
    for outcome in strike_all(seed, name):
        outcomes.append(outcome)
        print(table([outcome]).splitlines()[-1], flush=True)
    print(line(seed, outcomes) if outcomes else f"no fault's name contains '{name}'", flush=True)
    return outcomes


def _written() -> list[Outcome]:
    """Strike links and flight, and write the tables as they grow."""
    links = []
    for row in link_faults.outcomes():
        links.append(row)
        print(link_faults.table([row]).splitlines()[-1], flush=True)
    outcomes = []
    for outcome in strike_all(SEED):
        outcomes.append(outcome)
        print(table(outcomes[-1:]).splitlines()[-1], flush=True)
        write(outcomes, Path(__file__).resolve().parents[1] / "README.md", links)
    return outcomes


if __name__ == "__main__":
    sys.exit(main())
