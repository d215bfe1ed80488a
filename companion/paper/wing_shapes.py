"""Figs. 9 and 10: polynomial fits of modal peaks along both edges, scaled shape, and the slope that turns a camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.core.wing.beam import BeamMode
from companion.core.wing.shapes import WingShape
from companion.paper import printed
from companion.paper.drawing import BLUE, GREY, ORANGE, RED, draw
from companion.paper.edge_fits import CAMERA_M, WHOLE_DEGREE, Fitted, clamped_factor, fit_edges
from companion.paper.findings import Section, SectionPicture, deviation, number, percent
from companion.paper.modal_peaks import GVT_TIP_CHORD_M, gvt_folder, measured_points
from companion.paper.range_tables import toe_rad, wide_factor
from companion.paper.vibration_test import GAIN_SIGMA, STATIONS_M, TESTS, simulated_points, survey, true_shapes
from companion.params.files import load_airframe
from companion.reporting.blocks import Table
from companion.reporting.page import capitalised
from companion.reporting.plotting import INK, dots


def section() -> Section:
    """Simulated wing always; the measured one where its data are."""
    simulated = _simulated()
    real, numbers, text = _measured_where_present()
    pictures = [
        _draw("simulated wing", simulated.fitted, simulated.factor, simulated.scaled_mm[0] / 1e3, simulated.first)
    ]
    rows = [_row("simulated, 2 m span", simulated.fitted, simulated.span_factor)]
    if real is not None and numbers is not None:
        factor = numbers["slope_factor_radpm"]
        pictures.append(_draw("measured wing (mAEWing1)", real, factor, None))
        rows.append(_row("measured, mAEWing1", real, factor))
    data = {"simulated": simulated.data(), "deflection_of_table_3_mm": simulated.scaled_mm, "measured": numbers}
    title = "Figs. 9 and 10: mode shape of the flying wing"
    tables = (_fit_table(rows), _polynomial_table(simulated.ways))
    return Section("figs_9_10", title, (*simulated.findings(), text), tables, tuple(pictures), data)


@dataclass(frozen=True, slots=True)
class _Simulated:
    """Fits of the simulated wing, rad/m, beside its true slope factor; ``ways`` are mean and spread of other fits."""

    fitted: Fitted
    first: BeamMode
    factor: float
    span_factor: float
    truth: float
    ways: dict[str, tuple[float, float]]
    scaled_mm: list[float]

    def data(self) -> dict[str, Any]:
        """Numbers of the section."""
        return {
            **_numbers(self.fitted),
            "slope_factor_radpm": self.factor,
            "whole_span_slope_factor_radpm": self.span_factor,
            "true_slope_factor_radpm": self.truth,
            "deviation": deviation(self.factor, self.truth),
            "ways": {name: {"mean": mean, "spread": spread} for name, (mean, spread) in self.ways.items()},
        }

    def findings(self) -> tuple[str, str, str]:
        """Sentences of the section."""
        halves, whole_span = (percent(deviation(value, self.truth)) for value in (self.factor, self.span_factor))
        each = "; ".join(
            f"{name}: {percent(mean, 1)} ± {percent(spread, 1)}" for name, (mean, spread) in self.ways.items()
        )
        return (
            f"Simulated wing: each half fitted with its root held gives {number(self.factor)} rad of camera slope per "
            f"metre of tip deflection ({halves}), one polynomial over the whole span "
            f"{number(self.span_factor)} ({whole_span}); its truth is {number(self.truth)}.",
            f"A slope from a fitted polynomial is poor: over {TESTS} tests with accelerometers good to "
            f"{percent(GAIN_SIGMA, 0)} {each}. The correction angle is wrong by as much before any camera looks.",
            f"Table 3's angles are {', '.join(f'{value:.2f}' for value in self.scaled_mm)} mm of tip deflection.",
        )


def _simulated() -> _Simulated:
    airframe = load_airframe("paper-flying-wing")
    fitted = fit_edges(simulated_points(airframe))
    first, _ = true_shapes(airframe)
    factor = clamped_factor(fitted.points)
    span_factor = fitted.slope_factor_radpm(CAMERA_M, airframe.wing.semispan_m)
    truth = float(first.slope(np.array([CAMERA_M]))[0])
    return _Simulated(fitted, first, factor, span_factor, truth, survey(airframe), _scaled_mm(factor))


def _measured_where_present() -> tuple[Fitted | None, dict[str, Any] | None, str]:
    folder = gvt_folder()
    if not folder.is_dir():
        return None, None, "The measured wing was skipped: measured/maewing1-gvt is not here (SPANWISE_DATA)."
    real = fit_edges(measured_points(folder))
    return real, *_measured(real)


def _polynomial_table(ways: dict[str, tuple[float, float]]) -> Table:
    return Table(
        ("fit", "mean deviation", "spread"),
        tuple((name, percent(mean, 1), percent(spread, 1)) for name, (mean, spread) in ways.items()),
        title="What a polynomial makes of the slope at the camera",
        note=f"{TESTS} simulated tests, {len(STATIONS_M)} stations on each half of each edge.",
    )


def _fit_table(rows: list[tuple[str, ...]]) -> Table:
    residual = "fit residual / tip, leading"
    header = ("wing", "resonances, Hz", residual, "trailing", "slope factor, rad/m", "times semispan")
    note = (
        f"Polynomials of degree {WHOLE_DEGREE} over both halves, as the paper fits them; deflection counts from the "
        "root, as the cameras' pose does."
    )
    return Table(header, rows, title="Polynomial fits of modal peaks", note=note)


def _measured(real: Fitted) -> tuple[dict[str, Any], str]:
    reach = real.reach_m
    factor = real.slope_factor_radpm(reach, reach)
    numbers = {**_numbers(real), "slope_factor_radpm": factor, "times_semispan": factor * reach, "semispan_m": reach}
    low, high = real.points.frequency_hz[[0, -1]].tolist()
    uneven = float(real.points.leading.deflection[-1] / real.points.leading.deflection[0])
    numbers["right_over_left"] = uneven
    ends = [WingShape(real.leading, real.trailing).at(side * reach, 0.5, GVT_TIP_CHORD_M) for side in (-1.0, 1.0)]
    twist = sum(end.twist for end in ends) / 2.0 / real.bend(reach)
    numbers["twist_factor_radpm"] = twist
    text = (
        f"Measured wing (3 m flying wing, first symmetric bending at {low:.2f} to {high:.2f} Hz as the accelerometers "
        f"rove): slope factor times semispan {number(factor * reach, 3)}, where a uniform cantilever has 1.377; the "
        f"right tip moves {number(uneven, 3)} times as much as the left. The tips twist by {number(twist, 3)} rad "
        "nose-up per metre of bend, which the paper's cameras on the elastic axis leave out."
    )
    return numbers, text


def _numbers(fitted: Fitted) -> dict[str, Any]:
    return {
        "resonances_hz": fitted.points.frequency_hz.tolist(),
        "leading_residual_sigma": fitted.leading.residual_sigma,
        "trailing_residual_sigma": fitted.trailing.residual_sigma,
        "residual_over_tip": list(_residuals(fitted)),
        "leading_span_m": fitted.points.leading.span_m.tolist(),
        "leading_peaks": fitted.points.leading.deflection.tolist(),
        "trailing_span_m": fitted.points.trailing.span_m.tolist(),
        "trailing_peaks": fitted.points.trailing.deflection.tolist(),
    }


def _residuals(fitted: Fitted) -> tuple[float, float]:
    tip = float(np.max(np.abs(fitted.points.leading.deflection)))
    return fitted.leading.residual_sigma / tip, fitted.trailing.residual_sigma / tip


def _row(name: str, fitted: Fitted, factor: float) -> tuple[str, ...]:
    low, high = fitted.points.frequency_hz[[0, -1]].tolist()
    lead, trail = _residuals(fitted)
    hertz = f"{low:.2f} to {high:.2f}"
    return name, hertz, percent(lead), percent(trail), number(factor), number(factor * fitted.reach_m)


def _scaled_mm(factor_radpm: float) -> list[float]:
    """Tip deflection of each of Table 3's objects, from its exact angle, half at each camera."""
    return [
        1e3 * toe_rad(entry.still_m, entry.vibrating_m) / wide_factor(entry.still_m) / (2.0 * factor_radpm)
        for entry in printed.OBJECTS
    ]


def _draw(
    name: str, fitted: Fitted, factor_radpm: float, tip_m: float | None, truth: BeamMode | None = None
) -> SectionPicture:
    def paint(axes: Any) -> None:
        _paint_edges(axes[:, 0], fitted)
        _paint_shape(axes[:, 1], fitted, tip_m)
        if truth is not None and tip_m is not None:
            _paint_truth(axes[:, 1], fitted.reach_m, tip_m, truth)
        for top, bottom in zip(*axes, strict=True):
            top.sharex(bottom)
            top.tick_params(labelbottom=False)
            bottom.set_xlabel("span station, m (right positive)")

    title = f"Figs. 9 and 10, {name}: edge fits (left), scaled shape and slope (right)"
    said = f"{capitalised(name)}: {number(factor_radpm)} rad of slope per metre of tip deflection"
    return draw(title, 2, 2, paint, 2.4, said=said)


def _paint_edges(axes: Any, fitted: Fitted) -> None:
    edges = (
        ("Leading edge", fitted.leading, fitted.points.leading, BLUE),
        ("Trailing edge", fitted.trailing, fitted.points.trailing, ORANGE),
    )
    for axis, (title, fit, points, colour) in zip(axes, edges, strict=True):
        inside = np.linspace(*fit.span_m, 201)
        axis.plot(inside, fit.deflection(inside), color=colour)
        sigma = np.full(len(points.span_m), fit.residual_sigma)
        dots(axis, points.span_m, points.deflection, sigma, INK, "peaks, ±1 sigma of the fit's residuals")
        axis.set(title=f"{title}: modal peaks and polynomial", ylabel="peak, acceleration / force")
        axis.legend()


def _paint_shape(axes: Any, fitted: Fitted, tip_m: float | None) -> None:
    """Scaled to a tip deflection, in mm and mrad; without one per unit of tip bend."""
    span = np.linspace(-fitted.reach_m, fitted.reach_m, 201)
    root = fitted.deflection(np.zeros(1))[0]
    scale = (1.0 if tip_m is None else 1e3 * tip_m) / fitted.bend(fitted.reach_m)
    axes[0].plot(span, scale * (fitted.deflection(span) - root), color=BLUE, label="fit")
    axes[0].set(title="Shape, scaled, relative to the root", ylabel="per unit of tip bend" if tip_m is None else "mm")
    axes[1].plot(span, scale * fitted.slope(span), color=RED, label="fit")
    axes[1].set(title="Slope", ylabel="1/m" if tip_m is None else "mrad")


def _paint_truth(axes: Any, reach_m: float, tip_m: float, truth: BeamMode) -> None:
    span = np.linspace(-reach_m, reach_m, 201)
    shape, slope = truth.shape(np.abs(span)), np.sign(span) * truth.slope(np.abs(span))
    for axis, line in zip(axes, (shape, slope), strict=True):
        axis.plot(span, 1e3 * tip_m * line, color=GREY, lw=1.0, ls="--", label="truth")
        axis.legend()
