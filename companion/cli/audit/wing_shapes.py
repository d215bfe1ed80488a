"""Figs. 9 and 10: polynomial fits of modal peaks along both edges, scaled shape, and the slope that turns a camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from companion.cli.audit import printed
from companion.cli.audit.drawing import BLUE, GREY, ORANGE, RED, draw
from companion.cli.audit.findings import Picture, Section, Table, deviation, number, percent
from companion.cli.audit.modal_peaks import (
    GVT_TIP_CHORD_M,
    RATE_HZ,
    ModalPoints,
    gvt_folder,
    measured_points,
    modal_points,
    quadrature_peak,
)
from companion.cli.audit.range_tables import toe_rad, wide_factor
from companion.core.wing.beam import Beam, BeamMode
from companion.core.wing.model import WingModel
from companion.core.wing.shapes import EdgeFit, EdgePoints, WingShape, fit_polynomial
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.records import Floats
from companion.sim.perturb import draw_truth
from companion.sim.wing import SUBSTEP_S, integrate

_SEED = 9
_DEGREE = 6
_CLAMPED_DEGREE = 4
_TESTS = 8
_TEST_S = 60.0
_SWEEP_HZ = (1.0, 40.0)
_FORCE_MPS2 = 0.5
_STATIONS_M = (0.2, 0.4, 0.6, 0.8, 1.0)
_CAMERA_M = 0.99
GAIN_SIGMA = 0.01  # of each accelerometer


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Both edges fitted across the whole span; slopes and deflections are the mean of the edges and of both tips."""

    points: ModalPoints
    leading: EdgeFit
    trailing: EdgeFit

    def deflection(self, span_m: Floats) -> Floats:
        """Mean of the edges at stations (k,), in units of the peaks."""
        return np.asarray(0.5 * (self.leading.deflection(span_m) + self.trailing.deflection(span_m)))

    def slope(self, span_m: Floats) -> Floats:
        """d/dy of it."""
        return np.asarray(0.5 * (self.leading.slope(span_m) + self.trailing.slope(span_m)))

    @property
    def reach_m(self) -> float:
        """Outermost station that both edges have on both sides."""
        ends = [abs(end) for fit in (self.leading, self.trailing) for end in fit.span_m]
        return min(ends)

    def slope_factor_radpm(self, station_m: float, reference_m: float) -> float:
        """Up-bend slope at a station per metre of deflection at the reference from the root; both sides' mean."""
        both = np.array([-1.0, 1.0])
        return float((both @ self.slope(station_m * both)) / 2.0 / self.bend(reference_m))

    def bend(self, station_m: float) -> float:
        """Deflection relative to the root, mean of both sides."""
        ends = self.deflection(station_m * np.array([-1.0, 1.0]))
        return float(ends.mean() - self.deflection(np.zeros(1))[0])


def fit_edges(points: ModalPoints, degree: int = _DEGREE) -> Fitted:
    """One polynomial for each edge, as the paper does."""
    return Fitted(points, fit_polynomial(points.leading, degree), fit_polynomial(points.trailing, degree))


def clamped_factor(points: ModalPoints) -> float:
    """Camera slope per metre of tip deflection, each half fitted alone with its root held, the mean of both."""
    place, tip = (_CAMERA_M, 0.5, 1.0), (_STATIONS_M[-1], 0.5, 1.0)
    found = []
    for side in (-1.0, 1.0):
        edges = [_half(edge, side) for edge in (points.leading, points.trailing)]
        fits = [fit_polynomial(edge, _CLAMPED_DEGREE, clamped=True) for edge in edges]
        found.append(WingShape(*fits).factors(place, tip).slope_factor_radpm)
    return float(np.mean(found))


def _half(edge: EdgePoints, side: float) -> EdgePoints:
    mine = side * edge.span_m > 0.0
    return EdgePoints(side * edge.span_m[mine], edge.deflection[mine])


def survey(airframe: Airframe) -> dict[str, tuple[float, float]]:
    """Mean and spread of the slope factor's deviation over several simulated tests, by way of fitting."""
    truth = float(true_shapes(airframe)[0].slope(np.array([_CAMERA_M]))[0])
    tip = airframe.wing.semispan_m
    rows = []
    for seed in range(_TESTS):
        points = simulated_points(airframe, seed)
        whole = [fit_edges(points, degree).slope_factor_radpm(_CAMERA_M, tip) for degree in (4, _DEGREE)]
        rows.append([*whole, clamped_factor(points)])
    gaps = np.array(rows) / truth - 1.0
    names = ("whole span, degree 4", f"whole span, degree {_DEGREE}", f"each half clamped, degree {_CLAMPED_DEGREE}")
    return {
        name: (float(mean), float(spread))
        for name, mean, spread in zip(names, gaps.mean(axis=0), gaps.std(axis=0, ddof=1), strict=True)
    }


# ------------------------------------------------------------------------------------------------ simulated


def true_shapes(airframe: Airframe) -> tuple[BeamMode, BeamMode]:
    """Shapes of a held wing half with the airframe's first slope factor: a cantilever of so heavy a tip."""
    span = airframe.wing.semispan_m
    wanted = airframe.wing.symmetric.slope_factor_radpm.value

    def modes(mass_ratio: float) -> tuple[BeamMode, ...]:
        return Beam(1.0, 1.0, 1.0, 1.0, span, mass_ratio * span).modes(2)

    ratio = float(brentq(lambda mu: modes(mu)[0].slope_at_tip_radpm - wanted, 0.0, 10.0))
    first, second = modes(ratio)
    return first, second


def simulated_points(airframe: Airframe, seed: int = _SEED, gain_sigma: float = GAIN_SIGMA) -> ModalPoints:
    """Sweep the drawn wing and rove two accelerometers along each half, one run per pair."""
    rng = np.random.default_rng(seed)
    actual = draw_truth(airframe, rng).actual
    first, second = true_shapes(airframe)
    model = WingModel(actual.wing)
    count = round(_TEST_S / SUBSTEP_S)
    force = _sweep(count)
    load = np.zeros((count, model.count))
    columns = [model.structure.slots.index(slot) for slot in (0, 2)]
    load[:, columns] = force[:, None] * np.array([1.0, second.shape(np.array([0.5]))[0]])
    _, qdot = integrate(model, load, np.ones(count))
    every = round(1.0 / (SUBSTEP_S * RATE_HZ))
    # mean acceleration over each output sample: an anti-alias filter that is exact
    accel = np.diff(qdot[::every, columns], axis=0) * RATE_HZ
    felt = force.reshape(-1, every).mean(axis=1)
    noise = actual.left.accel_noise_mps2_rthz * np.sqrt(RATE_HZ / 2)
    runs = []
    for station in [side * y for side in (-1.0, 1.0) for y in _STATIONS_M]:
        at = np.array([abs(station)])
        motion = accel @ np.array([first.shape(at)[0], second.shape(at)[0]])
        gains = 1.0 + gain_sigma * rng.standard_normal(2)
        runs.append((station, motion[:, None] * gains + noise * rng.standard_normal((len(motion), 2))))
    hertz = actual.wing.symmetric.frequency_hz.value
    found = [quadrature_peak(felt, readings, (hertz - 1.0, hertz + 1.0)) for _, readings in runs]
    stations = np.array([[station, station] for station, _ in runs])
    return modal_points(stations, np.array([peak for _, peak in found]), np.array([f for f, _ in found]))


def _sweep(count: int) -> Floats:
    t_s = np.arange(count) * np.float64(SUBSTEP_S)
    low, high = _SWEEP_HZ
    return np.asarray(_FORCE_MPS2 * np.sin(2 * np.pi * (low * t_s + 0.5 * (high - low) / _TEST_S * t_s**2)))


# ------------------------------------------------------------------------------------------------ the section


def section() -> Section:
    """Simulated wing always; the measured one where its data are."""
    airframe = load_airframe("paper-flying-wing")
    simulated = fit_edges(simulated_points(airframe))
    first, _ = true_shapes(airframe)
    camera = np.array([_CAMERA_M])
    truth = float(first.slope(camera)[0])
    factor = clamped_factor(simulated.points)
    ways = survey(airframe)
    data: dict[str, Any] = {
        "simulated": {
            **_numbers(simulated),
            "slope_factor_radpm": factor,
            "true_slope_factor_radpm": truth,
            "deviation": deviation(factor, truth),
            "ways": {name: {"mean": mean, "spread": spread} for name, (mean, spread) in ways.items()},
        }
    }
    scaled = _scaled_mm(factor)
    data["deflection_of_table_3_mm"] = scaled
    findings = [
        f"Simulated wing: the fit gives {number(factor)} rad of camera slope per metre of tip deflection; its truth is "
        f"{number(truth)} ({percent(deviation(factor, truth))}).",
        f"A slope from a fitted polynomial is poor: over {_TESTS} tests with accelerometers good to "
        f"{percent(GAIN_SIGMA, 0)} "
        + "; ".join(f"{name}: {percent(mean, 1)} ± {percent(spread, 1)}" for name, (mean, spread) in ways.items())
        + ". The correction angle is wrong by as much before any camera looks.",
        f"Table 3's angles are {', '.join(f'{value:.2f}' for value in scaled)} mm of tip deflection.",
    ]
    pictures = [_draw("simulated wing", simulated, scaled[0] / 1e3)]
    rows = [_row("simulated, 2 m span", simulated, factor)]
    folder = gvt_folder()
    if folder.is_dir():
        real = fit_edges(measured_points(folder))
        found, text = _measured(real)
        data["measured"] = found
        findings.append(text)
        pictures.append(_draw("measured wing (mAEWing1)", real, None))
        rows.append(_row("measured, mAEWing1", real, found["slope_factor_radpm"]))
    else:
        data["measured"] = None
        findings.append("The measured wing was skipped: measured/maewing1-gvt is not here (SPANWISE_DATA).")
    compared = Table(
        "What a polynomial makes of the slope at the camera",
        ("fit", "mean deviation", "spread"),
        tuple((name, percent(mean, 1), percent(spread, 1)) for name, (mean, spread) in ways.items()),
        f"{_TESTS} simulated tests, {len(_STATIONS_M)} stations on each half of each edge.",
    )
    header = (
        "wing",
        "resonances, Hz",
        "fit residual / tip, leading",
        "trailing",
        "slope factor, rad/m",
        "times semispan",
    )
    note = (
        f"Polynomials of degree {_DEGREE} over both halves; deflection counted from the root, as the cameras' pose is."
    )
    table = Table("Polynomial fits of modal peaks", header, tuple(rows), note)
    title = "Figs. 9 and 10: mode shape of the flying wing"
    return Section("figs_9_10", title, tuple(findings), (table, compared), tuple(pictures), data)


def _measured(real: Fitted) -> tuple[dict[str, Any], str]:
    reach = real.reach_m
    factor = real.slope_factor_radpm(reach, reach)
    found = {**_numbers(real), "slope_factor_radpm": factor, "times_semispan": factor * reach, "semispan_m": reach}
    low, high = real.points.frequency_hz[[0, -1]].tolist()
    uneven = float(real.points.leading.deflection[-1] / real.points.leading.deflection[0])
    found["right_over_left"] = uneven
    ends = [WingShape(real.leading, real.trailing).at(side * reach, 0.5, GVT_TIP_CHORD_M) for side in (-1.0, 1.0)]
    twist = sum(end.twist for end in ends) / 2.0 / real.bend(reach)
    found["twist_factor_radpm"] = twist
    text = (
        f"Measured wing (3 m flying wing, first symmetric bending at {low:.2f} to {high:.2f} Hz as the accelerometers "
        f"rove): slope factor times semispan {number(factor * reach, 3)}, where a uniform cantilever has 1.377; the "
        f"right tip moves {number(uneven, 3)} times as much as the left. The tips twist by {number(twist, 3)} rad "
        "nose-up per metre of bend, which the paper's cameras on the elastic axis leave out."
    )
    return found, text


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


def _draw(name: str, fitted: Fitted, tip_m: float | None) -> Picture:
    reach = fitted.reach_m
    span = np.linspace(-reach, reach, 201)
    root = fitted.deflection(np.zeros(1))[0]
    scale = (1.0 if tip_m is None else tip_m) / fitted.bend(reach)
    unit = "per unit of tip bend" if tip_m is None else "mm"
    per = 1.0 if tip_m is None else 1e3

    def paint(axes: Any) -> None:
        edges = ((axes[0, 0], "Leading edge", fitted.leading, fitted.points.leading, BLUE),
                 (axes[1, 0], "Trailing edge", fitted.trailing, fitted.points.trailing, ORANGE))  # fmt: skip
        for axis, title, fit, points, colour in edges:
            inside = np.linspace(*fit.span_m, 201)
            axis.plot(inside, fit.deflection(inside), color=colour)
            axis.plot(points.span_m, points.deflection, "o", ms=4, color=GREY)
            axis.set(title=f"{title}: modal peaks and polynomial", ylabel="peak")
        axes[0, 1].plot(span, per * scale * (fitted.deflection(span) - root), color=BLUE)
        axes[0, 1].set(title="Shape, scaled, relative to the root", ylabel=unit)
        axes[1, 1].plot(span, per * scale * fitted.slope(span), color=RED)
        axes[1, 1].set(title="Slope", ylabel="1/m" if tip_m is None else "mrad")
        for axis in axes[1]:
            axis.set_xlabel("span station, m (right positive)")

    return draw(f"Figs. 9 and 10, {name}: edge fits (left), scaled shape and slope (right)", 2, 2, paint, 2.4)
