"""The diagnosis as one self-contained page: verdict, causes, gain, evidence, confusion and advice, what was tested."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from companion.diagnosis.flights.outcome import FlightDiagnosis, sentence
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.evaluation.pages import diagnosis_figures as figures
from companion.reporting.blocks import Advice, Answers, Block, Details, Heading, Page, Paragraph, Table
from companion.reporting.embedding import embed
from companion.reporting.page import render

_CHECKS = 12  # rows of a legible table (choice)
_ASKED = {"cause": "What is wrong", "worth": "What it is worth", "next": "What to do next"}


def diagnosis_page(diagnosis: FlightDiagnosis, models: Sequence[FlightModel], plain: dict[str, Any]) -> str:
    """The page as HTML; ``plain`` is the diagnosis's JSON."""
    fits, model = figures.fits_of(diagnosis), models[0]
    body: list[Block] = [
        Answers([(_ASKED[key], plain["words"][key]) for key in _ASKED]),
        *_causes(plain),
        *_residual(plain),
        Heading("Evidence: the simulation against the recording"),
        embed(figures.spectra(fits, model), "spectra of both tips, recorded and modelled"),
        embed(figures.innovations(fits, model), "innovations, backbone and missing force"),
    ]
    if model.observations.toe is not None:
        body.append(embed(figures.ranges(fits, model), "range residuals"))
    body += [*_views(plain), *_gain(diagnosis, plain)]
    if diagnosis.verdict is not DiagnosisVerdict.NOT_IDENTIFIABLE:
        body += [
            Heading("What was tested, and what cannot be told apart"),
            embed(figures.screening(diagnosis), "strength of each effect and confusion matrix"),
        ]
    notes = [Paragraph(f"Note: {note}") for note in plain["notes"]]
    body += [*_advices(plain), *_checks(plain), *_parameters(plain), *notes]
    page = Page(
        title=f"Diagnosis: {diagnosis.verdict}", headline=sentence(diagnosis), body=body, subject=_what(plain, models),
        grade=str(diagnosis.verdict),
    )  # fmt: skip
    return render(page)


def _what(plain: dict[str, Any], models: Sequence[FlightModel]) -> str:
    seconds = sum(model.observations.duration_s for model in models)
    return (
        f"{', '.join(plain['recordings'])}: {seconds:.0f} s judged, against the believed airframe {plain['airframe']}"
    )


def _causes(plain: dict[str, Any]) -> list[Block]:
    rows = [_cause_row(cause) for cause in plain["causes"]]
    heads = ["cause", "parameters", "log Bayes factor", "BIC", "cannot be told from"]
    return [Heading("Causes, strongest first"), Table(heads, rows)] if rows else []


def _advices(plain: dict[str, Any]) -> list[Block]:
    return [Advice(_advice(cause)) for cause in plain["causes"] if cause["group"] or cause["advice"]]


def _views(plain: dict[str, Any]) -> list[Block]:
    """How far each view lies from what the model itself would show."""
    views = sorted(plain["views"], key=lambda view: -_change(view))
    rows = [[view["view"], _sigmas(view["before"]), _sigmas(view["after"]), f"{_change(view):+.1f}"] for view in views]
    if not rows:
        return []
    last = [abs(view["before"] if view["after"] is None else view["after"]) for view in views]
    what = (
        "Each view as a number: standard deviations from recordings simulated from the same model (5: no chance), "
        "those that changed most first; marked is what is left worst."
    )
    heads = ["view", "believed model, fitted", "extended model", "change"]
    return [Paragraph(what), Table(heads, rows, last.index(max(last)))]


def _change(view: dict[str, Any]) -> float:
    """Standard deviations by which the causes bring a view nearer to the model."""
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


def _residual(plain: dict[str, Any]) -> list[Block]:
    """Residuals of an unexplained recording, described and not named."""
    residual = plain["residual"]
    if residual is None:
        return []
    rows = [[entry["test"], f"{entry['z']:+.1f}"] for entry in residual["failed"]]
    blocks: list[Block] = [Heading("What is left over")]
    if plain["nearest_causes"]:
        near = ", ".join(cause["name"] for cause in plain["nearest_causes"])
        blocks.append(Paragraph(f"Nearest in the catalogue: {near}. It is not the cause, or not all of it."))
    blocks.append(Table(["what the extended model still does not explain", "sigma"], rows))
    follows = [f"{entry['follows']} ({entry['z']:+.1f} sigma)" for entry in residual["latent_force"]]
    if follows:
        blocks.append(Paragraph(f"A force without a name would follow: {', '.join(follows)}."))
    return blocks


def _gain(diagnosis: FlightDiagnosis, plain: dict[str, Any]) -> list[Block]:
    gain = plain["gain"]
    if gain is None or diagnosis.gain is None:
        return []
    rows = [
        [name, f"{entry['after']:+.1f} nat", f"{entry['interval'][0]:.1f} to {entry['interval'][1]:.1f}"]
        for name, entry in [("all channels", gain["total"]), *gain["channels"].items()]
    ]
    body: list[Block] = [Heading("What it is worth, on blocks that were not fitted")]
    body.append(Table(["prediction log score", "gain", "95 % (block bootstrap)"], rows))
    if gain["toe_rms_rad"] is not None:
        metres = [
            [f"{distance} m", f"{entry['before']:.2f} m", f"{entry['after']:.2f} m"]
            for distance, entry in gain["range_rms_m"].items()
        ]
        body.append(Table(["range error at (rms, matching noise included)", "before", "after"], metres))
        body.append(embed(figures.gains(gain), "range error by distance"))
    return body


def _checks(plain: dict[str, Any]) -> list[Block]:
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
    return [Heading("Adequacy"), Paragraph(what), Table(["test", "believed model", "extended model", ""], rows)]


def _parameters(plain: dict[str, Any]) -> list[Block]:
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
    return [Details("What the fit makes of the believed airframe", Table(heads, rows))]


def _number(value: float) -> str:
    return f"{value:.4g}"
