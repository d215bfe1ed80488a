"""Blind trials of the diagnosis: effects hidden by an independent simulator, found by ``companion.diagnosis``.

    python -m tools.trials                          one recording for every effect, a few with nothing hidden
    python -m tools.trials --leave-out              what is hidden is taken from the catalogue
    python -m tools.trials --pairs 20 --each 0      two effects at once
    python -m tools.trials --curve 2 4 6 8          how strong an effect must be to be found
    python -m tools.trials --snr 10 --seed 5 --add  more of them, at 10 dB, beside those of earlier runs
    python -m tools.trials --show                   tabulate what earlier runs have left in the folder

Labels are sealed by hash before the first diagnosis. Rows, a summary and a confusion matrix go to out/trials.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from companion.cli.diagnose_models import belief_for
from companion.core.wing.effects import catalogue
from companion.diagnosis.fit import fit
from companion.diagnosis.gain import held_out
from companion.diagnosis.observations import RawRanges, RawRecording, RawStream, observe
from companion.diagnosis.search import diagnose
from companion.diagnosis.supermodel import SuperModel
from companion.diagnosis.verdict import Diagnosis
from companion.params.airframe import Airframe
from companion.params.files import parse_airframe
from companion.records import Side
from sitl_tests.trials.belief import airframe_text
from sitl_tests.trials.cases import SEEN, SIGMA, Hidden, Tables, fly, hide, noise_density
from tools.trial_report import draw, summary, table

_TOP_HZ = 51.2
_BATCH = 40


def run(
    labels: Sequence[Hidden],
    snr_db: float,
    seed: int,
    leave_out: bool = False,
    oracle: bool = False,
    kept: Path | None = None,
    duration_s: float = 60.0,
) -> list[dict[str, Any]]:
    """Fly and diagnose every label; one row each. ``leave_out`` takes the hidden effects from the catalogue.

    ``oracle`` also measures the held-out gain of the true effect. What is known so far is added to ``kept`` each time.
    """
    airframe = parse_airframe(airframe_text(noise_density(snr_db)), "trial")
    rows: list[dict[str, Any]] = []
    before = json.loads(kept.read_text()) if kept is not None and kept.is_file() else []
    begun = time.monotonic()
    for first in range(0, len(labels), _BATCH):
        batch = list(labels[first : first + _BATCH])
        _show(f"flying {len(batch)} recordings of {duration_s:g} s")
        for label, tables in zip(batch, fly(batch, snr_db, seed + first, duration_s), strict=True):
            row = judged(label, tables, airframe, leave_out, oracle)
            rows.append({**row, "snr_db": snr_db, "seed": seed, "left_out": leave_out})
            if kept is not None:
                kept.write_text(json.dumps(before + rows, indent=1) + "\n", encoding="utf-8")
            _show(_bar(rows, len(labels), time.monotonic() - begun))
    print(file=sys.stderr)
    return before + rows


def judged(label: Hidden, tables: Tables, airframe: Airframe, leave_out: bool, oracle: bool) -> dict[str, Any]:
    """Diagnose one recording, then open its label."""
    begun = time.process_time()
    kinds = [kind for name, kind in catalogue().items() if not (leave_out and name in label.effects)]
    model = model_of(tables, airframe)
    found = diagnose([model], kinds)
    row = judge(label, found, time.process_time() - begun)
    if oracle and row["exact"] and found.gain is not None:
        true = fit([model], found.final.parts, found.final.values)
        row["oracle_gain"] = held_out([model], found.null, true).log_score["total"][0]
    return row


def model_of(tables: Tables, airframe: Airframe) -> SuperModel:
    """A trial's tables as the diagnosis sees a recording."""
    tips = {side: RawStream(tables.t_s, tables.force_z_mps2[:, side]) for side in Side}
    ranges = RawRanges(tables.range_t_s, tables.range_m, tables.reference_m)
    channels = {"roller_v": (tables.t_s, tables.roller), "airspeed_mps": (tables.t_s, tables.airspeed)}
    seen = observe(RawRecording(tips, None, ranges, channels), airframe, _TOP_HZ)
    return SuperModel(belief_for(airframe, [seen]), seen, _TOP_HZ)


def judge(label: Hidden, found: Diagnosis, seconds: float) -> dict[str, Any]:
    """Open the label and compare."""
    named = [cause.part.effect.name for cause in found.causes]
    groups = [{cause.part.effect.name, *cause.group} for cause in found.causes]
    hidden = sorted(label.effects)
    if not hidden:
        right = exact = found.verdict == "adequate"
    else:
        right = len(named) == len(hidden) and all(any(name in group for group in groups) for name in hidden)
        exact = sorted(named) == hidden
    return {
        "hidden": label.effects,
        "sigmas": {name: abs(value) / SIGMA[name] for name, value in label.effects.items() if name in SIGMA},
        "seal": label.seal,
        "verdict": str(found.verdict),
        "named": named,
        "groups": [sorted(group) for group in groups],
        "nearest": found.nearest,
        "nearest_causes": [cause.part.effect.name for cause in found.nearest_causes],
        "z": [cause.z for cause in found.causes],
        "right": bool(right and found.verdict in ("explained", "adequate")),
        "exact": bool(exact and found.verdict in ("explained", "adequate")),
        "inside_95": _inside(label, found) if exact and len(hidden) == 1 else None,
        "gain": found.gain.log_score["total"][0] if found.gain is not None else None,
        "worst_checks": [[entry.name, entry.z] for entry in found.after[:3]],
        "cpu_s": seconds,
    }


def _inside(label: Hidden, found: Diagnosis) -> bool | None:
    """Whether the hidden magnitude lies in the interval of the parameter that it is."""
    ((name, truth),) = label.effects.items()
    cause = found.causes[0]
    if name in SEEN or name in ("tone", "periodic-forcing", "parametric-stiffness", "impulsive-forcing"):
        return None  # told by amplitude and phase, or seen without a fit
    which = label.side if name in ("accel-scale", "accel-bias") else 0
    return abs(cause.values[which] - truth) < 1.96 * cause.sigmas[which]


def _labels(options: argparse.Namespace) -> list[Hidden]:
    rng = np.random.default_rng(options.seed)
    strengths = [(s, s) for s in options.curve] or [(options.strength[0], options.strength[1])]
    names = [name for name in options.only if name in SIGMA or not options.curve]
    labels = [hide([name], strength, rng) for strength in strengths for name in names for _ in range(options.each)]
    fitted = [name for name in names if name in SIGMA]
    for count, wanted in ((2, options.pairs), (3, options.triples)):
        labels += [hide(rng.choice(fitted, count, replace=False).tolist(), strengths[0], rng) for _ in range(wanted)]
    if not (options.leave_out or options.curve):
        labels += [hide([], strengths[0], rng) for _ in range(options.nothing)]
    return [labels[i] for i in rng.permutation(len(labels))]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the trials that were asked for and write what came out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=1, help="recordings for every effect")
    parser.add_argument("--nothing", type=int, default=8, help="recordings with nothing hidden")
    parser.add_argument("--pairs", type=int, default=0, help="recordings with two effects")
    parser.add_argument("--triples", type=int, default=0, help="recordings with three effects")
    parser.add_argument("--only", nargs="*", default=sorted({*SIGMA, *SEEN}), help="effects to hide")
    parser.add_argument("--strength", type=float, nargs=2, default=(8.0, 14.0), help="in posterior sigmas")
    parser.add_argument("--curve", type=float, nargs="*", default=[], help="exact strengths instead, in sigmas")
    parser.add_argument("--snr", type=float, default=20.0, help="dB")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--duration", type=float, default=60.0, help="seconds of each recording")
    parser.add_argument("--leave-out", action="store_true", help="take what is hidden from the catalogue")
    parser.add_argument("--oracle", action="store_true", help="also measure the gain of the true effect")
    parser.add_argument("--add", action="store_true", help="beside the rows that are in the folder")
    parser.add_argument("--show", action="store_true", help="fly nothing: tabulate the rows that are in the folder")
    parser.add_argument("--out", type=Path, default=Path("out/trials"))
    options = parser.parse_args(arguments)
    kept = options.out / "trials.json"
    options.out.mkdir(parents=True, exist_ok=True)
    if options.show:
        rows = json.loads(kept.read_text(encoding="utf-8"))
    else:
        labels = _labels(options)
        with (options.out / "seals.txt").open("a" if options.add else "w", encoding="utf-8") as seals:
            seals.write("\n".join(label.seal for label in labels) + "\n")
        if not options.add:
            kept.unlink(missing_ok=True)
        rows = run(labels, options.snr, options.seed, options.leave_out, options.oracle, kept, options.duration)
    found = summary(rows)
    (options.out / "summary.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    draw(rows, options.out / "confusion.png")
    print(table(rows, found))
    return 0


def _bar(rows: Sequence[dict[str, Any]], count: int, seconds: float) -> str:
    done = len(rows)
    left = seconds / done * (count - done)
    good = sum(row["verdict"] == "unexplained" if row["left_out"] else row["right"] for row in rows)
    return f"[{'#' * round(24 * done / count):24s}] {done}/{count}, right {good}, {left / 60.0:.0f} min left"


def _show(text: str) -> None:
    print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
