"""The verdict on an oscillator with a measured force as plain data (companion/diagnosis/JSON.md)."""

from __future__ import annotations

import math
from typing import Any

from companion.core.wing.effects.stiffness.cubic_stiffness import CubicStiffness
from companion.core.wing.effects.stiffness.quadratic_stiffness import QuadraticStiffness
from companion.diagnosis.forced.equation_rows import LAWS
from companion.diagnosis.forced.noise_bias import MOST_NOISE
from companion.diagnosis.forced.recordings import ForcedDiagnosis
from companion.diagnosis.json_rows import adequacy, cause_head, held_out_gain, opening, quantity, residual, screening
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.diagnosis.selection.recordings import Cause
from companion.diagnosis.selection.regression import RegressionTerm

_ACTIVE = "no passive structure has that; check which force and response were recorded"


def as_json(diagnosis: ForcedDiagnosis) -> dict[str, Any]:
    """Everything that a program would read; None where there is nothing to say."""
    outcome = diagnosis.outcome
    causes = outcome.causes or outcome.nearest_causes
    unexplained = outcome.verdict is DiagnosisVerdict.UNEXPLAINED
    named = ", ".join(cause.term.name for cause in causes)
    reason = f"the law is {named}" if named else "a linear spring and damper explain these recordings"
    if unexplained:
        reason = f"explained so far: {named or 'nothing'}; {outcome.reason}"
    return {
        **opening((entry.name for entry in diagnosis.recordings), None, outcome.verdict, reason),
        "causes": [_cause(diagnosis, cause) for cause in causes],
        "nearest": outcome.nearest or None if unexplained else None,
        "gain": _gain(diagnosis),
        "adequacy": adequacy(outcome.before, outcome.after),
        "residual": residual(outcome.verdict, outcome.reason, outcome.after),
        "screening": screening(outcome.screening.candidates),
        "linear": {name: _linear(diagnosis, extended) for name, extended in (("before", False), ("after", True))},
        "airframe_parameters": [],
        "notes": [
            *diagnosis.notes,
            *_zero(diagnosis),
            *_bias(diagnosis),
            *(f"{name} comes out negative: {_ACTIVE}" for name in diagnosis.negative()),
        ],
    }


def _cause(diagnosis: ForcedDiagnosis, cause: Cause[RegressionTerm]) -> dict[str, Any]:
    value, sigma = diagnosis.coefficient(cause)
    meaning = f"force {LAWS[cause.term.name][0]}, in the units that the mapping gives"
    return {
        **cause_head(cause, ""),
        "parameters": {"coefficient": quantity(value, sigma, "", meaning)},
        "gain": (_gain(diagnosis) or {}).get("error"),
        "advice": "drive it at several levels: a law of the amplitude shows between them",
    }


def _zero(diagnosis: ForcedDiagnosis) -> list[str]:
    """Where a cube and a square stand together: about which zero they are one cube.

    k d + k_3 d^3 with d = q - q_0 has the square -3 k_3 q_0 q^2 and the slope k + 3 k_3 q_0^2.
    """
    accepted = {cause.term.name: cause for cause in (*diagnosis.outcome.causes, *diagnosis.outcome.nearest_causes)}
    if not {CubicStiffness.name, QuadraticStiffness.name} <= set(accepted):
        return []
    cubic, _ = diagnosis.coefficient(accepted[CubicStiffness.name])
    square, _ = diagnosis.coefficient(accepted[QuadraticStiffness.name])
    zero, stiffness = -square / (3.0 * cubic), float(diagnosis.linear(True)[2])
    return [
        f"cubic and quadratic stiffness together are one cubic spring about a response of {zero:.4g} from the "
        f"recording's own zero, with a stiffness of {stiffness - square**2 / (3.0 * cubic):.5g} there"
    ]


def _bias(diagnosis: ForcedDiagnosis) -> list[str]:
    """Where the coefficients could not be freed of what the response's noise does to them."""
    if diagnosis.consistent[1] is not None:
        return []
    ratio = diagnosis.noise_ratio()
    if ratio <= MOST_NOISE:
        return [
            "no motion of the fitted law is near the response: coefficients are freed of its noise to first order "
            "alone, and may lie beyond their intervals; drive harder, or at another level"
        ]
    return [
        f"the response's noise draws the coefficients to 0, by a bias too large to be taken off: it is {ratio:.2f} of "
        f"the normal matrix, {MOST_NOISE:g} at most; drive harder, or narrow band_hz"
    ]


def _gain(diagnosis: ForcedDiagnosis) -> dict[str, Any] | None:
    gain = diagnosis.outcome.gain
    if gain is None:
        return None
    error_of = "force in the band, on segments that were not fitted"
    return held_out_gain(gain.before, gain.after, "of the spectrum", error_of)


def _linear(diagnosis: ForcedDiagnosis, extended: bool) -> dict[str, float]:
    m, c, k = diagnosis.linear(extended).tolist()
    root = math.sqrt(max(k * m, 0.0))
    sigmas = zip(("mass_sigma", "damping_sigma", "stiffness_sigma"), diagnosis.linear_sigmas(extended), strict=True)
    return {
        "mass": m,
        "damping": c,
        "stiffness": k,
        "frequency_hz": math.sqrt(max(k / m, 0.0)) / (2.0 * math.pi),
        "damping_ratio": 0.5 * c / root if root else 0.0,
        **{name: float(sigma) for name, sigma in sigmas},
    }
