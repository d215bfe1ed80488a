"""Experiments that the paper did not try: antisymmetric motion, a pair that looks forward, lift, manoeuvres."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from companion.core.stereo.geometry import Rig
from companion.paper.findings import Section, number, percent
from companion.paper.scores import Results, one_tip_toe_error_mrad, rms_error, toe_error_mrad
from companion.paper.shots import WAYS
from companion.params.files import load_airframe
from companion.records import Side
from companion.reporting.blocks import Table

_FORWARD_SLOPE_RAD = 0.00225  # chosen: half of 4.5 mrad, a peak's angle (4.3 to 5.5 in Table 3)


def section(results: Results) -> Section:
    """All that goes beyond the paper, scored at random instants."""
    scores = results.randoms
    antisymmetric = [key for key in results.untried if key.startswith("antisymmetric")]
    tips = {key: one_tip_toe_error_mrad(results.outcomes[key].flown.shots) for key in antisymmetric}
    disparity_px, parallax_px = forward_errors_px()
    findings = (
        _of_lift(scores["lift"]),
        _of_manoeuvres(scores["manoeuvres"]),
        _of_antisymmetry(scores, tips),
        _of_looking_forward(scores["forward"], disparity_px, parallax_px),
    )
    data = {
        "random": {key: scores[key] for key in results.untried},
        "peaks": {key: results.peaks[key] for key in results.untried},
        "forward_disparity_px": disparity_px,
        "forward_parallax_px": parallax_px,
        "one_tip_toe_error_mrad": tips,
        "trim_toe_mrad": trim_toe_mrad(),
    }
    return Section("beyond", "What the paper did not try", findings, (_table(results),), (), data)


def _of_lift(lift: dict[str, Any]) -> str:
    return (
        f"Static lift bend: calibrated on the ground and flown at 60 m, the rigid pair reads "
        f"{number(lift['rigid']['median_range_m'], 3)} m (median), for 1 g alone is {trim_toe_mrad():.1f} mrad of toe; "
        f"a rigid pair calibrated in level flight reads {number(lift['in_trim']['median_range_m'], 3)} m, corrected "
        f"{number(lift['corrected']['median_range_m'], 3)} m, published "
        f"{number(lift['published']['median_range_m'], 3)} m. Of the error in 1/Z the correction removes "
        f"{percent(lift['removed'], 1)}; {lift['trusted']} of {lift['shots']} ranges are trusted."
    )


def _of_manoeuvres(flown: dict[str, Any]) -> str:
    return (
        f"With a bank and a pull-up while shots are taken, {percent(flown['removed'], 1)} is removed; "
        f"{percent(flown['corrected']['median_percent'] / 100, 1)} of range is left in the median (published "
        f"{percent(flown['published']['median_percent'] / 100, 1)}), and {flown['trusted']} of {flown['shots']} ranges "
        "are trusted."
    )


def _of_antisymmetry(scores: Any, tips: dict[str, float]) -> str:
    vertical, six = scores["antisymmetric"], scores["antisymmetric_six"]
    return (
        "Antisymmetric bending turns both cameras the same way, and no toe comes of it: the paper's wing without any "
        f"correction is off by {rms_error(vertical['rigid'])}. Correcting costs "
        f"{rms_error(vertical['corrected'])} there with one vertical accelerometer per tip, whose "
        "scales and stamps differ between the tips, "
        f"and {rms_error(six['corrected'])} with six-axis nodes (in trim, uncorrected: "
        f"{rms_error(six['in_trim'])}). A correction by one tip's accelerometer, taken for "
        f"symmetric as in the paper, would put in {tips['antisymmetric']:.1f} mrad rms of its own, "
        f"{percent(1e-3 * tips['antisymmetric'] * 60.0 / 1.98, 0)} of range at 60 m."
    )


def _of_looking_forward(ahead: dict[str, Any], disparity_px: float, parallax_px: float) -> str:
    return (
        f"Cameras that look forward: bending is roll. {2e3 * _FORWARD_SLOPE_RAD:.1f} mrad of it moves disparity by up "
        f"to {disparity_px:.2f} px at the upper and lower edge and adds {parallax_px:.2f} px of vertical parallax at "
        f"the sides. A range from the whole image barely notices ({rms_error(ahead['rigid'])} rigid, "
        f"{rms_error(ahead['corrected'])} corrected); one from its upper third does "
        f"({rms_error(ahead['rigid_upper_third'])} and {rms_error(ahead['corrected_upper_third'])})."
    )


def _table(results: Results) -> Table:
    rows = []
    for key in results.untried:
        scores = results.randoms[key]
        outcome = results.outcomes[key]
        errors = (_spread(*toe_error_mrad(outcome, scores[way])) for way in WAYS)
        median = percent(scores["published"]["median_percent"] / 100)
        counts = f"{scores['shots']} / {scores['trusted']}"
        rows.append((outcome.trial.title, number(scores["toe_rms_mrad"], 3), *errors, median, counts))
    heads = (
        "experiment", "toe beyond 1 g, rms", "rigid", "rigid in trim", "corrected", "published", "oracle",
        "published, median of range", "shots / trusted",
    )  # fmt: skip
    note = (
        "The mean is the slow part (trim, tilt bias, calibration), the spread what moves. Rigid in trim: calibrated in "
        "level flight at 1 g, nothing that moves. Corrected: by the wing's sensors. Published: what leaves the "
        "service, which also asks the matched features. All but the first carry six-axis wing nodes and the "
        "calibration errors that their airframe files state."
    )
    title = "What the paper did not try (random instants): error as relative toe, mrad, mean ± spread"
    return Table(heads, rows, title=title, note=note)


def _spread(mean: float, spread: float) -> str:
    return f"{mean:+.2f} ± {spread:.2f}" if math.isfinite(mean) else "-"


def trim_toe_mrad() -> float:
    """Relative toe that 1 g of lift gives the demo's aircraft."""
    wing = load_airframe("nadir-2m").wing
    return 2e3 * wing.trim_bend_m.value * wing.symmetric.slope_factor_radpm.value


def forward_errors_px() -> tuple[float, float]:
    """Largest change of disparity at the image's upper edge, and of vertical parallax at its sides, by bending."""
    rig = Rig.from_airframe(load_airframe("forward-2m"))
    moved = []
    for column, row in ((0.0, 240.0), (320.0, 0.0)):
        focal, centre = rig.left.lens.focal_px, rig.left.lens.matrix[:2, 2]
        pixel = np.array([[column, row]]) + centre
        point = 1e6 * rig.left.rays(rig.left.rest, pixel) / focal
        shift = []
        for side in Side:
            bent = rig.project(side, rig.pose(side, _FORWARD_SLOPE_RAD, 0.0), point)
            shift.append((bent - rig.project(side, rig.pose(side, 0.0, 0.0), point))[0])
        moved.append(np.abs(shift[0] - shift[1]))
    return float(moved[0][0]), float(moved[1][1])
