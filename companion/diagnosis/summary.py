"""A diagnosis in three sentences: what the cause is, what knowing it is worth in metres, and what to do next."""

from __future__ import annotations

import math
from typing import Any

from companion.core.wing.effects import catalogue

FAR_M = 60  # convention: the far target of the paper, for which its Table 4 is computed
_FAR_SIGMAS = 1.5  # prior sigmas from which a deviation is worth writing into the airframe file (choice)
_IDENTIFIED = [f"{family}.{name}" for family in ("symmetric", "antisymmetric") for name in ("frequency", "damping")]
_LEAST_SHARE = 0.05  # least decrease relative to the range error that is worth a flight (choice)
_LEAST_M = 0.05  # chosen: a gain of less is no reason to change an airframe file


def summary_sentences(plain: dict[str, Any], tones: list[str]) -> dict[str, str]:
    """``cause``, ``worth`` and ``next`` of a diagnosis of flights as its JSON has it.

    ``tones`` are sentences of the steady tones that single stations show.
    """
    sentences = {"cause": _cause(plain), "worth": _worth(plain), "next": _next(plain)}
    if tones and plain["verdict"] != "adequate":
        sentences["cause"] += f" A steady tone is there, which no gust makes: {'; '.join(tones)}."
        if plain["verdict"] == "unexplained":
            sentences["next"] = (
                "A propeller, a shaker or a supply makes a steady tone: look what turns or is switched at its "
                "frequency, and record once more without it. " + sentences["next"]
            )
    return sentences


def _cause(plain: dict[str, Any]) -> str:
    if plain["verdict"] == "adequate":
        far = _far_off(plain)
        beside = f", with {' and '.join(far)}, which the file's sigmas allow" if far else ""
        return f"The believed airframe explains this recording within what was believed of it{beside}."
    if plain["verdict"] == "explained":
        return f"The simulation lacks {' and '.join(map(_named, plain['causes']))}."
    if plain["verdict"] == "not-identifiable":
        return f"This recording cannot tell: {plain['reason']}."
    near = " and ".join(map(_named, plain["nearest_causes"]))
    nearest = f" Nearest in the catalogue, but not it or not all of it: {near}." if near else ""
    return f"The simulation is wrong here, and no effect of the catalogue explains it.{nearest}"


def _far_off(plain: dict[str, Any]) -> list[str]:
    """Frequencies and dampings that an identification would write and that lie far off in their priors."""
    return [
        f"{entry['name']} {100.0 * math.expm1(entry['deviation']):+.0f} % ({away:.1f} sigmas)"
        for entry in plain.get("airframe_parameters", [])
        if entry["name"] in _IDENTIFIED and (away := abs(entry["prior_sigmas_away"])) > _FAR_SIGMAS
    ]


def _named(cause: dict[str, Any]) -> str:
    name = f"{cause['name']} ({cause['channel']})" if cause["channel"] else str(cause["name"])
    if cause["seen_in_samples"]:
        return f"{name}: {cause['seen_in_samples']}"
    values = ", ".join(
        f"{entry['meaning']} {entry['value']:.3g} ± {entry['sigma']:.1g} {entry['unit']}".rstrip()
        for entry in cause["parameters"].values()
    )
    return f"{name} ({values})"


def worthwhile(plain: dict[str, Any]) -> bool | None:
    """Whether the cause reduces the range error at 60 m by 5 cm and 5 %; None where no matches were held out."""
    pair = _far(plain)
    if pair is None:
        return None
    before, after = pair
    return before - after > max(_LEAST_M, _LEAST_SHARE * before)


def _far(plain: dict[str, Any]) -> tuple[float, float] | None:
    entry = (plain["gain"] or {}).get("range_rms_m", {}).get(str(FAR_M))
    return (entry["before"], entry["after"]) if entry else None


def _worth(plain: dict[str, Any]) -> str:
    pair = _far(plain)
    if plain["verdict"] == "adequate":
        return "No effect that has a name would gain anything."
    if plain["verdict"] == "unexplained" and plain["gain"] is None:
        return "What it is worth was not measured on held-out blocks, because no effect explains this recording."
    if pair is None:
        return "No image matches were held out here, so that its worth in metres is unknown."
    before, after = pair
    toe = (plain["gain"] or {}).get("toe_rms_rad")
    in_toe = f" ({1e3 * toe['before']:.2f} to {1e3 * toe['after']:.2f} mrad of relative toe)" if toe else ""
    metres = f"{before:.2f} m rms become {after:.2f} m at {FAR_M} m{in_toe}, on blocks that were not fitted"
    if worthwhile(plain):
        return f"Worth flying: {metres}."
    named = "Named, but not worth flying" if plain["verdict"] == "explained" else "Not worth flying as far as it goes"
    return f"{named}: {metres}."


def _next(plain: dict[str, Any]) -> str:
    if plain["verdict"] == "adequate":
        rewrite = "Write them with `spanwise identify flight`: the tracker begins with the file's."
        return rewrite if _far_off(plain) else "Fly on."
    causes = plain["causes"] or plain["nearest_causes"]
    advice = "; ".join(dict.fromkeys(cause["advice"] for cause in causes if cause["advice"]))
    apart = [cause["name"] for cause in causes if cause["group"]]
    sentences = []
    if plain["verdict"] == "explained":
        of_recording = [cause["name"] for cause in causes if _belongs_to_recording(cause["name"])]
        if worthwhile(plain) is False:
            sentences.append("Leave the airframe file as it is.")
        elif len(of_recording) < len(causes):
            sentences.append("Write it into the airframe file with --apply, and fly once more to confirm it.")
        if of_recording:
            sentences.append(f"Not for the airframe file, for it belongs to this recording: {', '.join(of_recording)}.")
    elif not advice:
        sentences.append("Record again with cameras, and with what may have changed: temperature, speed, rpm.")
    if advice:
        sentences.append(f"To {'tell it from its group' if apart else 'check it'}: {advice}.")
    return " ".join(sentences)


def _belongs_to_recording(name: str) -> bool:
    return catalogue()[name].belongs_to_recording()
