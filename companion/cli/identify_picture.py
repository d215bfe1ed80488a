"""Figures of an identification: responses with the modes, edges of each bending mode, slopes (paper, Fig. 9, 10)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.calibration.ambient import AmbientMode, half_spectrum
from companion.calibration.flight_modes import WingMotion
from companion.calibration.modes import IdentifiedMode
from companion.calibration.vibration import VibrationTest
from companion.calibration.wing_modes import BendingMode

_LEADING, _TRAILING = "#2166ac", "#b2182b"


def draw_test(test: VibrationTest, modes: list[IdentifiedMode], found: list[BendingMode], folder: Path) -> None:
    """Write ``responses.png`` and ``shapes.png``."""
    from matplotlib.figure import Figure  # takes most of a second to import

    figure = Figure(figsize=(11, 5), layout="constrained")
    axis = figure.subplots()
    for run in test.runs:
        for response in run.response:
            axis.semilogy(run.frequency_hz, np.abs(response), lw=0.4, color="#777777", alpha=0.6)
    for mode in modes:
        axis.axvline(mode.frequency_hz, color=_TRAILING, lw=0.8)
        axis.text(mode.frequency_hz, axis.get_ylim()[1], f"{mode.frequency_hz:.1f}", rotation=90, va="top", fontsize=8)
    axis.set(title="Acceleration per force, all points", xlabel="frequency, Hz", ylabel="m/s² per N")
    figure.savefig(folder / "responses.png", dpi=110)
    if found:
        _draw_shapes(test, found, folder)


def _draw_shapes(test: VibrationTest, found: list[BendingMode], folder: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.2 * len(found)), layout="constrained")
    for (left, right), each in zip(figure.subplots(len(found), 2, squeeze=False), found, strict=True):
        mode, kind = each.mode, "symmetric" if each.sign > 0 else "antisymmetric"
        for leading, colour, name in ((True, _LEADING, "leading edge"), (False, _TRAILING, "trailing edge")):
            some = np.array([point.leading is leading for point in test.points])
            span = np.array([point.span_m for point in test.points])[some]
            left.errorbar(span, mode.shape[some], 2 * mode.shape_sigma[some], fmt="o", ms=4, color=colour, label=name)
            edge = each.shape.leading if leading else each.shape.trailing
            y = np.linspace(*edge.span_m, 60)
            right.plot(y, edge.slope(y), color=colour, label=name)
        left.set(title=f"{mode.frequency_hz:.2f} Hz, {kind}: shape ±2 sigma", xlabel="span, m")
        right.set(title="slope of one half, polynomial fit", xlabel="span, m", ylabel="1/m")
        left.legend(fontsize=8)
    figure.savefig(folder / "shapes.png", dpi=110)


def draw_flight(motion: WingMotion, modes: dict[str, list[AmbientMode]], folder: Path) -> None:
    """Write ``spectra.png``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5), layout="constrained")
    for axis, (name, family) in zip(figure.subplots(1, 2), modes.items(), strict=True):
        samples = motion.symmetric if name == "symmetric" else motion.antisymmetric
        frequency, response, _ = half_spectrum(samples[:, np.newaxis], motion.rate_hz, (0.5, 0.45 * motion.rate_hz))
        axis.semilogy(frequency, np.abs(response[0]), lw=0.8, color=_LEADING)
        for mode in family:
            axis.axvline(mode.frequency_hz, color=_TRAILING, lw=0.8)
        axis.set(title=f"{name} acceleration of the tips", xlabel="frequency, Hz", ylabel="half spectrum")
    figure.savefig(folder / "spectra.png", dpi=110)
