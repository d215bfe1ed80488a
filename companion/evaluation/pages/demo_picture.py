"""The demo's picture: what bent, what was corrected, what was left, and what triggering at peaks is worth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from companion.evaluation.flight_evaluation import FlightEvaluation
from companion.evaluation.metrics import DISTANCES_M
from companion.records import Floats
from companion.reporting.page import capitalised
from companion.reporting.plotting import BLUE, GREY, INK, ORANGE, VERMILLION, dots, headline, new_figure, with_gaps

_COLOURS = {"rigid": VERMILLION, "rigid_in_trim": ORANGE, "corrected": BLUE, "oracle": GREY}
_FAR = "60"
_OTHER_SURFACE = 0.5  # of the range, from one shot to the next: nothing approaches that fast (choice)
_BESIDE_TITLE = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.97), "ncols": 2, "fontsize": 8, "frameon": False}
_LABELS = {
    "rigid": "rigid (ground calibration)",
    "rigid_in_trim": "rigid, calibrated in trim",
    "corrected": "corrected",
    "oracle": "true extrinsics",
}


def draw(evaluation: FlightEvaluation, path: Path) -> None:
    """Draw ``summary.png``."""
    figure = new_figure(13, 8.8)
    plain, truth = evaluation.plain, evaluation.plain["truth"]
    what = (
        f"{plain['airframe']}, seed {plain['seed']}: a {truth['frequency_hz']:.2f} Hz wing that gusts bend by "
        f"{truth['gust_rms_mm']:.1f} mm rms, seen by two cameras at its tips"
    )
    headline(figure, _result_in_a_line(plain), what)
    rows = [["range", "toe"], ["range", "off"], ["errors", "blur"]]
    axes: dict[str, Any] = figure.subplot_mosaic(rows, height_ratios=(1.2, 0.8, 2.0))
    _ranges(axes["range"], evaluation)
    _toe(axes["toe"], axes["off"], evaluation)
    _errors(axes["errors"], evaluation)
    _blur(axes["blur"], evaluation)
    figure.savefig(path, dpi=110)


def _result_in_a_line(plain: dict[str, Any]) -> str:
    """Range error before and after the correction, in one line."""
    removed, errors = plain["targets"]["share_of_error_removed"]["of_rigid"], plain["range_error_m"]
    far = [errors[way].get(_FAR, {}).get("median") for way in ("rigid", "corrected")]
    shots = plain["shots"]
    trusted = f"{shots['trusted']} of {shots['corrected']} ranges trusted and published"
    if removed is None or None in far:
        return capitalised(trusted)
    change = f"Median error at {_FAR} m: {far[1]:.2f} m, rigid stereo {far[0]:.1f} m"
    return f"{change}; {100.0 * removed:.1f} % of the toe's error removed; {trusted}"


def _ranges(axis: Any, evaluation: FlightEvaluation) -> None:
    series = evaluation.series
    for name in ("rigid", "rigid_in_trim", "corrected"):
        t_s, range_m = series[f"{name}.t_s"], series[f"{name}.range_m"]
        inside = np.isfinite(range_m) & (range_m < 250)
        if name == "corrected":
            sigma_m = series["corrected.sigma_m"][inside]
            dots(axis, t_s[inside], range_m[inside], sigma_m, _COLOURS[name], f"{_LABELS[name]}, ±1 sigma")
        else:
            axis.plot(t_s[inside], range_m[inside], ".", ms=4, color=_COLOURS[name], label=_LABELS[name])
    true = _by_surface(*with_gaps(series["oracle.t_s"], series["oracle.z_true_m"]))
    axis.plot(*true, color=INK, lw=1, zorder=5, label="true range")
    axis.set(title="Range", xlabel="time, s", ylabel="range, m", ylim=(0, 160))
    axis.legend(fontsize=8)


def _by_surface(t_s: Floats, range_m: Floats) -> tuple[Floats, Floats]:
    """Points of a line (n,) with a break where one obstacle gives way to another."""
    jumps = np.flatnonzero(np.abs(np.diff(range_m)) > _OTHER_SURFACE * np.minimum(range_m[1:], range_m[:-1])) + 1
    return np.insert(t_s, jumps, np.nan), np.insert(range_m, jumps, np.nan)


def _toe(axis: Any, below: Any, evaluation: FlightEvaluation) -> None:
    """A few seconds, so that single oscillations can be seen; what is wrong with the estimate below it."""
    series = evaluation.series
    start = series["t_s"][len(series["t_s"]) // 2] if len(series["t_s"]) else 0.0
    window = (series["t_s"] >= start) & (series["t_s"] <= start + 6)
    t_s, sigma = series["t_s"][window], 2e3 * series["toe_sigma_rad"][window]
    true, estimated = 1e3 * series["true_toe_rad"][window], 1e3 * series["toe_rad"][window]
    axis.plot(t_s, true, "o", ms=7, mfc="none", color=INK, label="true")
    dots(axis, t_s, estimated, 0.5 * sigma, _COLOURS["corrected"], "estimated, ±1 sigma")
    axis.set_title("Relative toe at the shots (six seconds)", loc="left")
    axis.set_ylabel("toe, mrad")
    axis.legend(**_BESIDE_TITLE)
    below.axhline(0.0, color=INK, lw=0.8)
    error = 1e3 * series["corrected.toe_error_rad"][window]
    below.errorbar(t_s, error, sigma, fmt=".", color=_COLOURS["corrected"], label="error, ±2 sigma")
    below.set(xlabel="time, s", ylabel="error, mrad", xlim=axis.get_xlim())
    below.legend(**_BESIDE_TITLE)


def _errors(axis: Any, evaluation: FlightEvaluation) -> None:
    width = 0.8 / len(_COLOURS)
    for k, (name, colour) in enumerate(_COLOURS.items()):
        label: str | None = _LABELS[name]
        for i, distance_m in enumerate(DISTANCES_M):
            error = evaluation.plain["range_error_m"][name].get(f"{distance_m:g}", {"n": 0})
            if not error["n"]:
                continue
            median, p95 = (np.inf if error[key] is None else error[key] for key in ("median", "p95"))
            x = i + (k - 1.5) * width
            axis.bar(x, median, width * 0.9, color=colour, label=label)
            label = None
            if np.isfinite(p95):
                axis.plot([x, x], [median, p95], color=colour, lw=1.5)
            else:  # the rigid range passes infinity
                axis.annotate("∞", (x, median), (0, 12), "data", "offset points", ha="center", color=colour,
                              arrowprops={"arrowstyle": "<-", "color": colour})  # fmt: skip
    axis.set_yscale("log")
    low, high = axis.get_ylim()
    axis.set_ylim(low, 6.0 * high)  # room for the arrows to infinity
    axis.set_xticks(range(len(DISTANCES_M)), [f"{d:g} m" for d in DISTANCES_M])
    title = "Range error: median (bar) to 95th percentile (line; ∞: beyond infinity)"
    axis.set(title=title, xlabel="true range", ylabel="range error, m")
    axis.set_xlim(-0.6, len(DISTANCES_M) + 0.5)  # room for the legend beside the bars
    axis.legend(fontsize=8, loc="upper right")


def _blur(axis: Any, evaluation: FlightEvaluation) -> None:
    for name, label, colour in (("at_plan", "aimed shots", BLUE), ("at_random", "shots at random instants", ORANGE)):
        values = evaluation.series.get(f"blur.{name}")
        if values is not None:
            rank = np.arange(1, len(values) + 1) / max(len(values), 1)
            axis.plot(np.sort(values), 100 * rank, lw=2, label=label, color=colour)
    axis.set(title="Blur that the bending wing causes", xlabel="px over the exposure", ylabel="% of the shots below")
    axis.set(xlim=(0, None), ylim=(0, 100))
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="lower right")
