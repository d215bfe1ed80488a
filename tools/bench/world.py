"""The worlds' campaign: short flights in every world, judged by their truth: ``python -m tools.bench world``.

Rows: world x airframe x axes of the nodes, accidents in the ideal world, and flights that begin and end on the ground.
Flights are offline: the real pipeline on the records of a simulated flight, with synthetic matches (no images). They
are tasks as a fleet's are, for ``--workers`` processes or the Dask cluster of ``--scheduler``: each leaves a part file,
so that a campaign can be stopped and resumed; ``--table`` only prints what is there. Parts of different commits never
mix.

trusted: share of the shots with texture from 15 s in the air on, with Wilson's 95 % interval for as many independent
shots as their spread from flight to flight leaves; its target counts from
what the ideal world's row reaches, for a pair that looks ahead has ranges to obstacles that are near enough only, and
leaves out the share of shots whose stamps are wrong. toe: error of the relative toe at the cameras over all trusted
shots in the air from 15 s on, rms in mrad; NEES, its standard error by flights (the shots of one flight share an error
of toe), and share inside 1, 2, 3 sigma. wrong: published ranges of the whole flight off by more than 5 sigma and 5 %
from the true depth of their features, and by more than 20 %. axis: those off by more than 5 sigma and 5 % from the
first surface that the range axis meets, where it meets one: features lie beside the axis, 5 m apart from 80 m. peers:
rms above 0.5 Hz of the toe's error of the estimate where it is trusted, of each peer and of rigid stereo (the toe of
the calibration, whatever the wing does) over the same shots, and of the estimator itself on the same flights without
vibration and warm-up, with the true noise of the sensors (the reference).
constants: those that the tracker estimates, at the end of each flight, error over sigma: mean, rms, and share inside 3
sigma in all flights and by world.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Container
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.evaluation.fleet.campaign import work_off
from companion.evaluation.fleet.runner import stored
from companion.evaluation.metrics import SETTLED_S, UNANSWERED_S, is_wrong, rms, slow_part
from companion.records import Floats
from companion.sim.flight.worlds import WORLDS
from tools.bench.publish_results import commit
from tools.bench.world_constants import constants_table
from tools.bench.world_flight import CampaignTask, fly_task
from tools.bench.world_peers import PEERS
from tools.bench.world_rows import AIRFRAMES, SENSORS, CampaignRow, rows
from tools.trial_results import wilson

FLIGHTS = 50
_LEAST_TRUSTED = {"ideal": 0.9, "fair": 0.9, "tones": 0.9, "rough": 0.5}
_NEES = (0.8, 1.25)
_INSIDE_3_SIGMA = 0.99
_FAST_HZ = 0.5
_MOST_OVER_REFERENCE = 1.15
_RIGID = "rigid"  # its toe is that of the calibration, zero
_BESIDE = (_RIGID, *PEERS)


@dataclass(frozen=True, slots=True, eq=False)
class Pooled:
    """All flights of one row: their judged shots by column, which of them settled, and the reasons to withhold.

    ``failed`` flights left no shots; those that they should have had are among the ``expected``.
    """

    row: CampaignRow
    seeds: tuple[int, ...]
    expected: int
    flight: Floats
    columns: dict[str, Floats]
    aloft: Floats
    airborne_s: Floats
    reasons: Counter[str]
    constants: tuple[dict[str, list[float]], ...]
    failed: int = 0

    @property
    def flights(self) -> int:
        """How many there are."""
        return len(self.seeds)

    @property
    def trusted(self) -> Floats:
        """Mask (n,) of published shots."""
        return self.columns["trusted"] > 0.5

    @property
    def settled(self) -> Floats:
        """Mask (n,) of shots from :data:`SETTLED_S` on, in the air."""
        return (self.columns["t_s"] >= SETTLED_S) & (self.aloft > 0)

    @property
    def textured(self) -> Floats:
        """Mask (n,) of shots with matches enough for a range."""
        return self.columns["toe_sigma"] > 0.0

    @property
    def due(self) -> Floats:
        """Mask (n,) of shots from :data:`SETTLED_S` in the air on."""
        return self.settled & (self.airborne_s >= SETTLED_S)

    @property
    def awaited(self) -> Floats:
        """Mask (n,) of shots that should be trusted: due, and with texture."""
        return self.due & self.textured

    @property
    def toe_error(self) -> Floats:
        """Error of the estimate's toe, rad."""
        return self.columns["toe"] - self.columns["true_toe"]


def pooled(row: CampaignRow, parts: list[dict[str, Any]], failed: int = 0) -> Pooled:
    """Put the flights of a row together; of ``failed`` ones nothing came."""
    names = parts[0]["columns"]
    tables = [np.array(flown["judged"], dtype=np.float64).reshape(-1, len(names)) for flown in parts]
    aloft, airborne_s, expected = [], [], 0
    for flown, table in zip(parts, tables, strict=True):
        t_s = table[:, names.index("t_s")]
        aloft.append((t_s > flown["lift_off_s"]) & (t_s < flown["touch_down_s"]))
        airborne_s.append(t_s - flown["lift_off_s"])
        first_s = SETTLED_S + flown["lift_off_s"]
        # the last shots of a flight still wait for the smoother when it ends
        last_s = min(flown["touch_down_s"], flown["until_s"] - UNANSWERED_S)
        expected += max(round((last_s - first_s) / flown["shot_s"]), 0)
    return Pooled(
        row,
        tuple(flown["seed"] for flown in parts),
        round(expected * (1.0 + failed / len(parts))),
        np.concatenate([np.full(len(table), k) for k, table in enumerate(tables)]),
        dict(zip(names, np.concatenate(tables).T, strict=True)),
        np.concatenate(aloft),
        np.concatenate(airborne_s),
        sum((Counter(flown["withheld"]) + Counter(flown["refused"]) for flown in parts), Counter()),
        tuple(flown["constants"] for flown in parts),
        failed,
    )


def summary(group: Pooled) -> dict[str, float]:
    """Figures of one row."""
    c, trusted, settled = group.columns, group.trusted, group.settled
    good = trusted & settled
    published = int(np.sum(trusted & group.awaited))
    over = group.toe_error[good] / c["toe_sigma"][good]
    wrong, far = _off(group, "true_m")
    total = max(group.expected - int(np.sum(group.due & ~group.textured)), int(np.sum(group.awaited)))
    alike = _shots_alike(trusted[group.awaited].astype(np.float64), group.flight[group.awaited])
    low, high = wilson(published / alike, total / alike)
    figures = {"trusted": published / max(total, 1), "low": low, "high": high, "shots": total,
               "published": int(np.sum(trusted)), "toe_mrad": 1e3 * rms(group.toe_error[good]),
               "nees": float(np.mean(over**2)) if len(over) else math.nan,
               "nees_sigma": _sigma_by_flights(over**2, group.flight[good]),
               "wrong": wrong, "far": far, "axis": _off(group, "axis_m")[0],
               "on_ground": int(np.sum(trusted & ~(group.aloft > 0)))}  # fmt: skip
    for k in (1, 2, 3):
        figures[f"inside_{k}"] = float(np.mean(np.abs(over) <= k)) if len(over) else math.nan
    return figures | {f"fast {name}": _fast_mrad(group, name) for name in ("toe", *_BESIDE)}


def _off(group: Pooled, truth: str) -> tuple[int, int]:
    """Published ranges off by more than 5 sigma and 5 % from a column of true ones (NaN: not judged), and by 20 %."""
    c, trusted = group.columns, group.trusted
    range_m, sigma_m, true_m = (c[name][trusted] for name in ("range_m", "sigma_m", truth))
    return int(np.sum(is_wrong(range_m, sigma_m, true_m))), int(np.sum(np.abs(range_m - true_m) > 0.2 * true_m))


def _sigma_by_flights(values: Floats, flight: Floats) -> float:
    """Standard error of a mean of values (n,) that are independent from flight to flight only; NaN for one flight.

    That of a ratio estimator: Cochran (1977), *Sampling Techniques*, section 6.3.
    """
    flown = np.unique(flight)
    if len(flown) < 2:
        return math.nan
    mean = np.mean(values)
    beside = np.array([np.sum(values[flight == k] - mean) for k in flown])
    return float(math.sqrt(len(flown) / (len(flown) - 1) * np.sum(beside**2)) / len(values))


def _shots_alike(trusted: Floats, flight: Floats) -> float:
    """How many shots of a flight are worth one that is independent: the design effect of their share (Cochran)."""
    ratio, sigma = float(np.mean(trusted)) if len(trusted) else 1.0, _sigma_by_flights(trusted, flight)
    by_shots = ratio * (1.0 - ratio) / max(len(trusted), 1)
    return sigma**2 / by_shots if by_shots > 0.0 and sigma > 0.0 else 1.0


def missed(group: Pooled, figures: dict[str, float], near_enough: float = 1.0) -> list[str]:
    """Targets that a row misses; ``near_enough`` is the share that is trusted where only the distance is wrong."""
    possible = near_enough * (1.0 - group.row.accident.late_share)
    wrong = {
        "failed": group.failed > 0,
        "trusted": figures["trusted"] < _LEAST_TRUSTED[group.row.world] * possible,
        "NEES": not _NEES[0] <= figures["nees"] <= _NEES[1],
        "3 sigma": not figures["inside_3"] >= _INSIDE_3_SIGMA,
        "wrong": figures["wrong"] > 0,
        "> 20 %": figures["far"] > 0,
        "axis": figures["axis"] > 0,
        "on ground": figures["on_ground"] > 0,
    }
    return [name for name, failed in wrong.items() if failed]


def _against(reference: Pooled | None, group: Pooled) -> tuple[float, float]:
    """Fast error of the reference, mrad, and the row's over it in flights of the same seeds; NaN without one."""
    if reference is None or group.row.accident.name:
        return math.nan, math.nan
    least_mrad = _fast_mrad(reference, "toe", group.seeds)
    return least_mrad, _fast_mrad(group, "toe", reference.seeds) / least_mrad


def _conditions(row: CampaignRow) -> tuple[str, str, str]:
    return row.world, row.airframe, row.sensors


def _fast_mrad(group: Pooled, name: str, seeds: Container[int] | None = None) -> float:
    """Rms above :data:`_FAST_HZ` of one toe's error over all settled and trusted shots, flight by flight, mrad."""
    true_toe = group.columns["true_toe"]
    toe = np.zeros(len(true_toe)) if name == _RIGID else group.columns[name]
    squares, count = 0.0, 0
    for k, seed in enumerate(group.seeds):
        if seeds is not None and seed not in seeds:
            continue
        usable = (group.flight == k) & group.settled & group.trusted & np.isfinite(toe)
        if np.sum(usable) > 10:
            error = (toe - true_toe)[usable]
            fast = error - slow_part(group.columns["t_s"][usable], error, _FAST_HZ)
            squares, count = squares + float(np.sum(fast**2)), count + len(fast)
    return 1e3 * math.sqrt(squares / count) if count else math.nan


# ------------------------------------------------------------------------------------------------ flying


def campaign(wanted: list[CampaignRow], numbers: range, folder: Path, workers: int = 1, scheduler: str = "") -> None:
    """Fly what has no part file yet, number by number, so that a campaign cut short covers every row."""
    tasks = [CampaignTask(row, row.first_number + number, folder.resolve()) for number in numbers for row in wanted]
    tasks = [task for task in tasks if stored(task) is None]
    work_off(
        tasks,
        fly_task,
        workers,
        scheduler,
        lambda flown: f"{flown['row']}, {flown['airframe']}, seed {flown['seed']} flown",
    )


def gathered(wanted: list[CampaignRow], folder: Path) -> list[Pooled]:
    """Rows that have part files."""
    groups = []
    for row in wanted:
        parts = [json.loads(path.read_text()) for path in sorted((folder / row.key).glob("*.json"))]
        flights = [flown for flown in parts if not flown.get("failed")]
        if any(flown["judged"] for flown in flights):
            groups.append(pooled(row, flights, len(parts) - len(flights)))
        elif parts:
            reasons = {str(flown.get("failed", "no shot was judged")) for flown in parts}
            raise SystemExit(f"{row.key}: no flight gave a shot: {'; '.join(sorted(reasons))}")
    return groups


def show(groups: list[Pooled]) -> tuple[str, int]:
    """The tables as text, and how many rows and constants miss a target."""
    head = (
        f"{'world or accident':40s} {'airframe':11s} {'axes':8s} {'fl.':>3s} {'trusted':>7s} {'95 %':>11s} {'toe':>6s}"
        f" {'NEES':>6s} {'+-':>5s} {'1s':>4s} {'2s':>4s} {'3s':>5s} {'publ.':>6s} {'wrong':>5s}"
        f" {'>20%':>4s} {'axis':>4s}  misses"
    )
    lines, peers, failures = [head], [], 0
    fast = f"{'toe error above 0.5 Hz, mrad rms':60s} {'this':>7s} {'reference':>11s} {'ratio':>7s} "
    fast += " ".join(f"{name:>11s}" for name in _BESIDE)
    references = {_conditions(group.row): group for group in groups if group.row.reference}
    groups = [group for group in groups if not group.row.reference]
    figures = [summary(group) for group in groups]
    ideal = {g.row.airframe: f["trusted"] for g, f in zip(groups, figures, strict=True) if g.row.name == "ideal"}
    circuit = {g.row.airframe: f["trusted"] for g, f in zip(groups, figures, strict=True) if g.row.is_ideal_circuit}
    for group, f in zip(groups, figures, strict=True):
        near_enough = circuit if group.row.accident.circuit else ideal
        short = missed(group, f, near_enough.get(group.row.airframe, 1.0))
        reference, ratio = _against(references.get(_conditions(group.row)), group)
        if ratio > _MOST_OVER_REFERENCE:
            short.append("reference")
        failures += bool(short)
        name = f"{group.row.name:40s} {group.row.airframe:11s} {group.row.sensors:8s}"
        trusted = f"{100 * f['trusted']:6.1f}% {100 * f['low']:5.1f}-{100 * f['high']:5.1f}"
        nees = f"{f['nees']:6.2f} {f['nees_sigma']:5.2f}"
        inside = f"{100 * f['inside_1']:4.0f} {100 * f['inside_2']:4.0f} {100 * f['inside_3']:5.1f}"
        lines.append(
            f"{name} {group.flights:3d} {trusted} {f['toe_mrad']:6.3f} {nees} {inside} {f['published']:6.0f}"
            f" {f['wrong']:5.0f} {f['far']:4.0f} {f['axis']:4.0f}  {', '.join(short)}"
        )
        if not group.row.accident.name:
            others = " ".join(f"{f['fast ' + peer]:11.3f}" for peer in _BESIDE)
            peers.append(f"{name} {f['fast toe']:7.3f} {reference:11.3f} {ratio:7.2f} {others}")
    constants, off = constants_table((group.row.world, each) for group in groups for each in group.constants)
    lines += ["", fast, *peers, "", *constants, "", "why shots were withheld or refused, per flight:"]
    for group in groups:
        reasons = ", ".join(f"{reason} {count / group.flights:.0f}" for reason, count in group.reasons.most_common(6))
        lines.append(f"{group.row.name:40s} {group.row.airframe:11s} {group.row.sensors:8s} {reasons}")
    return "\n".join(lines), failures + off


def main(arguments: list[str] | None = None) -> int:
    """Fly, print, and give 1 where a row misses a target."""
    parser = argparse.ArgumentParser(prog="tools.bench world", description=__doc__)
    parser.add_argument("--flights", type=int, default=FLIGHTS, help="of every row")
    parser.add_argument("--first", type=int, default=0, help="number of the first flight")
    parser.add_argument("--world", default="", choices=["", *WORLDS])
    parser.add_argument("--airframe", default="", choices=["", *AIRFRAMES])
    parser.add_argument("--sensors", default="", choices=["", *SENSORS])
    parser.add_argument("--parts", type=Path, help="folder of the part files (default: out/world/COMMIT)")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--scheduler", default="", metavar="ADDRESS", help="a Dask cluster in place of processes")
    parser.add_argument("--table", action="store_true", help="fly nothing: print what there is")
    options = parser.parse_args(arguments)
    wanted = rows(options.world, options.airframe, options.sensors)
    folder = options.parts or Path("out/world") / commit()
    if not options.table:
        campaign(wanted, range(options.first, options.first + options.flights), folder, options.workers,
                 options.scheduler)  # fmt: skip
    text, failures = show(gathered(wanted, folder))
    print(text)
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
