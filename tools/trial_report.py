"""Report of blind trials: the figures, the table, the confusion matrix."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

Rows = Sequence[dict[str, Any]]


def summary(rows: Rows) -> dict[str, Any]:
    """Counts by kind of trial and SNR: of each figure how many, and out of how many."""
    figures: dict[str, Any] = {}
    for snr in sorted({row["snr_db"] for row in rows}):
        at_snr = [row for row in rows if row["snr_db"] == snr]
        kinds = {
            "one effect": [row for row in at_snr if row["kind"] == "single" and not row["left_out"]],
            "one effect by strength": [row for row in at_snr if row["kind"] == "curve" and not row["left_out"]],
            "two effects": [row for row in at_snr if len(row["hidden"]) == 2 and not row["left_out"]],
            "three effects": [row for row in at_snr if len(row["hidden"]) == 3 and not row["left_out"]],
            "nothing hidden": [row for row in at_snr if not row["hidden"]],
            "left out of the catalogue": [row for row in at_snr if row["left_out"] and row["kind"] != "outside"],
            "never in the catalogue": [row for row in at_snr if row["kind"] == "outside"],
        }
        figures[f"{snr:g} dB"] = {name: _figures(name, of_kind) for name, of_kind in kinds.items() if of_kind}
    return figures


def _figures(name: str, rows: Rows) -> dict[str, Any]:
    count = len(rows)
    figures: dict[str, Any]

    def of(counted: int, total: int = count) -> list[int]:
        return [counted, total]

    seconds = {"cpu_s_median": float(np.median([row["cpu_s"] for row in rows]))}
    if name == "nothing hidden":
        return {"false alarms": of(sum(row["verdict"] != "adequate" for row in rows)), **seconds}
    if name in ("left out of the catalogue", "never in the catalogue"):
        unexplained = sum(row["verdict"] == "unexplained" for row in rows)
        wrong = sum(row["verdict"] == "explained" for row in rows)
        alike = sum(bool(row.get("own_group")) for row in rows)
        figures = {"unexplained": of(unexplained), "confident wrong name": of(wrong), "of its own group": of(alike)}
        return {**figures, **seconds}
    figures = {
        "right up to groups": of(sum(row["right"] for row in rows)),
        "exact": of(sum(row["exact"] for row in rows)),
        "unexplained": of(sum(row["verdict"] == "unexplained" for row in rows)),
        "wrong name": of(sum(row["verdict"] == "explained" and not row["right"] for row in rows)),
    }
    inside = [row["inside_95"] for row in rows if row["inside_95"] is not None]
    if inside:
        figures["truth inside the 95 % interval"] = of(sum(inside), len(inside))
    strengths = sorted({round(max(row["sigmas"].values())) for row in rows if row["sigmas"]})
    if name == "one effect by strength":
        figures["found by strength in sigma"] = {
            str(strength): of(
                sum(row["right"] for row in rows if _strength(row) == strength),
                sum(_strength(row) == strength for row in rows),
            )
            for strength in strengths
        }
    ratios = [row["gain"] / row["oracle_gain"] for row in rows if (row.get("oracle_gain") or 0.0) > 0.0]
    if ratios:
        figures["held-out gain against the oracle's"] = {"median": float(np.median(ratios)), "worst": min(ratios)}
    return {**figures, **seconds}


def _strength(row: dict[str, Any]) -> int | None:
    return round(max(row["sigmas"].values())) if row["sigmas"] else None


def table(rows: Rows, summarised: dict[str, Any]) -> str:
    """Every trial in one line, then the figures."""
    lines = [_line(row) for row in sorted(rows, key=lambda row: (row["left_out"], sorted(row["hidden"])))]
    for snr, kinds in summarised.items():
        for kind, figures in kinds.items():
            lines.append(f"\n{kind}, {snr}")
            for name, value in figures.items():
                lines.append(f"  {name:38s} {_value(value)}")
    return "\n".join(lines)


def _value(value: Any) -> str:
    if isinstance(value, list):
        counted, total = value
        return f"{counted}/{total} ({100.0 * counted / max(total, 1):.0f} %)"
    if isinstance(value, dict):
        return ", ".join(f"{key}: {_value(entry)}" for key, entry in value.items())
    return f"{value:.2f}"


def _line(row: dict[str, Any]) -> str:
    hidden = ", ".join(f"{name} {value:.3g}" for name, value in row["hidden"].items()) or "nothing"
    named = ", ".join("/".join(group) for group in row["groups"]) or f"(nearest {row['nearest'] or 'none'})"
    if row["left_out"]:
        mark = "good" if row["verdict"] == "unexplained" else "WRONG" if row["named"] else "missed"
        hidden += " (outside)" if row["kind"] == "outside" else " (left out)"
    else:
        mark = "exact" if row["exact"] else "group" if row["right"] else "missed" if not row["named"] else "WRONG"
    return f"{mark:6s} {hidden:58s} {row['verdict']:12s} {named}  ({row['cpu_s']:.0f} s)"


def draw(rows: Rows, path: Path) -> None:
    """Draw the confusion matrix of single effects: hidden down, named across; a group counts for its first member."""
    from matplotlib.figure import Figure  # takes most of a second to import

    single = [row for row in rows if row["kind"] in ("single", "nothing") and not row["left_out"]]
    if not single:
        return
    truths = ["nothing", *sorted({name for row in single for name in row["hidden"]})]
    named = sorted({row["named"][0] for row in single if row["named"]} | set(truths[1:]))
    predictions = ["nothing", *named, "unexplained"]
    counts, grouped = np.zeros((len(truths), len(predictions))), np.zeros((len(truths), len(predictions)), dtype=bool)
    for row in single:
        truth = next(iter(row["hidden"]), "nothing")
        predicted = "unexplained" if row["verdict"] == "unexplained" else (row["named"] or ["nothing"])[0]
        cell = truths.index(truth), predictions.index(predicted)
        counts[cell] += 1
        grouped[cell] |= row["right"] and not row["exact"]
    row_fraction = counts / np.maximum(counts.sum(1, keepdims=True), 1.0)
    size = 2.5 + 0.27 * len(predictions)
    figure = Figure(figsize=(size + 0.8, size), layout="constrained")
    axis = figure.subplots()
    image = axis.imshow(row_fraction, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (i, j), count in np.ndenumerate(counts):
        if count:
            text = f"{count:g}" + ("*" if grouped[i, j] else "")
            axis.text(
                j, i, text, ha="center", va="center", fontsize=8, color="white" if row_fraction[i, j] > 0.6 else "black"
            )
    axis.set_xticks(range(len(predictions)), predictions, rotation=90, fontsize=8)
    axis.set_yticks(range(len(truths)), truths, fontsize=8)
    axis.set_xticks(np.arange(-0.5, len(predictions)), minor=True)
    axis.set_yticks(np.arange(-0.5, len(truths)), minor=True)
    axis.grid(which="minor", color="#e3e8ee", lw=0.6)
    axis.tick_params(which="both", length=0)
    right = sum(row["right"] for row in single)
    axis.set(xlabel="named first", ylabel="hidden")
    axis.set_title(f"Blind trials: {right} of {len(single)} right (* up to its declared group)", fontsize=11)
    figure.colorbar(image, ax=axis, shrink=0.5, label="share of the row")
    figure.savefig(path, dpi=130)
