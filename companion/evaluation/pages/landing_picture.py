"""Picture of the landings: paths, readings, flares and touch-downs of each range finder, in calm and in gusts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from companion.evaluation.landing.landing_rows import RangeKind, Row, figures
from companion.evaluation.landing.landing_table import name_of, of_variant, variants
from companion.reporting.plotting import BLUE, GREY, INK, ORANGE, PALE, VERMILLION, headline, new_figure

_COLOURS = {RangeKind.RIGID: VERMILLION, RangeKind.IN_TRIM: ORANGE, RangeKind.SPANWISE: BLUE, RangeKind.TRUTH: GREY}
_LEGEND = (
    "lines: paths flown; dots: the range finder's readings; o the flare begins, x wheels touch, ^ goes around; "
    "the flare begins where the corrected height is two seconds of the sink rate"
)
_HIGHEST_M = 70.0  # chosen: the level leg before the slope, and room above it
_SHOWN_M = (-640.0, 110.0)  # chosen: along the runway, from the landing point: the approach and the roll-out


def draw_landings(rows: Sequence[Row], path: Path) -> None:
    """Draw ``landing.png``: a column a range finder, a row for calm and one for gusts."""
    columns, airs = variants(rows), sorted({bool(row["gusts"]) for row in rows})
    figure = new_figure(3.9 * len(columns), 3.4 * len(airs) + 0.9)
    headline(figure, _sentence(rows), _LEGEND)
    grid: Any = figure.subplots(len(airs), len(columns), sharex=True, sharey=True, squeeze=False)
    for axes, gusts in zip(grid, airs, strict=True):
        for axis, variant in zip(axes, columns, strict=True):
            chosen = of_variant(rows, variant, gusts=gusts)
            _paths(axis, chosen, _COLOURS[variant[0]])
            axis.set_title(f"{name_of(variant)}, {'gusts' if gusts else 'calm'}", fontsize=10)
            axis.text(0.98, 0.97, _note(chosen), transform=axis.transAxes, ha="right", va="top", fontsize=8.5)
        axes[0].set_ylabel("height above ground, m")
    for axis in grid[-1]:
        axis.set_xlabel("distance from the landing point, m")
    figure.savefig(path, dpi=110)


def _paths(axis: Any, rows: Sequence[Row], colour: str) -> None:
    """Every landing of one panel."""
    axis.axhline(0.0, color=INK, lw=0.8)
    axis.axvline(0.0, color=PALE, lw=0.8, zorder=0)
    for row in rows:
        points = np.array([(north, height) for _, north, height, _ in row["path"]])
        readings = np.array([(north, reading) for _, north, _, reading in row["path"] if reading is not None])
        if len(readings):
            axis.plot(*readings.T, ".", ms=2.0, color=GREY, alpha=0.35, zorder=1)
        axis.plot(*points.T, color=colour, lw=1.0, alpha=0.8, zorder=2)
        _marks(axis, row, points)
    axis.set(xlim=_SHOWN_M, ylim=(-2.0, _HIGHEST_M))


def _marks(axis: Any, row: Row, points: Any) -> None:
    flare, touch = row["flare"], row["touch"]
    if flare is not None:
        north_m = np.interp(flare["t_s"], [point[0] for point in row["path"]], points[:, 0])
        axis.plot(north_m, flare["height_m"], "o", ms=4, mfc="white", mec=INK, mew=0.9, zorder=4)
    if touch is not None:
        axis.plot(touch["north_m"], 0.0, "x", ms=5, color=INK, zorder=4)
    if row["outcome"] == "went around":
        axis.plot(*points[-1], "^", ms=5, color=INK, zorder=4)


def _note(rows: Sequence[Row]) -> str:
    summed = figures(rows)
    lines = [f"{summed.landed} of {summed.flights} landed"]
    if len(summed.flare_error_m):
        lines.append(f"flare {np.median(summed.flare_error_m):+.1f} m from the intended height")
    if summed.landed:
        lines.append(f"touch-down at {np.median(summed.sink_mps):.2f} m/s (median)")
    if summed.went_around:
        lines.append(f"{summed.went_around} went around")
    return "\n".join(lines)


def _sentence(rows: Sequence[Row]) -> str:
    landed = {}
    for variant in variants(rows):
        summed = figures([row for gusts in (False, True) for row in of_variant(rows, variant, gusts=gusts)])
        landed[name_of(variant)] = f"{summed.landed} of {summed.flights}"
    return "Landings by the range of " + "; ".join(f"{name}: {count}" for name, count in landed.items())
