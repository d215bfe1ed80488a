"""What the blind trials came to, as a page that is kept beside them: every figure with its count and interval."""

from __future__ import annotations

import math
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

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
    ("pair", 20.0, "exact"): ">= 85 %",
    ("curve 5", 20.0, "right up to groups"): ">= 50 %",
    ("curve 8", 20.0, "right up to groups"): ">= 95 %",
    ("interval", None, "truth inside 95 %"): "90 to 98 %",
    ("gain", None, "median"): ">= 95 %",
    ("gain", None, "worst"): ">= 85 %",
}


def results(rows: Rows) -> str:
    """Markdown."""
    commits = sorted({row["commit"] for row in rows})
    lines = [
        "# Results of the blind trials",
        "",
        f"Written by `python -m tools.trials`; judged by the code of {', '.join(commits)}. 60 s",
        "each, two 1 kHz accelerometers, stereo at 10 Hz and 0.3 px, unmeasured gust, belief perturbed; truth from",
        "`wing.py`, which shares no code with the diagnosis. Intervals are Wilson's, 95 %. A wrong name is of what was",
        "hidden's own group where this recording cannot tell the two (their scores correlate beyond 0.95).",
        "",
        "| trials | figure | count | share | 95 % interval | wanted |",
        "|---|---|---|---|---|---|",
    ]
    for kind, snr, part in _parts(rows):
        title = kind + (f", {snr:g} dB" if snr is not None else "")
        for name, counted in _counts(kind, part).items():
            wanted = _WANTED.get((kind, snr, name), "")
            lines.append(f"| {title} | {name} | {counted}/{len(part)} | {_share(counted, len(part))} | {wanted} |")
    lines += [*_intervals(rows), *_gains(rows), *_seconds(rows)]
    lines += ["", "![confusion matrix](confusion.png)", "", *_misses(rows), ""]
    return "\n".join(lines)


def wilson(counted: int, total: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if not total:
        return 0.0, 1.0
    p, z2 = counted / total, _Z**2 / total
    middle, half = p + 0.5 * z2, _Z * math.sqrt(p * (1.0 - p) / total + 0.25 * z2 / total)
    return max((middle - half) / (1.0 + z2), 0.0), min((middle + half) / (1.0 + z2), 1.0)


def _share(counted: int, total: int) -> str:
    low, high = wilson(counted, total)
    return f"{100 * counted / total:.0f} % | {100 * low:.0f} to {100 * high:.0f} %"


def _parts(rows: Rows) -> list[tuple[str, float | None, Rows]]:
    found: list[tuple[str, float | None, Rows]] = []
    for kind in ("single", "pair", "triple"):
        for snr in sorted({row["snr_db"] for row in rows}, reverse=True):
            found.append((kind, snr, [r for r in rows if _is(r, kind) and r["snr_db"] == snr]))
    for strength in sorted({_strength(row) for row in rows if _is(row, "curve")}):
        mine = [row for row in rows if _is(row, "curve") and _strength(row) == strength]
        found.append((f"curve {strength}", 20.0, mine))
    found.append(("nothing", None, [row for row in rows if not row["hidden"]]))
    for snr in sorted({row["snr_db"] for row in rows}):
        found.append(("left out", snr, [row for row in rows if row["left_out"] and row["snr_db"] == snr]))
    return [entry for entry in found if entry[2]]


def _is(row: dict[str, Any], kind: str) -> bool:
    return bool(row["kind"] == kind and not row["left_out"])


def _strength(row: dict[str, Any]) -> int:
    return round(max(float(value) for value in row["sigmas"].values()))


def _counts(kind: str, rows: Rows) -> dict[str, int]:
    explained = [row for row in rows if row["verdict"] == "explained"]
    if kind == "nothing":
        return {"false alarms": sum(row["verdict"] != "adequate" for row in rows), "with a name": len(explained)}
    unexplained = sum(row["verdict"] == "unexplained" for row in rows)
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


def _intervals(rows: Rows) -> list[str]:
    known = [row["inside_95"] for row in rows if row["inside_95"] is not None and row["kind"] != "curve"]
    if not known:
        return []
    wanted = _WANTED["interval", None, "truth inside 95 %"]
    return [
        f"| intervals | truth inside 95 % | {sum(known)}/{len(known)} | {_share(sum(known), len(known))} | {wanted} |"
    ]


def _gains(rows: Rows) -> list[str]:
    """Of trials in which a name was given, the held-out gain as a share of the true effect's."""
    ratios = sorted(
        row["gain"] / row["oracle_gain"] for row in rows if row["gain"] and (row.get("oracle_gain") or 0.0) > 0
    )
    if not ratios:
        return []
    shares = {"median": ratios[len(ratios) // 2], "worst": ratios[0]}
    wanted = {name: _WANTED["gain", None, name] for name in shares}
    title = "gain as a share of the oracle's"
    return [
        f"| {title} | {name} | {len(ratios)} | {100 * share:.0f} % | | {wanted[name]} |"
        for name, share in shares.items()
    ]


def _seconds(rows: Rows) -> list[str]:
    seconds = sorted(row["cpu_s"] for row in rows)
    middle, most = seconds[len(seconds) // 2], seconds[-1]
    return [f"| processor time, plain numpy | median, most | {len(rows)} | {middle:.1f} s, {most:.1f} s | | <= 90 s |"]


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
        hidden += f", {row['snr_db']:g} dB" + (", left out" if row["left_out"] else "")
        named = (
            "; ".join("/".join(group) for group in row["groups"])
            or f"({', '.join(row['nearest_causes']) or row['nearest']})"
        )
        left = row["worst_checks"][0] if row["worst_checks"] else ["", 0.0]
        lines.append(f"| {hidden} | {row['verdict']} | {named} | {left[0]} {left[1]:+.1f} |")
    return lines


def commit() -> str:
    """The code that is being run: its last commit, and the day."""
    asked = ["git", "log", "-1", "--format=%h of %ad", "--date=short"]
    told = subprocess.run(asked, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return told.stdout.strip() or "unknown"
