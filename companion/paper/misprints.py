"""Where the paper disagrees with itself or with physics: every misprint, by number, in one list."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from companion.paper import beam_tables, equations, printed, range_tables
from companion.paper.findings import Section, deviation, number, percent
from companion.reporting.blocks import Table


@dataclass(frozen=True, slots=True)
class Misprint:
    """One disagreement: where, what stands there, what follows instead and by which number, and how sure that is."""

    where: str
    says: str
    instead: str
    shown_by: str
    sure: str


def misprints() -> list[Misprint]:
    """All of them, in the order of the paper."""
    return [*_equations(), *_beam(), *_ranges()]


def _equations() -> list[Misprint]:
    turned = equations.convergence()
    defects = {entry.label: entry.as_printed for entry in equations.audit()}
    root = equations.eq_12_root(beam_tables.corrected_beam().mass_ratio)
    return [
        Misprint("Eq. 7", "Rodrigues' formula written out", "eq. 6; four signs are wrong",
                 f"entries {', '.join(equations.wrong_entries())}; R R^T - I up to {number(defects['7'], 3)}",
                 "certain"),
        Misprint("Stereo vision, last paragraph", "converging: smaller disparity, shorter range",
                 "smaller disparity, LONGER range (eq. 1)",
                 f"{turned['still_px']:.1f} to {turned['converged_px']:.1f} px: {printed.OBJECTS[0].still_m} to "
                 f"{turned['converged_range_m']:.3f} m", "certain"),
        Misprint("Eq. 12", "E I Y''' = -m w_tt", "E I Y''' = +m w_tt", f"first root {number(root, 3)} instead of "
                 f"{number(beam_tables.corrected_beam().modes(1)[0].root)}", "certain"),
        Misprint("after eq. 12", "a matrix equation numbered (1), from an equation 17", "1 + cos x cosh x + mu x "
                 "(cos x sinh x - sin x cosh x) = 0", "there is no eq. 17; a 2x1 matrix times a 2x2 does not exist",
                 "certain"),
    ]  # fmt: skip


def _beam() -> list[Misprint]:
    mass_ratio, scale, _ = beam_tables.best_fit()
    worst, _, _ = beam_tables.powers_of_ten()
    first = printed.MODES[0]
    hertz = first.omega_radps / (2.0 * math.pi)
    implied = ", ".join(f"{beam_tables.implied_mass_ratio(mode.root):.3f}" for mode in printed.MODES)
    scales = ", ".join(f"{mode.omega_radps / mode.root**2:.3f}" for mode in printed.MODES)
    strip = beam_tables.corrected_beam()
    deviations = [deviation(mode.omega_radps, row.omega_radps)
            for mode, row in zip(strip.modes(3), printed.MODES, strict=True)]  # fmt: skip
    fit = f"all three frequencies within {percent(max(abs(gap) for gap in deviations))}"
    return [
        Misprint("Table 1, E", "70e9 GPa", "70e9 Pa", "aluminium", "certain"),
        Misprint("Table 1, m", ".035 g", "kg", f"the roots need {implied} beam masses", "certain"),
        Misprint("Table 1, A", "3.07e-8 m^2", f"{strip.area_m2:.3g} m^2",
                 f"{fit}; powers of ten alone leave {percent(worst, 0)}", "inferred"),
        Misprint("Table 1, I", "4.225e-10 m^4", f"{strip.second_moment_m4:.4g} m^4",
                 "b h^3 / 12 of 50.7 x 1.00 mm to the last digit", "inferred"),
        Misprint("Table 2, first beta*l", f"{first.root}", f"{math.sqrt(first.omega_radps / scale):.3f}",
                 f"omega / (beta*l)^2 = {scales}; mu = {implied}, best fit {mass_ratio:.3f}", "certain"),
        Misprint("Table 2, first frequency", f"{first.frequency_hz} Hz", f"{hertz:.4f} Hz",
                 f"{first.omega_radps} / 2 pi", "certain"),
    ]  # fmt: skip


def _ranges() -> list[Misprint]:
    rows, far = range_tables.objects(), range_tables.far()
    angle, deviation = range_tables.one_angle()
    board = printed.OBJECTS[0]
    return [
        Misprint("Table 3", "one correction angle", "three", "divergence "
                 + ", ".join(f"{1e3 * row['toe_rad']:.3f}" for row in rows) + " mrad; the best one angle, "
                 f"{1e3 * angle:.3f}, misses by up to {1e3 * max(abs(deviation)):.1f} mm", "certain"),
        Misprint("Table 3, errors", f"{board.error_percent} % (board)", f"{rows[0]['error_percent']:.2f} %",
                 "all are cut off, not rounded", "likely; rounding of the millimetres would allow it"),
        Misprint("Table 4, corrected", f"{printed.FAR_CORRECTED_M} m", f"{far['corrected_by_tables_residual_m']:.2f} m",
                 f"the board's residual of Table 3; half its correction gives {far['corrected_by_half_m']:.2f} m",
                 "certain that it does not follow; half: inferred"),
        Misprint("Table 4, text", f"corrected by {printed.FAR_REMOVED_PERCENT} %",
                 f"{percent(far['range_error_removed'])} of the range error",
                 f"of the angle, which is what is corrected, {percent(far['share_corrected_by_printed'], 1)}",
                 "certain"),
    ]  # fmt: skip


def section() -> Section:
    """The list."""
    entries = misprints()
    certain = sum(entry.sure.startswith("certain") for entry in entries)
    findings = (
        f"{len(entries)} places do not hold as printed; {certain} of them beyond doubt, the others by inference. "
        "Each is worked out in its own section below.",
        "None of them touches the method: with the misprints repaired, tables and figures follow from the code that "
        "flies. The range that Table 4 claims after correction, however, does not follow from Table 3.",
    )
    rows = tuple((str(n), e.where, e.says, e.instead, e.shown_by, e.sure) for n, e in enumerate(entries, start=1))
    table = Table(("", "where", "printed", "instead", "shown by", "sure?"), rows, title="Misprints")
    return Section("misprints", "Where the paper disagrees with itself", findings, (table,), (),
                   {"misprints": [asdict(entry) for entry in entries]})  # fmt: skip
