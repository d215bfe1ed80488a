"""Blind trials of the diagnosis: effects hidden by an independent simulator, found by ``companion.diagnosis``.

    python -m tools.trials                          one recording for every effect, a few with nothing hidden
    python -m tools.trials --acceptance             all that is promised, some hours; the same again goes on
    python -m tools.trials --leave-out              what is hidden is taken from the catalogue
    python -m tools.trials --pairs 20 --each 0      two effects at once
    python -m tools.trials --curve 2 4 6 8          how strong an effect must be to be found
    python -m tools.trials --generator stranger     any of these by the other hand, with --outside what no catalogue has
    python -m tools.trials --snr 10 --seed 5 --add  more of them, at 10 dB, beside those of earlier runs
    python -m tools.trials --show                   tabulate what earlier runs have left in the folder

Labels are sealed by hash before the first diagnosis. Rows, a summary, a table (RESULTS.md) and a confusion matrix go to
out/trials; ``--publish`` also writes the last two into sitl_tests/trials, the other hand's alone into its own.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from companion.core.wing.effects import catalogue
from companion.diagnosis.data.observations import RawRanges, RawRecording, RawStream
from companion.diagnosis.data.resampling import observe
from companion.diagnosis.flights.outcome import FlightDiagnosis
from companion.diagnosis.flights.proposals import candidates_of, find_proposals
from companion.diagnosis.flights.recordings import diagnose
from companion.diagnosis.flights.screen import screen
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.selection.forward_selection import SAME
from companion.evaluation.flight_models import belief_for
from companion.params.airframe import Airframe
from companion.records import Side
from sitl_tests.trials.cases import SEEN, Hidden, Tables
from tools.trial_generators import FIRST, GENERATORS, STRANGER, Generator
from tools.trial_oracle import oracle_gain
from tools.trial_plan import STRONG, Trial, acceptance, nothing, outside, several, singles, strangers_acceptance
from tools.trial_report import draw, summary, table
from tools.trial_results import commit, results

_BATCH = 60
_PUBLISHED = Path(__file__).resolve().parents[1] / "sitl_tests" / "trials"
Rows = list[dict[str, Any]]


def run(batches: Sequence[Sequence[Trial]], seed: int, kept: Path | None = None, duration_s: float = 60.0) -> Rows:
    """Fly and diagnose every batch; a row for each judgement, in the plan's order.

    What is known so far is in ``kept`` after each row; trials that have their rows there are not judged again.
    """
    rows: Rows = json.loads(kept.read_text(encoding="utf-8")) if kept is not None and kept.is_file() else []
    done = {(row["seal"], row["left_out"]) for row in rows}
    total, begun = sum(len(trial.judged) for batch in batches for trial in batch), time.monotonic()
    judged, code = 0, commit()
    for number, batch in enumerate(batches):
        open_ = [trial for trial in batch if any((trial.label.seal, out) not in done for out in trial.judged)]
        judged += sum(len(trial.judged) for trial in batch if trial not in open_)
        if not open_:
            continue
        _show(f"flying {len(batch)} recordings of {duration_s:g} s")
        flown = batch[0].hand.fly(
            [trial.label for trial in batch],
            [trial.snr_db for trial in batch],
            seed + number,
            duration_s,
            [trial.corner_hz for trial in batch],
        )
        for trial, tables in zip(batch, flown, strict=True):
            for out in trial.judged if trial in open_ else ():
                rows.append({**judge_trial(trial, tables, out), "seed": seed, "commit": code})
                judged += 1
                if kept is not None:
                    kept.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
                _show(_bar(rows, judged, total, time.monotonic() - begun))
    print(file=sys.stderr)
    return rows


def judge_trial(trial: Trial, tables: Tables, leave_out: bool) -> dict[str, Any]:
    """Diagnose one recording, then open its label."""
    begun = time.process_time()
    airframe = trial.hand.airframe(trial.snr_db, trial.corner_hz)
    kinds = [kind for name, kind in catalogue().items() if not (leave_out and name in trial.label.effects)]
    model = model_of(tables, airframe, trial.hand.top_hz)
    found = diagnose([model], kinds)
    row = judge(trial.label, found, time.process_time() - begun, trial.snr_db, swings(tables, trial.hand))
    if trial.oracle and not leave_out and found.gain is not None:
        row["oracle_gain"] = oracle_gain(model, found.null, trial.label)
    if leave_out and found.causes:
        row["own_group"] = own_group(model, found, trial.label)
    row |= {"generator": trial.generator}
    return {**row, "kind": trial.kind, "snr_db": trial.snr_db, "corner_hz": trial.corner_hz, "left_out": leave_out}


def own_group(model: FlightModel, found: FlightDiagnosis, label: Hidden) -> bool:
    """Whether this recording cannot tell what was hidden from a name that was given for it (scores that are one)."""
    names = {*(set(label.effects) & set(catalogue())), *(cause.term.effect.name for cause in found.causes)}
    kinds = [catalogue()[name] for name in sorted(names)]
    offered = candidates_of(kinds, sorted(model.observations.covariates), find_proposals([model], found.null))
    screening = screen([model], found.null, offered)
    mine = [one.name in label.effects for one in screening.candidates]
    across = np.abs(screening.correlation[np.ix_(mine, np.logical_not(mine))])
    return bool(across.size and np.max(across) > SAME)


def model_of(tables: Tables, airframe: Airframe, top_hz: float = 51.2) -> FlightModel:
    """A trial's tables as the diagnosis sees a recording."""
    tips = {side: RawStream(tables.t_s, tables.force_z_mps2[:, side]) for side in Side}
    ranges = RawRanges(tables.range_t_s, tables.range_m, tables.reference_m)
    channels = {"roller_v": (tables.t_s, tables.roller), "airspeed_mps": (tables.t_s, tables.airspeed)}
    rigid = dict(tables.root)
    root = RawStream(*rigid.pop("z")) if rigid else None
    (seen,) = observe(RawRecording(tips, root, ranges, channels, rigid), airframe, top_hz)
    return FlightModel(belief_for(airframe, [[seen]]), seen, top_hz)


def swings(tables: Tables, hand: Generator = FIRST) -> dict[str, float]:
    """How large the rms of a channel is in this very recording, in the units of the effect that follows it.

    A channel counts by its rms over the recording, and slow waves of unit rms have another one in a minute.
    """
    return {
        "covariate-frequency": float(np.std(tables.roller)),
        "airspeed-dependence": float(np.std(tables.airspeed)) / hand.airspeed_rms_mps,
    }


def judge(
    label: Hidden,
    found: FlightDiagnosis,
    seconds: float,
    snr_db: float = 20.0,
    units: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, Any]:
    """Open the label and compare; ``units`` by effect: what one unit of its magnitude is in the diagnosis' own."""
    named = [cause.term.effect.name for cause in found.causes]
    groups = [{cause.term.effect.name, *cause.group} for cause in found.causes]
    hidden = sorted(label.effects)
    if not hidden:
        right = exact = found.verdict == "adequate"
    else:
        right = len(named) == len(hidden) and all(any(name in group for group in groups) for name in hidden)
        exact = sorted(named) == hidden
    return {
        "hidden": label.effects,
        "sigmas": {
            name: label.strength(name, snr_db) for name in label.effects if name in catalogue() and name not in SEEN
        },
        "seal": label.seal,
        "verdict": str(found.verdict),
        "reason": found.reason,
        "named": named,
        "groups": [sorted(group) for group in groups],
        "nearest": found.nearest,
        "nearest_causes": [cause.term.effect.name for cause in found.nearest_causes],
        "z": [cause.z for cause in found.causes],
        "right": bool(right and found.verdict in ("explained", "adequate")),
        "exact": bool(exact and found.verdict in ("explained", "adequate")),
        "inside_95": _inside(label, found, units) if exact and len(hidden) == 1 else None,
        "gain": found.gain.log_score["total"][0] if found.gain is not None else None,
        "worst_checks": [[entry.name, entry.z] for entry in found.after[:3]],
        "cpu_s": seconds,
    }


def _inside(label: Hidden, found: FlightDiagnosis, units: Mapping[str, float]) -> bool | None:
    """Whether the hidden magnitude lies in the interval of the parameter that it is."""
    ((name, truth),) = label.effects.items()
    cause = found.causes[0]
    if name in SEEN or name in ("tone", "periodic-forcing", "parametric-stiffness", "impulsive-forcing"):
        return None  # told by amplitude and phase, or seen without a fit
    which = label.side if name in ("accel-scale", "accel-bias") else 0
    return abs(cause.values[which] - truth * units.get(name, 1.0)) < 1.96 * cause.sigmas[which]


def _plan(options: argparse.Namespace) -> list[list[Trial]]:
    hand = GENERATORS[options.generator]
    if options.acceptance:
        return acceptance(options.seed) if hand is FIRST else strangers_acceptance(options.seed)
    rng = np.random.default_rng(options.seed)
    judged = (options.leave_out,)
    trials: list[Trial] = []
    for _ in range(options.each):
        names = [name for name in options.only or hand.names if name not in SEEN or not options.curve]
        for size in options.curve or [None]:
            strength = (size, size) if size else tuple(options.strength)
            kind = "curve" if size else "single"
            trials += singles(rng, options.snr, names, strength, judged, options.oracle, kind, hand)
    trials += [*several(rng, 2, options.pairs, hand=hand), *several(rng, 3, options.triples, hand=hand)]
    trials += [trial for _ in range(options.outside) for trial in outside(rng, hand)]
    if not (options.leave_out or options.curve):
        trials += nothing(rng, options.nothing, options.snr, hand=hand)
    trials = [trials[i] for i in rng.permutation(len(trials))]
    return [trials[first : first + _BATCH] for first in range(0, len(trials), _BATCH)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the trials that were asked for and write what came out."""
    options = _parser().parse_args(arguments)
    kept = options.out / "trials.json"
    options.out.mkdir(parents=True, exist_ok=True)
    if options.show:
        rows = json.loads(kept.read_text(encoding="utf-8"))
    else:
        goes_on = options.add or options.acceptance
        batches = _plan(options)
        with (options.out / "seals.txt").open("a" if goes_on else "w", encoding="utf-8") as seals:
            seals.write("\n".join(trial.label.seal for batch in batches for trial in batch) + "\n")
        if not goes_on:
            kept.unlink(missing_ok=True)
        rows = run(batches, options.seed, kept, options.duration)
    found = summary(rows)
    (options.out / "summary.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    (options.out / "RESULTS.md").write_text(results(rows), encoding="utf-8")
    draw(rows, options.out / "confusion.png")
    if options.publish:
        # a table of one truth alone does not replace that of the other
        alone = all(row.get("generator") == STRANGER.name for row in rows)
        for name in ("RESULTS.md", "confusion.png"):
            shutil.copyfile(options.out / name, (_PUBLISHED / STRANGER.name if alone else _PUBLISHED) / name)
    print(table(rows, found))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--acceptance", action="store_true", help="all that is promised; goes on where it was left")
    parser.add_argument("--each", type=int, default=1, help="recordings for every effect")
    parser.add_argument("--nothing", type=int, default=8, help="recordings with nothing hidden")
    parser.add_argument("--pairs", type=int, default=0, help="recordings with two effects")
    parser.add_argument("--triples", type=int, default=0, help="recordings with three effects")
    parser.add_argument("--only", nargs="*", default=[], help="effects to hide, of all")
    parser.add_argument("--generator", choices=sorted(GENERATORS), default=FIRST.name, help="whose truth")
    parser.add_argument("--outside", type=int, default=0, help="times everything that no catalogue has")
    parser.add_argument("--strength", type=float, nargs=2, default=STRONG, help="in posterior sigmas")
    parser.add_argument("--curve", type=float, nargs="*", default=[], help="exact strengths instead, in sigmas")
    parser.add_argument("--snr", type=float, default=20.0, help="dB")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--duration", type=float, default=60.0, help="seconds of each recording")
    parser.add_argument("--leave-out", action="store_true", help="take what is hidden from the catalogue")
    parser.add_argument("--oracle", action="store_true", help="also measure the gain of the true effect")
    parser.add_argument("--add", action="store_true", help="beside the rows that are in the folder")
    parser.add_argument("--show", action="store_true", help="fly nothing: tabulate the rows that are in the folder")
    parser.add_argument("--publish", action="store_true", help="write RESULTS.md and confusion.png beside the trials")
    parser.add_argument("--out", type=Path, default=Path("out/trials"))
    return parser


def _bar(rows: Rows, judged: int, total: int, seconds: float) -> str:
    good = sum(row["verdict"] == "unexplained" if row["left_out"] else row["right"] for row in rows)
    spent = f"{seconds / 60.0:.0f} min"
    return f"[{'#' * round(24 * judged / total):24s}] {judged}/{total}, right {good} of {len(rows)}, {spent}"


def _show(text: str) -> None:
    print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
