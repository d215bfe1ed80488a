"""Fig. 4: first mode shape and slope of the boom."""

from __future__ import annotations

from typing import Any

import numpy as np

from companion.core.wing.beam import BeamMode
from companion.paper.beam_tables import corrected_beam
from companion.paper.drawing import BLUE, RED, draw
from companion.paper.findings import Section, SectionPicture, number, percent
from companion.records import Floats


def section() -> Section:
    """First mode shape and slope of the boom."""
    beam = corrected_beam()
    mode = beam.modes(1)[0]
    station = np.linspace(0.0, beam.length_m, 201)
    factor = mode.slope_at_tip_radpm
    # a massless beam with a force at its tip: Y = (3 xi^2 - xi^3) / 2, of tip slope 1.5 / l
    cubic = 1.5 * (station / beam.length_m) ** 2 - 0.5 * (station / beam.length_m) ** 3
    gap = float(np.max(np.abs(mode.shape(station) - cubic)))
    data: dict[str, Any] = {
        "slope_at_tip_radpm": factor,
        "slope_at_tip_times_length": factor * beam.length_m,
        "largest_gap_to_static_cubic": gap,
        "station_m": station[::10].tolist(),
        "shape": mode.shape(station)[::10].tolist(),
        "slope_radpm": mode.slope(station)[::10].tolist(),
    }
    findings = (
        f"The tip turns {number(factor)} rad per metre of deflection ({number(factor * beam.length_m)} / l): 0.4 mm at "
        f"each camera is {0.8 * factor:.1f} mrad of relative toe.",
        f"So heavy a tip bends the strip as a static force would: the shape differs from the cubic by {percent(gap)}.",
    )
    return Section("fig_4", "Fig. 4: first mode of the boom", findings, (), (_draw_mode(station, mode),), data)


def _draw_mode(station: Floats, mode: BeamMode) -> SectionPicture:
    def paint(axes: Any) -> None:
        shape, slope = axes[0]
        shape.plot(1e3 * station, mode.shape(station), color=BLUE)
        shape.set(title="Normalised shape", xlabel="station, mm", ylabel="deflection / tip")
        slope.plot(1e3 * station, mode.slope(station) / mode.slope_at_tip_radpm, color=RED)
        slope.set(title="Normalised slope", xlabel="station, mm", ylabel="slope / tip")

    said = f"{number(mode.slope_at_tip_radpm)} rad of slope per metre of deflection at the tip"
    return draw("Fig. 4: normalised first mode shape and slope along the boom", 1, 2, paint, said=said)
