"""The demo's picture: what bent, what was corrected, what was left, and what triggering at peaks is worth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from companion.cli.debrief import Debrief
from companion.cli.scoring import DISTANCES_M, near

_COLOURS = {"rigid": "#b2182b", "rigid_in_trim": "#ef8a62", "corrected": "#2166ac", "oracle": "#777777"}
_LABELS = {
    "rigid": "rigid (ground calibration)",
    "rigid_in_trim": "rigid, calibrated in trim",
    "corrected": "corrected",
    "oracle": "true extrinsics",
}


def draw(debrief: Debrief, path: Path) -> None:
    """Draw ``summary.png``."""
    from matplotlib.figure import Figure  # takes most of a second to import

    figure = Figure(figsize=(13, 8.8), layout="constrained")
    plain = debrief.plain
    figure.suptitle(
        f"{plain['airframe']}, seed {plain['seed']}: a {plain['truth']['frequency_hz']:.2f} Hz wing that gusts bend by "
        f"{plain['truth']['gust_rms_mm']:.1f} mm rms, seen by two cameras at its tips",
        fontsize=13,
    )
    rows = [["range", "toe"], ["range", "off"], ["errors", "blur"]]
    axes: dict[str, Any] = figure.subplot_mosaic(rows, height_ratios=(1.2, 0.8, 2.0))
    _ranges(axes["range"], debrief)
    _toe(axes["toe"], axes["off"], debrief)
    _errors(axes["errors"], debrief)
    _blur(axes["blur"], debrief)
    figure.savefig(path, dpi=110)


def _ranges(axis: Any, debrief: Debrief) -> None:
    series = debrief.series
    for name in ("rigid", "rigid_in_trim", "corrected"):
        inside = np.isfinite(series[f"{name}.range_m"]) & (series[f"{name}.range_m"] < 250)
        axis.plot(series[f"{name}.t_s"][inside], series[f"{name}.range_m"][inside], ".", ms=4,
                  color=_COLOURS[name], label=_LABELS[name])  # fmt: skip
    axis.plot(series["oracle.t_s"], series["oracle.z_true_m"], color="black", lw=1, label="true range")
    axis.set(title="Range", xlabel="time, s", ylabel="m", ylim=(0, 160))
    axis.legend(fontsize=8)


def _toe(axis: Any, below: Any, debrief: Debrief) -> None:
    """A few seconds, so that single oscillations can be seen; what is wrong with the estimate below it."""
    series = debrief.series
    start = series["t_s"][len(series["t_s"]) // 2] if len(series["t_s"]) else 0.0
    window = (series["t_s"] >= start) & (series["t_s"] <= start + 6)
    t_s, sigma = series["t_s"][window], 2e3 * series["toe_sigma_rad"][window]
    true, told = 1e3 * series["true_toe_rad"][window], 1e3 * series["toe_rad"][window]
    axis.plot(t_s, true, "o", ms=7, mfc="none", color="black", label="true")
    axis.plot(t_s, told, ".", color=_COLOURS["corrected"], label="estimated")
    axis.set(title="Relative toe at the shots (six seconds)", ylabel="mrad")
    axis.legend(fontsize=8)
    below.axhline(0.0, color="black", lw=0.8)
    error = 1e3 * series["corrected.toe_error_rad"][window]
    below.errorbar(t_s, error, sigma, fmt=".", color=_COLOURS["corrected"], label="error, ±2 sigma")
    below.set(xlabel="time, s", ylabel="mrad", xlim=axis.get_xlim())
    below.legend(fontsize=8)


def _errors(axis: Any, debrief: Debrief) -> None:
    names = ("rigid", "rigid_in_trim", "corrected", "oracle")
    width = 0.8 / len(names)
    for k, name in enumerate(names):
        z_true = debrief.series[f"{name}.z_true_m"]
        error = np.abs(debrief.series[f"{name}.range_m"] - z_true)
        for i, distance_m in enumerate(DISTANCES_M):
            some = error[near(z_true, distance_m)]
            if not len(some):
                continue
            median, p95 = (float(np.percentile(some, share, method="lower")) for share in (50, 95))
            x = i + (k - 1.5) * width
            axis.bar(x, median, width * 0.9, color=_COLOURS[name], label=_LABELS[name] if i == 0 else None)
            if np.isfinite(p95):
                axis.plot([x, x], [median, p95], color=_COLOURS[name], lw=1.5)
            else:  # the rigid range passes infinity
                axis.annotate("∞", (x, median), (0, 12), "data", "offset points", ha="center", color=_COLOURS[name],
                              arrowprops={"arrowstyle": "<-", "color": _COLOURS[name]})  # fmt: skip
    axis.set_yscale("log")
    axis.set_xticks(range(len(DISTANCES_M)), [f"{d:g} m" for d in DISTANCES_M])
    axis.set(title="Range error: median (bar) to 95th percentile (line)", ylabel="m")
    axis.legend(fontsize=8)


def _blur(axis: Any, debrief: Debrief) -> None:
    found = {
        name: debrief.series[f"blur.{name}"] for name in ("at_plan", "at_random") if f"blur.{name}" in debrief.series
    }
    labels = {"at_plan": "triggered at peaks", "at_random": "triggered at random"}
    for name, values in found.items():
        share = np.arange(1, len(values) + 1) / max(len(values), 1)
        axis.plot(np.sort(values), 100 * share, lw=2, label=labels[name],
                  color=_COLOURS["corrected" if name == "at_plan" else "rigid_in_trim"])  # fmt: skip
    axis.set(title="Blur that the bending wing causes", xlabel="px over the exposure", ylabel="% of the shots below")
    axis.set(xlim=(0, None), ylim=(0, 100))
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="lower right")
