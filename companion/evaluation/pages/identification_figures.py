"""Figures of an identification: responses, edges and slopes of the bending modes (paper, Fig. 9, 10), repeatability."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from companion.calibration.ambient import AmbientMode, half_spectrum
from companion.calibration.flight_modes import WingMotion
from companion.calibration.modes import IdentifiedMode, assurance
from companion.calibration.vibration import VibrationTest
from companion.calibration.wing_modes import BendingMode, relative_to_root
from companion.reporting.plotting import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, headline, new_figure

_LEADING, _TRAILING = BLUE, VERMILLION


def draw_test(test: VibrationTest, modes: list[IdentifiedMode], bending: list[BendingMode], folder: Path) -> None:
    """Write ``responses.png``, ``repeatability.png`` and ``shapes.png``."""
    figure = new_figure(11, 5)
    axis = figure.subplots()
    for run in test.runs:
        for response in run.response:
            axis.semilogy(run.frequency_hz, np.abs(response), lw=0.4, color=GREY, alpha=0.6)
    for mode in modes:
        axis.axvline(mode.frequency_hz, color=_TRAILING, lw=0.8, ls="-" if mode.resolved else ":")
        axis.text(mode.frequency_hz, axis.get_ylim()[1], f"{mode.frequency_hz:.1f}", rotation=90, va="top", fontsize=8)
    axis.set(
        title="Acceleration per force, all points; dotted: narrower than the record resolves",
        xlabel="frequency, Hz",
        ylabel="m/s² per N",
    )
    resolved = [mode for mode in modes if mode.resolved]
    headline(figure, f"{len(resolved)} modes that the record resolves: " + _listed(resolved))
    figure.savefig(folder / "responses.png", dpi=110)
    _draw_repeatability(resolved, folder)
    if bending:
        _draw_shapes(test, bending, folder)


def _listed(modes: list[IdentifiedMode]) -> str:
    return ", ".join(f"{mode.frequency_hz:.2f}" for mode in modes) + " Hz"


def _draw_repeatability(modes: list[IdentifiedMode], folder: Path) -> None:
    """Frequency and damping run by run; assurance of each mode in one half of the data with all of the other."""
    figure = new_figure(13, 4.2)
    first, second, third = figure.subplots(1, 3, width_ratios=(1, 1, 0.9))
    for mode, colour in zip(modes, itertools.cycle((BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, GREY)), strict=False):
        run, frequency, damping = mode.per_run.T
        off, name = 100.0 * (frequency / mode.frequency_hz - 1.0), f"{mode.frequency_hz:.2f} Hz"
        first.plot(run + 1, off, "o-", ms=3, color=colour, label=name)
        second.plot(run + 1, 100.0 * damping, "o-", ms=3, color=colour)
    first.set(title="frequency, run by run", xlabel="run", ylabel="off its mean, %")
    second.set(title="damping ratio, run by run", xlabel="run", ylabel="damping ratio, %", ylim=(0.0, None))
    first.legend(fontsize=7)
    matrix = np.array([[assurance(a.halves[0], b.halves[1]) for b in modes] for a in modes])
    third.imshow(matrix, vmin=0.0, vmax=1.0, cmap="Blues")
    names = [f"{mode.frequency_hz:.1f}" for mode in modes]
    third.set_xticks(range(len(modes)), names)
    third.set_yticks(range(len(modes)), names)
    for (row, column), value in np.ndenumerate(matrix):
        third.text(column, row, f"{value:.2f}", ha="center", va="center", color="white" if value > 0.5 else "black")
    third.set(title="assurance, even against odd lines", xlabel="mode, Hz", ylabel="mode, Hz")
    spread = [100.0 * float(np.std(mode.per_run[:, 1])) / mode.frequency_hz for mode in modes]
    if spread:
        headline(figure, f"From run to run the frequencies scatter by {min(spread):.2f} to {max(spread):.2f} %")
    figure.savefig(folder / "repeatability.png", dpi=110)


def _draw_shapes(test: VibrationTest, bending: list[BendingMode], folder: Path) -> None:
    figure = new_figure(14, 3.3 * len(bending))
    span = np.array([point.span_m for point in test.points])
    for axes, each in zip(figure.subplots(len(bending), 3, squeeze=False), bending, strict=True):
        mode, kind = each.mode, "symmetric" if each.sign > 0 else "antisymmetric"
        mirrored = relative_to_root(mode, test.points, each.sign)
        for leading, colour, name in ((True, _LEADING, "leading edge"), (False, _TRAILING, "trailing edge")):
            some = np.array([point.leading is leading for point in test.points])
            two_sigma = 2.0 * mode.shape_sigma[some]
            axes[0].errorbar(span[some], mode.shape[some], two_sigma, fmt="o", ms=4, color=colour, label=name)
            axes[1].errorbar(np.abs(span[some]), mirrored[some], two_sigma, fmt="o", ms=3, color=colour)
            edge = each.shape.leading if leading else each.shape.trailing
            y = np.linspace(*edge.span_m, 60)
            for axis, derivative in ((axes[1], 0), (axes[2], 1)):
                rows = edge.rows(y, derivative)
                curve = rows @ edge.coefficients
                band = 2.0 * np.sqrt(np.einsum("ij,jk,ik->i", rows, edge.covariance, rows))
                axis.plot(y, curve, color=colour)
                axis.fill_between(y, curve - band, curve + band, color=colour, alpha=0.2, lw=0)
        axes[0].set_title(f"{mode.frequency_hz:.2f} Hz, {kind}: as measured, ±2 sigma", fontsize=10)
        axes[1].set_title("halves folded, from the root section; cubic ±2 sigma", fontsize=10)
        axes[2].set_title("slope of the cubic, ±2 sigma", fontsize=10)
        for axis, what in zip(axes, ("of the largest", "of the largest", "slope, 1/m"), strict=True):
            axis.set(xlabel="span, m", ylabel=what if what.startswith("slope") else f"deflection, {what}")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="upper right", ncols=2, fontsize=9, frameon=False)
    headline(figure, "Bending modes: " + _listed([each.mode for each in bending]))
    figure.savefig(folder / "shapes.png", dpi=110)


def draw_flight(motion: WingMotion, modes: dict[str, list[AmbientMode]], folder: Path) -> None:
    """Write ``spectra.png``."""
    figure = new_figure(11, 5)
    for axis, (name, family) in zip(figure.subplots(1, 2), modes.items(), strict=True):
        samples = motion.symmetric if name == "symmetric" else motion.antisymmetric
        frequency, response, _ = half_spectrum(samples[:, np.newaxis], motion.rate_hz, (0.5, 0.45 * motion.rate_hz))
        axis.semilogy(frequency, np.abs(response[0]), lw=0.8, color=_LEADING)
        for mode in family:
            axis.axvline(mode.frequency_hz, color=_TRAILING, lw=0.8)
        axis.set(
            title=f"{name} acceleration of the tips", xlabel="frequency, Hz", ylabel="half spectrum, arbitrary scale"
        )
    listed = {name: ", ".join(f"{mode.frequency_hz:.2f}" for mode in family) for name, family in modes.items()}
    listed_modes = [f"{name} {text} Hz" for name, text in listed.items() if text]
    headline(figure, "Modes of the flight: " + ("; ".join(listed_modes) or "none"))
    figure.savefig(folder / "spectra.png", dpi=110)
