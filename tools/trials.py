"""Blind trials of the diagnosis: effects hidden by an independent simulator, found by ``companion.diagnosis``.

    python -m tools.trials --each 1 --nothing 4 --seed 1

Labels are sealed by hash before the first diagnosis. A table, a JSON file and a confusion matrix go to out/trials.
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

from companion.core.wing.effects import catalogue
from companion.diagnosis.belief import believe
from companion.diagnosis.observations import RawRanges, RawRecording, RawStream, observe
from companion.diagnosis.search import diagnose
from companion.diagnosis.supermodel import SuperModel
from companion.diagnosis.verdict import Diagnosis
from companion.params.airframe import Airframe
from companion.params.files import parse_airframe
from companion.records import Side
from sitl_tests.trials.belief import airframe_text
from sitl_tests.trials.cases import SIGMA, Hidden, Tables, fly, hide, noise_density

_TOP_HZ = 51.2


def run(
    labels: Sequence[Hidden],
    snr_db: float,
    seed: int,
    leave_out: bool = False,
    kept: Path | None = None,
    duration_s: float = 60.0,
) -> list[dict[str, Any]]:
    """Fly and diagnose every label; one row each. ``leave_out`` takes the hidden effects from the catalogue.

    What is known so far is written to ``kept`` after each.
    """
    airframe = parse_airframe(airframe_text(noise_density(snr_db)), "trial")
    _show(f"flying {len(labels)} recordings of {duration_s:g} s")
    tables = fly(list(labels), snr_db, seed, duration_s)
    rows: list[dict[str, Any]] = []
    for i, (label, table) in enumerate(zip(labels, tables, strict=True)):
        begun = time.process_time()
        kinds = [kind for name, kind in catalogue().items() if not (leave_out and name in label.effects)]
        found = diagnose([model_of(table, airframe)], kinds)
        rows.append(judge(label, found, time.process_time() - begun))
        if kept is not None:
            kept.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
        right = sum(row["right"] for row in rows)
        _show(f"[{'#' * round(20 * (i + 1) / len(labels)):20s}] {i + 1}/{len(labels)}, right {right}")
    print(file=sys.stderr)
    return rows


def model_of(table: Tables, airframe: Airframe) -> SuperModel:
    """A trial's tables as the diagnosis sees a recording."""
    tips = {side: RawStream(table.t_s, table.force_z_mps2[:, side]) for side in Side}
    ranges = RawRanges(table.range_t_s, table.range_m, table.reference_m)
    raw = RawRecording(
        tips, None, ranges, {"roller_v": (table.t_s, table.roller), "airspeed_mps": (table.t_s, table.airspeed)}
    )
    seen = observe(raw, airframe, _TOP_HZ)
    return SuperModel(believe(airframe, seen.sides, True, False), seen, _TOP_HZ)


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
    inside = None
    if exact and len(hidden) == 1:
        cause, truth = found.causes[0], label.effects[hidden[0]]
        inside = any(abs(value - truth) < 1.96 * sigma for value, sigma in zip(cause.values, cause.sigmas, strict=True))
    explained = found.verdict in ("explained", "adequate")
    return {
        "hidden": label.effects,
        "seal": label.seal,
        "verdict": str(found.verdict),
        "named": named,
        "groups": [sorted(group) for group in groups],
        "nearest": found.nearest,
        "z": [cause.z for cause in found.causes],
        "right": bool(right and explained),
        "exact": bool(exact and explained),
        "inside_95": inside,
        "worst_check": [found.after[0].name, found.after[0].z] if found.after else None,
        "cpu_s": seconds,
    }


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw the confusion matrix."""
    from matplotlib.figure import Figure  # takes most of a second to import

    truths = sorted({name for row in rows for name in row["hidden"]} | {"nothing"})
    answers = sorted({*truths, *(name for row in rows for name in row["named"]), "unexplained"})
    counts = np.zeros((len(truths), len(answers)))
    for row in rows:
        answer = "unexplained" if row["verdict"] == "unexplained" else (row["named"] or ["nothing"])[0]
        for name in row["hidden"] or ["nothing"]:
            counts[truths.index(name), answers.index(answer)] += 1
    figure = Figure(figsize=(9, 8), layout="constrained")
    axis = figure.subplots()
    axis.imshow(counts, cmap="Blues")
    for (i, j), count in np.ndenumerate(counts):
        if count:
            axis.text(j, i, f"{count:g}", ha="center", va="center", fontsize=7)
    axis.set_xticks(range(len(answers)), answers, rotation=90, fontsize=7)
    axis.set_yticks(range(len(truths)), truths, fontsize=7)
    axis.set(xlabel="named", ylabel="hidden", title="Blind trials")
    figure.savefig(path, dpi=130)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the trials that were asked for and write what came out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=1, help="recordings for every effect")
    parser.add_argument("--nothing", type=int, default=4, help="recordings with nothing hidden")
    parser.add_argument("--pairs", type=int, default=0, help="recordings with two effects")
    parser.add_argument("--only", nargs="*", default=sorted(SIGMA), help="effects to hide")
    parser.add_argument("--strength", type=float, nargs=2, default=(8.0, 14.0), help="in posterior sigmas")
    parser.add_argument("--snr", type=float, default=20.0, help="dB")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--leave-out", action="store_true", help="take what is hidden from the catalogue")
    parser.add_argument("--out", type=Path, default=Path("out/trials"))
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(options.seed)
    strength = (options.strength[0], options.strength[1])
    labels = [hide([name], strength, rng) for name in options.only for _ in range(options.each)]
    labels += [hide(rng.choice(options.only, 2, replace=False).tolist(), strength, rng) for _ in range(options.pairs)]
    labels += [hide([], strength, rng) for _ in range(options.nothing)]
    order = rng.permutation(len(labels))
    labels = [labels[i] for i in order]
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "seals.txt").write_text("\n".join(label.seal for label in labels) + "\n", encoding="utf-8")
    rows = run(labels, options.snr, options.seed, options.leave_out, options.out / "trials.json")
    draw(rows, options.out / "confusion.png")
    _print(rows)
    return 0


def _print(rows: Sequence[dict[str, Any]]) -> None:
    for row in sorted(rows, key=lambda row: sorted(row["hidden"])):
        hidden = ", ".join(f"{name} {value:.3g}" for name, value in row["hidden"].items()) or "nothing"
        named = ", ".join("/".join(group) for group in row["groups"]) or "-"
        mark = "exact" if row["exact"] else "group" if row["right"] else "WRONG"
        print(f"{mark:6s} {hidden:40s} {row['verdict']:12s} {named}  ({row['cpu_s']:.0f} s)")
    hidden_rows = [row for row in rows if row["hidden"]]
    empty = [row for row in rows if not row["hidden"]]
    insides = [row["inside_95"] for row in rows if row["inside_95"] is not None]
    if hidden_rows:
        right, exact = (sum(row[key] for row in hidden_rows) for key in ("right", "exact"))
        print(f"right up to groups {right}/{len(hidden_rows)}, exact {exact}/{len(hidden_rows)}")
    if empty:
        print(f"false alarms {sum(not row['right'] for row in empty)}/{len(empty)}")
    if insides:
        print(f"truth inside the 95 % interval {sum(insides)}/{len(insides)}")


def _show(text: str) -> None:
    print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
