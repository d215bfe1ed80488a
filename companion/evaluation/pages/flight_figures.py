"""Figures of a flight's report: ranges, mode, spectra, triggers, clocks, refusals."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Any

import numpy as np

from companion.evaluation.flight_log import FlightLog, Spectrum
from companion.evaluation.recording_info import AT_THE_END
from companion.params.airframe import FAMILIES
from companion.records import ClockName, Floats, ModeEstimate, Reject, Station
from companion.reporting.plotting import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    dots,
    headline,
    new_figure,
    with_gaps,
)

_WIDTH_IN = 11.0  # of every figure; 110 px an inch fill the page (choice)
_STATIONS = {Station.ROOT: GREY, Station.LEFT: BLUE, Station.RIGHT: ORANGE}
_CLOCKS = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILLION)
_FARTHEST_SHOWN = 1.5  # times the farthest corrected range: rigid ranges pass infinity (choice)
_MM, _MRAD, _US = 1e3, 1e3, 1e6  # per SI unit (by definition)
_TOP_HZ = 200.0  # beyond, no airframe of ours has a mode (choice)
_ON_CURVES = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}  # behind a label that may lie on a curve


def _figure(height_in: float, text: str) -> Any:
    """Empty figure with its headline."""
    figure = new_figure(_WIDTH_IN, height_in)
    headline(figure, text)
    return figure


def ranges(log: FlightLog, text: str) -> Any:
    """Rigid against corrected ranges with sigma, and the toe that was taken out."""
    figure = _figure(6.2, text)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    t_s = (np.array([entry.t_host_ns for entry in log.ranges]) - log.start_host_ns) * 1e-9
    trusted = np.array([entry.trusted for entry in log.ranges])
    range_m, sigma_m, rigid_m, toe_rad, toe_sigma_rad = (
        np.array([getattr(entry, name) for entry in log.ranges])
        for name in ("range_m", "sigma_m", "rigid_range_m", "toe_rad", "toe_sigma_rad")
    )
    top_m = _FARTHEST_SHOWN * float(np.max(range_m[trusted], initial=1.0))
    rigid_shown = (rigid_m > 0.0) & (rigid_m < top_m)
    above.plot(t_s[rigid_shown], rigid_m[rigid_shown], ".", ms=4, color=VERMILLION, label="rigid stereo")
    withheld = ~trusted & np.isfinite(range_m) & (range_m < top_m)
    above.plot(t_s[withheld], range_m[withheld], "x", ms=4, color=GREY, label="corrected, withheld")
    dots(above, t_s[trusted], range_m[trusted], sigma_m[trusted], BLUE, "published, ±1 sigma")
    above.set(ylabel="range, m", ylim=(0.0, top_m))
    above.legend(fontsize=8, ncols=3, loc="upper right")
    dots(below, t_s, _MRAD * toe_rad, _MRAD * toe_sigma_rad, INK)
    below.set(xlabel="time, s", ylabel="relative toe, mrad")
    return figure


def modes(log: FlightLog, text: str) -> Any:
    """Frequency, damping and rms vibration of the first modes over time, each with its sigma as a band."""
    figure = _figure(6.2, text)
    frequency, damping, deflection = figure.subplots(3, 1, sharex=True)
    tracked = log.tracked()
    t_s = (np.array([mode.t_host_ns for mode in tracked]) - log.start_host_ns) * 1e-9
    for name, colour in zip(FAMILIES, (BLUE, ORANGE), strict=True):
        family = [getattr(mode, name) for mode in tracked]
        _band(frequency, t_s, family, ("frequency_hz", "frequency_sigma_hz"), 1.0, colour, name)
        _band(damping, t_s, family, ("damping", "damping_sigma"), 1.0, colour, name)
        _band(deflection, t_s, family, ("rms_m", "amplitude_sigma_m"), _MM, colour, name)
    frequency.set(ylabel="frequency, Hz")
    damping.set(ylabel="damping ratio")
    deflection.set(ylabel="vibration, mm rms", xlabel="time, s", ylim=(0.0, None))
    damping.legend(fontsize=8, ncols=2, loc="best", title="first modes, ±1 sigma", title_fontsize=8)
    return figure


def _band(
    axis: Any, t_s: Floats, family: list[ModeEstimate], names: tuple[str, str], scale: float, colour: str, label: str
) -> None:
    values, sigma = (scale * np.array([getattr(mode, name) for mode in family]) for name in names)
    axis.plot(*with_gaps(t_s, values), color=colour, lw=1.2, label=label)
    axis.fill_between(t_s, values - sigma, values + sigma, color=colour, alpha=0.2, lw=0)


def spectra(log: FlightLog, by_station: Mapping[Station, Spectrum], text: str) -> Any:
    """Vertical acceleration of root and tips; the tracked modes and sharp lines are marked."""
    figure = _figure(4.2, text)
    axis = figure.subplots()
    top_hz = 1.0
    for station, colour in _STATIONS.items():
        spectrum = by_station.get(station)
        if spectrum is None:
            continue
        shown = (spectrum.f_hz > 0.0) & (spectrum.f_hz <= _TOP_HZ)
        top_hz = max(top_hz, float(spectrum.f_hz[shown][-1]))
        axis.loglog(spectrum.f_hz[shown], spectrum.density[shown], color=colour, lw=1.1, label=station.name.lower())
        for line_hz in spectrum.lines_hz():
            axis.axvline(line_hz, color=colour, lw=0.7, ls=":")
    _mark_modes(axis, log)
    axis.set(xlabel="frequency, Hz", ylabel="(m/s²)²/Hz", xlim=(0.2, top_hz))
    axis.legend(fontsize=8, loc="lower left")
    return figure


def _mark_modes(axis: Any, log: FlightLog) -> None:
    """A line and a name at each tracked mode; the wing tracks both families or none."""
    summaries = [(name, log.mode(name)) for name in FAMILIES]
    tracked = sorted((mode.frequency_hz, name) for name, mode in summaries if mode is not None)
    for (mode_hz, name), align, offset in zip(tracked, ("right", "left"), (-4, 4), strict=False):
        axis.axvline(mode_hz, color=INK, lw=1.0, ls="--" if name == "symmetric" else "-.")
        axis.annotate(
            f"{name} {mode_hz:.2f} Hz", (mode_hz, 0.5), (offset, 0), fontsize=8, ha=align, va="center",
            xycoords=("data", "axes fraction"), textcoords="offset points", bbox=_ON_CURVES,
        )  # fmt: skip


def triggers(log: FlightLog, text: str) -> Any:
    """Delay from planned to fired, and the blur that the plans foretold."""
    figure = _figure(3.2, text)
    delay, blur = figure.subplots(1, 2)
    delays_us = _US * np.array(log.delays_s)
    delay.hist(np.clip(delays_us, *np.percentile(delays_us, (0.5, 99.5))) if len(delays_us) else [], 40, color=BLUE)
    delay.set(xlabel="fired after planned, µs (ends: 0.5 and 99.5 %)", ylabel="shots")
    groups = blur_by_nearness(*log.blur_px())
    colours = (SKY, ORANGE, GREY)[: len(groups)]
    blur.hist(list(groups.values()), 40, color=colours, label=list(groups), stacked=True)
    blur.legend(fontsize=8, title="scene by the last range", title_fontsize=8)
    blur.set(xlabel="predicted blur, px", ylabel="plans", xlim=(0.0, None))
    return figure


def blur_by_nearness(blur_px: Floats, range_m: Floats) -> dict[str, Floats]:
    """Blur of plans (n,) made far from the scene, near it, and before any range: that of the flight past it differs."""
    ranged = np.isfinite(range_m)
    if not ranged.any():
        return {"no range yet": blur_px}
    middle_m = float(np.sqrt(range_m[ranged].min() * range_m[ranged].max()))
    far, near = ranged & (range_m > middle_m), ranged & (range_m <= middle_m)
    groups = {f"beyond {middle_m:.0f} m": far, f"within {middle_m:.0f} m": near, "no range yet": ~ranged}
    return {name: blur_px[group] for name, group in groups.items() if group.any()}


def clocks(log: FlightLog, text: str) -> Any:
    """Error bound of each remote clock over time."""
    figure = _figure(3.0, text)
    axis = figure.subplots()
    by_clock: dict[ClockName, list[tuple[float, float]]] = defaultdict(list)
    for state in log.clocks:
        if state.synced:
            by_clock[state.clock].append(((state.at_host_ns - log.start_host_ns) * 1e-9, state.bound_ns * 1e-6))
    for (clock, points), colour in zip(sorted(by_clock.items()), _CLOCKS, strict=False):
        t_s, bound_ms = np.array(points).T
        axis.plot(*with_gaps(t_s, bound_ms), color=colour, lw=1.2, label=str(clock))
    axis.set(xlabel="time, s", ylabel="error bound, ms", ylim=(0.0, None))
    if by_clock:
        axis.legend(fontsize=8, ncols=3, loc="upper right")
    return figure


def refusals(log: FlightLog, text: str) -> Any:
    """Every refusal and every withheld range at its time, one row a reason."""
    rows = refusals_by_reason(log)
    figure = _figure(0.9 + 0.28 * max(len(rows), 2), text)
    axis = figure.subplots()
    for row, (reason, (count, t_s)) in enumerate(sorted(rows.items(), key=lambda entry: entry[1][0])):
        axis.plot(t_s, np.full(len(t_s), row), "|", ms=9, color=VERMILLION)
        axis.annotate(
            f"{reason} ({count})", (0.0, row), (-6, 0), fontsize=8, xycoords=("axes fraction", "data"),
            textcoords="offset points", ha="right", va="center",
        )  # fmt: skip
    axis.set(xlabel="time, s", ylim=(-0.6, max(len(rows), 1) - 0.4))
    axis.set_yticks([])
    return figure


def refusals_by_reason(log: FlightLog) -> dict[str, tuple[int, list[float]]]:
    """Count of what was refused, and the times of the messages that say so."""
    counts: Counter[str] = Counter()
    times: dict[str, list[float]] = defaultdict(list)
    for refusal in log.refused:
        ended = refusal.reason is Reject.STALE and log.info.service.is_end(refusal.at_host_ns)
        reason = AT_THE_END if ended else str(refusal.reason)
        counts[reason] += refusal.count
        times[reason].append((refusal.at_host_ns - log.start_host_ns) * 1e-9)
    for entry in log.ranges:
        if not entry.trusted:
            reason = f"range withheld: {entry.reject}"
            counts[reason] += 1
            times[reason].append((entry.t_host_ns - log.start_host_ns) * 1e-9)
    return {reason: (counts[reason], t_s) for reason, t_s in times.items()}
