"""Rows of the documented JSON that every kind of diagnosis shares (companion/diagnosis/JSON.md)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from companion.diagnosis.selection.block_bootstrap import Interval
from companion.diagnosis.selection.check import Check, DiagnosisVerdict
from companion.diagnosis.selection.cross_validation import HeldOut
from companion.diagnosis.selection.recordings import Cause
from companion.diagnosis.selection.score_tests import Candidate

_FORMAT = 1  # version of the JSON (convention)
_SIGMAS_95 = 1.959964  # two-sided 95 % of a normal distribution (derived)


def opening(recordings: Iterable[str], airframe: str | None, verdict: DiagnosisVerdict, reason: str) -> dict[str, Any]:
    """Format, recordings and verdict, which every diagnosis opens with."""
    return {
        "format": _FORMAT,
        "recordings": list(recordings),
        "airframe": airframe,
        "verdict": str(verdict),
        "reason": reason,
    }


def quantity(value: float, sigma: float, unit: str, meaning: str) -> dict[str, Any]:
    """A value with its sigma and 95 % interval."""
    interval = [value - _SIGMAS_95 * sigma, value + _SIGMAS_95 * sigma]
    return {"value": value, "sigma": sigma, "unit": unit, "interval": interval, "meaning": meaning}


def checks(tested: Iterable[Check]) -> list[dict[str, Any]]:
    """Adequacy tests, passed or not."""
    return [{"test": entry.name, "z": entry.z, "passed": entry.passed} for entry in tested]


def failures(tested: Iterable[Check]) -> list[dict[str, Any]]:
    """Adequacy tests that failed."""
    return [{"test": entry.name, "z": entry.z} for entry in tested if not entry.passed]


def adequacy(before: Iterable[Check], after: Iterable[Check]) -> dict[str, Any]:
    """Adequacy tests of the believed and of the extended model."""
    return {"before": checks(before), "after": checks(after)}


def residual(verdict: DiagnosisVerdict, description: str, after: Iterable[Check]) -> dict[str, Any] | None:
    """Description of what is left without a name, and the tests that failed; None where nothing is."""
    if verdict is not DiagnosisVerdict.UNEXPLAINED:
        return None
    return {"description": description, "failed": failures(after)}


def screening(candidates: Iterable[Candidate[Any]]) -> list[dict[str, Any]]:
    """Score and evidence of every candidate."""
    return [
        {"name": entry.name, "channel": entry.term.channel or None, "z": entry.z, "log_odds": entry.log_odds}
        for entry in candidates
    ]


def cause_head(cause: Cause[Any], channel: str) -> dict[str, Any]:
    """Name, channel, group and evidence, which every kind of cause opens with."""
    return {
        "name": cause.term.name,
        "channel": channel or None,
        "group": list(cause.group),
        "log_bayes_factor": cause.log_bayes_factor,
        "bic": cause.bic,
        "z": cause.z,
    }


def nats(gain: Interval) -> dict[str, Any]:
    """Gain of a held-out log score."""
    return {"before": 0.0, "after": gain[0], "unit": "nat", "interval": [gain[1], gain[2]]}


def held_out_gain(before: HeldOut, after: HeldOut, unit: str, error_of: str) -> dict[str, Any]:
    """Gain on blocks that were not fitted: log score, and the error's decrease with its 95 % interval."""
    gone, low, high = after.gone(before)
    return {
        "held_out": True,
        "total": nats(after.gained(before)["total"]),
        "error": {
            "before": before.rms,
            "after": after.rms,
            "unit": unit,
            "what": error_of,
            "share_of_signal": [before.share_of_signal, after.share_of_signal],
            "share_of_square_gone": gone,
            "interval": [low, high],
        },
    }


def deviation(name: str, value: float, sigma: float, prior_sigma: float, logarithmic: bool) -> dict[str, Any]:
    """Deviation of an airframe parameter from its file, beside its prior."""
    return {
        "name": name,
        "deviation": value,
        "logarithmic": logarithmic,
        "prior_sigma": prior_sigma,
        "sigma": sigma,
        "prior_sigmas_away": value / prior_sigma,
    }
