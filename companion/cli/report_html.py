"""The diagnosis as one self-contained page: verdict, evidence, gain, confusion and advice, what was tested."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from companion.diagnosis.report import sentence
from companion.diagnosis.supermodel import SuperModel
from companion.diagnosis.verdict import Diagnosis, Verdict
from companion.records import Floats

_BEFORE, _AFTER, _DATA = "#c2571a", "#1f6fb4", "#9aa3ad"
_COLOURS = {
    Verdict.ADEQUATE: "#2e7d4f",
    Verdict.EXPLAINED: "#1f6fb4",
    Verdict.UNEXPLAINED: "#b23b2e",
    Verdict.NOT_IDENTIFIABLE: "#8a6d1d",
}
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#20262d;max-width:1080px;margin:2rem auto;padding:0 1.2rem}
h1{font-size:1.5rem;color:#fff;padding:1rem 1.2rem;border-radius:8px;margin:0 0 .4rem}
h2{font-size:1.15rem;margin:2rem 0 .5rem;border-bottom:1px solid #d9dee3;padding-bottom:.2rem}
p.what{color:#5b6670;margin:.2rem 0 1rem}table{border-collapse:collapse;width:100%;font-size:.93rem}
th,td{text-align:left;padding:.35rem .6rem;border-bottom:1px solid #e6eaee}th{color:#5b6670;font-weight:600}
td.n{text-align:right;font-variant-numeric:tabular-nums}img{width:100%;margin:.3rem 0}
.advice{background:#f3f6f9;border-left:4px solid #1f6fb4;padding:.6rem .9rem;border-radius:4px;margin:.6rem 0}
.bad{color:#b23b2e;font-weight:600}
"""


def write_report(found: Diagnosis, models: Sequence[SuperModel], plain: dict[str, Any], path: Path) -> None:
    """Write the page."""
    body = [
        f'<h1 style="background:{_COLOURS[found.verdict]}">{html.escape(_capital(sentence(found)))}</h1>',
        f'<p class="what">{html.escape(_what(plain, models))}</p>',
        *_causes(plain),
        "<h2>Evidence</h2>",
        _picture(_spectra(found, models[0])),
        _picture(_ranges(found, models[0])) if models[0].seen.toe is not None else "",
        *_gain(plain),
        "<h2>What was tested</h2>",
        _picture(_screening(found)),
        *_checks(plain),
        *_parameters(plain),
        *_notes(plain),
    ]
    title = f"Diagnosis: {plain['verdict']}"
    page = f"<!doctype html><html lang=en><meta charset=utf-8><title>{title}</title><style>{_STYLE}</style>"
    path.write_text(page + "\n".join(body) + "</html>\n", encoding="utf-8")


def _what(plain: dict[str, Any], models: Sequence[SuperModel]) -> str:
    seconds = ", ".join(f"{model.seen.duration_s:.0f} s" for model in models)
    return f"{', '.join(plain['recordings'])} ({seconds}), against the believed airframe {plain['airframe']}"


def _causes(plain: dict[str, Any]) -> list[str]:
    if not plain["causes"]:
        return []
    rows = []
    for cause in plain["causes"]:
        name = cause["name"] + (f" ({cause['channel']})" if cause["channel"] else "")
        values = "<br>".join(
            html.escape(f"{key} = {_number(entry['value'])} ± {_number(entry['sigma'])} {entry['unit']}")
            for key, entry in cause["parameters"].items()
        )
        rows.append([name, values, f"{cause['log_bayes_factor']:.1f}", f"{cause['bic']:+.1f}",
                     ", ".join(cause["group"]) or "–"])  # fmt: skip
    advice = [
        f'<p class="advice"><b>{html.escape(cause["name"])}</b>'
        + (f" cannot be told from {html.escape(', '.join(cause['group']))} in this recording" if cause["group"] else "")
        + (f". What would separate or mend it: {html.escape(cause['advice'])}." if cause["advice"] else ".")
        + "</p>"
        for cause in plain["causes"]
        if cause["group"] or cause["advice"]
    ]
    heads = ["cause", "parameters", "log Bayes factor", "BIC", "cannot be told from"]
    return ["<h2>Causes, strongest first</h2>", _table(heads, rows, raw={1}), *advice]


def _gain(plain: dict[str, Any]) -> list[str]:
    gain = plain["gain"]
    if gain is None:
        return []
    rows = [
        [name, f"{entry['after']:+.1f} nat", f"{entry['interval'][0]:.1f} to {entry['interval'][1]:.1f}"]
        for name, entry in [("total", gain["total"]), *gain["channels"].items()]
    ]
    metres = [
        [f"{distance} m", f"{entry['before']:.2f} m", f"{entry['after']:.2f} m"]
        for distance, entry in gain["range_rms_m"].items()
    ]
    found = ["<h2>What it is worth, on blocks that were not fitted</h2>"]
    found.append(_table(["log score", "gain", "95 % (block bootstrap)"], rows))
    if metres:
        found.append(_table(["range error (rms, matching noise included)", "before", "after"], metres))
    return found


def _checks(plain: dict[str, Any]) -> list[str]:
    before = {entry["test"]: entry["z"] for entry in plain["adequacy"]["before"]}
    rows = [
        [entry["test"], f"{before.get(entry['test'], float('nan')):+.1f}", f"{entry['z']:+.1f}",
         "passed" if entry["passed"] else "failed"]
        for entry in plain["adequacy"]["after"][:15]
    ]  # fmt: skip
    what = "Standard deviations from what recordings simulated from the model show; the fifteen worst."
    heads = ["test", "believed model", "extended model", ""]
    return ["<h2>Adequacy</h2>", f'<p class="what">{what}</p>', _table(heads, rows)] if rows else []


def _parameters(plain: dict[str, Any]) -> list[str]:
    rows = [
        [entry["name"], f"{_number(entry['deviation'])} ± {_number(entry['sigma'])}", _number(entry["prior_sigma"]),
         f"{entry['prior_sigmas_away']:+.1f}"]
        for entry in plain["airframe_parameters"]
    ]  # fmt: skip
    heads = ["airframe parameter", "deviation from the belief (levels and frequencies: of the logarithm)",
             "prior sigma", "prior sigmas away"]  # fmt: skip
    return ["<h2>What the fit makes of the believed airframe</h2>", _table(heads, rows)]


def _notes(plain: dict[str, Any]) -> list[str]:
    return [f"<p>Note: {html.escape(note)}</p>" for note in plain["notes"]]


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], raw: set[int] | None = None) -> str:
    top = "".join(f"<th>{html.escape(head)}</th>" for head in heads)
    lines = []
    for row in rows:
        cells = [cell if raw and i in raw else html.escape(cell) for i, cell in enumerate(row)]
        marked = ['<td class="bad">' if cell == "failed" else "<td>" for cell in cells]
        lines.append("<tr>" + "".join(f"{mark}{cell}</td>" for mark, cell in zip(marked, cells, strict=True)) + "</tr>")
    return f"<table><tr>{top}</tr>{''.join(lines)}</table>"


def _spectra(found: Diagnosis, model: SuperModel) -> Any:
    from matplotlib.figure import Figure  # takes most of a second to import

    sides = model.seen.sides
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(sides), sharey=True))
    for channel, (axis, side) in enumerate(zip(axes, sides, strict=True)):
        f_hz = model.band_hz
        data = np.abs(model.data_in_band()[channel]) ** 2
        thin, power = _averaged(f_hz, 2.0 * data)
        axis.loglog(thin, np.sqrt(power), color=_DATA, lw=1.6, label="recorded")
        for fitted, colour, label in (
            (found.null, _BEFORE, "believed model, fitted"),
            (found.final, _AFTER, "extended"),
        ):
            if label == "extended" and not found.causes:
                continue
            density = fitted.found[0].spectrum[channel, channel].real
            axis.loglog(f_hz, np.sqrt(2.0 * density), color=colour, lw=1.2, label=label)
        axis.set(title=f"{side.name.lower()} tip", xlabel="Hz", ylabel="m/s² per √Hz" if channel == 0 else "")
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=8)
    return figure


def _ranges(found: Diagnosis, model: SuperModel) -> Any:
    from matplotlib.figure import Figure

    toe = model.seen.toe
    assert toe is not None
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    fits = [(found.null, _BEFORE, "believed model, fitted")]
    fits += [(found.final, _AFTER, "extended")] if found.causes else []
    for fitted, colour, label in fits:
        residual = 1e3 * fitted.found[0].toe_residual_rad
        deflection = 1e3 * np.interp(toe.t_s, model.seen.t_s, fitted.found[0].q_m[0])
        left.plot(toe.t_s, residual, ".", ms=3, color=colour, label=label)
        right.plot(deflection, residual, ".", ms=3, color=colour)
    left.set(title="Range residual as toe", xlabel="time, s", ylabel="mrad")
    right.set(title="against symmetric deflection", xlabel="mm")
    for axis in (left, right):
        axis.grid(alpha=0.3)
    left.legend(fontsize=8)
    return figure


def _screening(found: Diagnosis) -> Any:
    from matplotlib.figure import Figure

    shown = found.screening.candidates[:16]
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    bars, matrix = figure.subplots(1, 2, width_ratios=(1.2, 1))
    names = [entry.name + (f" ({entry.part.channel})" if entry.part.channel else "") for entry in shown]
    named = {cause.part.effect.name for cause in found.causes}
    colours = [_AFTER if entry.name in named else _DATA for entry in shown]
    bars.barh(range(len(shown)), [entry.z for entry in shown], color=colours)
    bars.set_yticks(range(len(shown)), names, fontsize=8)
    bars.invert_yaxis()
    bars.axvline(4.4, color="#b23b2e", lw=1, ls="--")
    bars.set(title="Strength of each named effect (sigma)", xlabel="efficient score; dashed: needed")
    corner = np.abs(found.screening.correlation[: len(shown), : len(shown)])
    image = matrix.imshow(corner, vmin=0, vmax=1, cmap="Blues")
    matrix.set_xticks(range(len(shown)), names, rotation=90, fontsize=6)
    matrix.set_yticks([])
    matrix.set(title="Confusion on this recording, |ρ|")
    figure.colorbar(image, ax=matrix, shrink=0.8)
    return figure


def _averaged(f_hz: Floats, power: Floats) -> tuple[Floats, Floats]:
    """Average over logarithmic bins."""
    edges = np.unique(np.searchsorted(f_hz, np.geomspace(f_hz[0], f_hz[-1], 160)))[:-1]
    count = np.diff(np.append(edges, len(f_hz)))
    return np.add.reduceat(f_hz, edges) / count, np.add.reduceat(power, edges) / count


def _picture(figure: Any) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130)
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}">'


def _number(value: float) -> str:
    return f"{value:.4g}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
