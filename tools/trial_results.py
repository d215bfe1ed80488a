"""Results of the blind trials as a page that is kept beside them: every figure with its count and interval."""

from __future__ import annotations

import math
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

Rows = Sequence[dict[str, Any]]
_Z = 1.959964
_WANTED = {
    ("single", 20.0, "right up to groups"): ">= 95 %",
    ("single", 20.0, "exact"): ">= 90 %",
    ("single", 10.0, "right up to groups"): ">= 90 %",
    ("nothing", None, "false alarms"): "0 of 300",
    ("left out", 20.0, "unexplained"): ">= 80 %",
    ("left out", 30.0, "unexplained"): ">= 90 %",
    ("left out", 20.0, "confident wrong name"): "<= 10 %",
    ("left out", 30.0, "confident wrong name"): "<= 10 %",
    ("outside the catalogue", 20.0, "unexplained"): ">= 80 %",
    ("outside the catalogue", 20.0, "confident wrong name"): "<= 10 %",
    ("pair", 20.0, "exact"): ">= 85 %",
    ("curve 5", 20.0, "right up to groups"): ">= 50 %",
    ("curve 8", 20.0, "right up to groups"): ">= 95 %",
    ("interval", None, "truth inside 95 %"): "90 to 98 %",
    ("gain", None, "median"): ">= 95 %",
    ("gain", None, "worst"): ">= 85 %",
}


_HANDS = ("first", "stranger")


def results(rows: Rows) -> str:
    """Markdown: both truths side by side."""
    commits = sorted({row["commit"] for row in rows})
    tables = [_figures([row for row in rows if row.get("generator", "first") == hand]) for hand in _HANDS]
    lines = [
        "# Results of the blind trials",
        "",
        f"Written by `python -m tools.trials`; judged by the code of {', '.join(commits)}:",
        f"{_flown(rows, 'first', 615)} of the first truth (`wing.py`), {_flown(rows, 'stranger', 238)} of the second",
        "(`stranger/`), 60 s each, stereo at 10 Hz and 0.3 px, unmeasured gust, belief perturbed; neither shares",
        "code with the diagnosis. The first has two 1 kHz accelerometers, the second a root sensor and two of 800 Hz,",
        "a fuselage that recoils, and manoeuvres in half of its flights. Shares have Wilson's intervals, 95 %. A wrong",
        "name is of what was hidden's own group where this recording cannot tell the two (their scores correlate",
        "beyond 0.95).",
        "",
        "| trials | figure | first | second | wanted |",
        "|---|---|---|---|---|",
    ]
    for key in dict.fromkeys(key for table in tables for key in table):
        (title, figure), wanted = key, next(table[key][1] for table in tables if key in table)
        cells = " | ".join(table[key][0] if key in table else "" for table in tables)
        lines.append(f"| {title} | {figure} | {cells} | {wanted} |")
    lines += ["", "![confusion matrix](confusion.png)", "", *_misses(rows), ""]
    return "\n".join(lines)


def _flown(rows: Rows, hand: str, promised: int) -> str:
    """How many judgements there are of those that are promised."""
    return f"{sum(row.get('generator', 'first') == hand for row in rows)} judgements of {promised}"


def _figures(rows: Rows) -> dict[tuple[str, str], tuple[str, str]]:
    """Cell and what is wanted, by title and figure."""
    table: dict[tuple[str, str], tuple[str, str]] = {}
    for kind, snr, of_kind in _parts(rows):
        title = kind + (f", {snr:g} dB" if snr is not None else "")
        for name, counted in _counts(kind, of_kind).items():
            table[title, name] = _proportion(counted, len(of_kind)), _WANTED.get((kind, snr, name), "")
    return table | _intervals(rows) | _gains(rows) | _seconds(rows)


def wilson(counted: float, total: float) -> tuple[float, float]:
    """95 % interval of a share."""
    if not total:
        return 0.0, 1.0
    p, z2 = counted / total, _Z**2 / total
    middle, half = p + 0.5 * z2, _Z * math.sqrt(p * (1.0 - p) / total + 0.25 * z2 / total)
    return max((middle - half) / (1.0 + z2), 0.0), min((middle + half) / (1.0 + z2), 1.0)


def _proportion(counted: int, total: int) -> str:
    low, high = wilson(counted, total)
    return f"{counted}/{total}: {100 * counted / total:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def _parts(rows: Rows) -> list[tuple[str, float | None, Rows]]:
    groups: list[tuple[str, float | None, Rows]] = []
    for kind in ("single", "pair", "triple"):
        for snr in sorted({row["snr_db"] for row in rows}, reverse=True):
            groups.append((kind, snr, [r for r in rows if _is(r, kind) and r["snr_db"] == snr]))
    for strength in sorted({_strength(row) for row in rows if _is(row, "curve")}):
        of_strength = [row for row in rows if _is(row, "curve") and _strength(row) == strength]
        groups.append((f"curve {strength}", 20.0, of_strength))
    groups.append(("nothing", None, [row for row in rows if not row["hidden"]]))
    for snr in sorted({row["snr_db"] for row in rows}):
        groups.append(("left out", snr, [row for row in rows if _taken_away(row) and row["snr_db"] == snr]))
    groups.append(("outside the catalogue", 20.0, [row for row in rows if row["kind"] == "outside"]))
    return [entry for entry in groups if entry[2]]


def _is(row: dict[str, Any], kind: str) -> bool:
    return bool(row["kind"] == kind and not row["left_out"])


def _taken_away(row: dict[str, Any]) -> bool:
    return bool(row["left_out"] and row["kind"] != "outside")


def _strength(row: dict[str, Any]) -> int:
    return round(max(float(value) for value in row["sigmas"].values()))


def _counts(kind: str, rows: Rows) -> dict[str, int]:
    explained = [row for row in rows if row["verdict"] == "explained"]
    if kind == "nothing":
        return {"false alarms": sum(row["verdict"] != "adequate" for row in rows), "with a name": len(explained)}
    unexplained = sum(row["verdict"] == "unexplained" for row in rows)
    if kind == "outside the catalogue":
        return {"unexplained": unexplained, "confident wrong name": len(explained)}
    if kind == "left out":
        alike = sum(bool(row.get("own_group")) for row in explained)
        return {"unexplained": unexplained, "confident wrong name": len(explained), "of these of its own group": alike}
    return {
        "right up to groups": sum(row["right"] for row in rows),
        "exact": sum(row["exact"] for row in rows),
        "unexplained": unexplained,
        "adequate": sum(row["verdict"] == "adequate" for row in rows),
        "wrong name": sum(not row["right"] for row in explained),
    }


def _intervals(rows: Rows) -> dict[tuple[str, str], tuple[str, str]]:
    inside = [row["inside_95"] for row in rows if row["inside_95"] is not None and row["kind"] != "curve"]
    if not inside:
        return {}
    wanted = _WANTED["interval", None, "truth inside 95 %"]
    figures = {("intervals", "truth inside 95 %"): (_proportion(sum(inside), len(inside)), wanted)}
    errors = [row["error_in_sigmas"] for row in rows if row.get("error_in_sigmas") is not None]
    if errors:
        mean, rms = np.mean(errors), math.sqrt(np.mean(np.square(errors)))
        figures["intervals", "error over sigma: mean, rms"] = (f"{mean:+.2f}, {rms:.2f}", "")
    return figures


def _gains(rows: Rows) -> dict[tuple[str, str], tuple[str, str]]:
    """Held-out gain as a share of the true effect's, of trials in which a name was given."""
    ratios = sorted(
        row["gain"] / row["oracle_gain"] for row in rows if row["gain"] and (row.get("oracle_gain") or 0.0) > 0
    )
    if not ratios:
        return {}
    shares = {"median": ratios[len(ratios) // 2], "worst": ratios[0]}
    title = "gain as a share of the oracle's"
    return {
        (title, name): (f"{100 * ratio:.0f} % of {len(ratios)}", _WANTED["gain", None, name])
        for name, ratio in shares.items()
    }


def _seconds(rows: Rows) -> dict[tuple[str, str], tuple[str, str]]:
    seconds = sorted(row["cpu_s"] for row in rows)
    if not seconds:
        return {}
    middle, most = seconds[len(seconds) // 2], seconds[-1]
    wanted = "<= 8 s, <= 20 s"
    return {("processor time of a diagnosis", "median, most"): (f"{middle:.1f} s, {most:.1f} s", wanted)}


def _misses(rows: Rows) -> list[str]:
    """Every trial that did not come out as it should."""
    lines = [
        "What did not come out as wanted:",
        "",
        "| hidden | judged | named, or nearest | worst of what is left |",
        "|---|---|---|---|",
    ]
    for row in rows:
        good = row["verdict"] == "unexplained" if row["left_out"] else row["right"]
        if good or (row["kind"] == "curve" and _strength(row) < 8):
            continue
        hidden = ", ".join(f"{name} {value:.3g}" for name, value in row["hidden"].items()) or "nothing"
        hidden += f", {row['snr_db']:g} dB" + (", left out" if _taken_away(row) else "")
        hidden += ", outside" if row["kind"] == "outside" else ""
        hidden += ", second" if row.get("generator") == "stranger" else ""
        named = (
            "; ".join("/".join(group) for group in row["groups"])
            or f"({', '.join(row['nearest_causes']) or row['nearest']})"
        )
        worst = row["worst_checks"][0] if row["worst_checks"] else ["", 0.0]
        lines.append(f"| {hidden} | {row['verdict']} | {named} | {worst[0]} {worst[1]:+.1f} |")
    return lines


def commit() -> str:
    """The code that is being run: its last commit, and the day."""
    asked = ["git", "log", "-1", "--format=%h of %ad", "--date=short"]
    completed = subprocess.run(asked, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return completed.stdout.strip() or "unknown"
