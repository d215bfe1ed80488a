"""The diagnosis as one self-contained page: verdict, causes, gain, evidence, confusion and advice, what was tested."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from companion.diagnosis.json_report import sentence
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.selection.verdict import Diagnosis, Verdict
from companion.evaluation.pages import diagnosis_figures as figures
from companion.reporting.page import advice, heading, page, paragraph, picture, table, told

_CHECKS = 12
_ASKED = {"cause": "What is wrong", "worth": "What it is worth", "next": "What to do next"}


def write_report(found: Diagnosis, models: Sequence[FlightModel], plain: dict[str, Any], path: Path) -> None:
    """Write the page."""
    fits, model = figures.fits_of(found), models[0]
    body = [
        told([(_ASKED[key], plain["words"][key]) for key in _ASKED]),
        *_causes(plain),
        *_left(plain),
        heading("Evidence: the simulation against the recording"),
        picture(figures.spectra(fits, model), "spectra of both tips, recorded and modelled"),
        picture(figures.innovations(fits, model), "innovations, backbone and missing force"),
    ]
    if model.observations.toe is not None:
        body.append(picture(figures.ranges(fits, model), "range residuals"))
    body += [*_views(plain), *_gain(found, plain)]
    if found.verdict is not Verdict.NOT_IDENTIFIABLE:
        body += [
            heading("What was tested, and what cannot be told apart"),
            picture(figures.screening(found), "strength of each effect and confusion matrix"),
        ]
    body += [*_advices(plain), *_checks(plain), *_parameters(plain), *_notes(plain)]
    path.write_text(page(str(found.verdict), sentence(found), _what(plain, models), body), encoding="utf-8")


def _what(plain: dict[str, Any], models: Sequence[FlightModel]) -> str:
    seconds = sum(model.observations.duration_s for model in models)
    return (
        f"{', '.join(plain['recordings'])}: {seconds:.0f} s judged, against the believed airframe {plain['airframe']}"
    )


def _causes(plain: dict[str, Any]) -> list[str]:
    causes = plain["causes"]
    if not causes:
        return []
    rows = [_cause_row(cause) for cause in causes]
    found = [heading("Causes, strongest first")]
    found.append(table(["cause", "parameters", "log Bayes factor", "BIC", "cannot be told from"], rows))
    return found


def _advices(plain: dict[str, Any]) -> list[str]:
    return [advice(_advice(cause)) for cause in plain["causes"] if cause["group"] or cause["advice"]]


def _views(plain: dict[str, Any]) -> list[str]:
    """How far each view lies from what the model itself would show."""
    views = sorted(plain["views"], key=lambda one: -_change(one))
    rows = [[one["view"], _sigmas(one["before"]), _sigmas(one["after"]), f"{_change(one):+.1f}"] for one in views]
    if not rows:
        return []
    last = [abs(one["before"] if one["after"] is None else one["after"]) for one in views]
    what = (
        "Each view as a number: standard deviations from recordings simulated from the same model (5: no chance), "
        "those that changed most first; marked is what is left worst."
    )
    heads = ["view", "believed model, fitted", "extended model", "change"]
    return [paragraph(what), table(heads, rows, last.index(max(last)))]


def _change(view: dict[str, Any]) -> float:
    """By how many standard deviations the causes bring a view nearer to what the model shows."""
    return 0.0 if view["after"] is None else float(abs(view["before"]) - abs(view["after"]))


def _sigmas(value: float | None) -> str:
    return "–" if value is None else f"{value:+.1f}"


def _cause_row(cause: dict[str, Any]) -> list[str]:
    values = "; ".join(
        f"{key} = {_number(entry['value'])} ± {_number(entry['sigma'])} {entry['unit']}".rstrip()
        for key, entry in cause["parameters"].items()
    )
    return [
        cause["name"] + (f" ({cause['channel']})" if cause["channel"] else ""),
        cause["seen_in_samples"] or values,
        f"{cause['log_bayes_factor']:.1f}",
        f"{cause['bic']:+.1f}",
        ", ".join(cause["group"]) or "–",
    ]


def _advice(cause: dict[str, Any]) -> str:
    said = f"{cause['name']}: "
    if cause["group"]:
        said += f"this recording cannot tell it from {', '.join(cause['group'])}. "
    return said + (f"To separate or mend it: {cause['advice']}." if cause["advice"] else "")


def _left(plain: dict[str, Any]) -> list[str]:
    """What an unexplained recording leaves, described and not named."""
    residual = plain["residual"]
    if residual is None:
        return []
    rows = [[entry["test"], f"{entry['z']:+.1f}"] for entry in residual["failed"]]
    found = [heading("What is left over")]
    if plain["nearest_causes"]:
        near = ", ".join(cause["name"] for cause in plain["nearest_causes"])
        found.append(paragraph(f"Nearest in the catalogue: {near}. It is not the cause, or not all of it."))
    found.append(table(["what the extended model still does not explain", "sigma"], rows))
    follows = [f"{entry['follows']} ({entry['z']:+.1f} sigma)" for entry in residual["latent_force"]]
    if follows:
        found.append(paragraph(f"A force without a name would follow: {', '.join(follows)}."))
    return found


def _gain(found: Diagnosis, plain: dict[str, Any]) -> list[str]:
    gain = plain["gain"]
    if gain is None or found.gain is None:
        return []
    rows = [
        [name, f"{entry['after']:+.1f} nat", f"{entry['interval'][0]:.1f} to {entry['interval'][1]:.1f}"]
        for name, entry in [("all channels", gain["total"]), *gain["channels"].items()]
    ]
    body = [heading("What it is worth, on blocks that were not fitted")]
    body.append(table(["prediction log score", "gain", "95 % (block bootstrap)"], rows))
    if found.gain.toe_rms_rad is not None:
        metres = [
            [f"{distance} m", f"{entry['before']:.2f} m", f"{entry['after']:.2f} m"]
            for distance, entry in gain["range_rms_m"].items()
        ]
        body.append(table(["range error at (rms, matching noise included)", "before", "after"], metres))
        body.append(picture(figures.gains(found.gain.range_rms_m, found.gain.toe_rms_rad), "range error by distance"))
    return body


def _checks(plain: dict[str, Any]) -> list[str]:
    before = {entry["test"]: entry["z"] for entry in plain["adequacy"]["before"]}
    rows = [
        [
            entry["test"],
            f"{before[entry['test']]:+.1f}" if entry["test"] in before else "–",
            f"{entry['z']:+.1f}",
            "passed" if entry["passed"] else "failed",
        ]
        for entry in plain["adequacy"]["after"][:_CHECKS]
    ]
    if not rows:
        return []
    count = len(plain["adequacy"]["after"])
    what = f"Standard deviations from what the model itself would show; the {len(rows)} worst of {count} tests."
    return [heading("Adequacy"), paragraph(what), table(["test", "believed model", "extended model", ""], rows)]


def _parameters(plain: dict[str, Any]) -> list[str]:
    rows = [
        [
            entry["name"],
            f"{_number(entry['deviation'])} ± {_number(entry['sigma'])}",
            _number(entry["prior_sigma"]),
            f"{entry['prior_sigmas_away']:+.1f}",
        ]
        for entry in plain["airframe_parameters"]
    ]
    heads = ["airframe parameter", "deviation from the belief (positive ones: of the logarithm)", "prior sigma", "away"]
    listed = table(heads, rows)
    title = html.escape("What the fit makes of the believed airframe")
    return [f"<details><summary><b>{title}</b></summary>{listed}</details>"]


def _notes(plain: dict[str, Any]) -> list[str]:
    return [paragraph(f"Note: {note}") for note in plain["notes"]]


def _number(value: float) -> str:
    return f"{value:.4g}"
