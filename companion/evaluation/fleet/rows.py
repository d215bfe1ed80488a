"""A flight as one row of the fleet's table: scalars by name."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from companion.adapters.recordings.recording import Recording
from companion.evaluation.flight_log import FlightLog
from companion.evaluation.pages.flight_report import verdict
from companion.params.airframe import FAMILIES
from companion.records import Station

_DEEPEST = 3  # levels of a nested result that become columns (choice)
_MOST_TEXT = 160  # chosen: characters of a cell: a sentence, not a page


def flight_row(recording: Recording, log: FlightLog) -> dict[str, Any]:
    """Figures of one flight that can be compared with another's."""
    judged = verdict(recording, log)
    trusted = log.trusted()
    row: dict[str, Any] = {
        "airframe": recording.airframe.name,
        "duration_s": round(log.info.duration_s, 1),
        "verdict": judged.word,
        "ranges": len(log.ranges),
        "published": len(trusted),
        "sigma_ratio": _median([entry.sigma_m / entry.range_m for entry in trusted]),
        "tracked_ratio": round(log.tracked_ratio(), 4),
        "active_ratio": round(log.info.service.active_ratio, 4),
    }
    for name in FAMILIES:
        mode = log.mode(name)
        for column, figure in (("hz", "frequency_hz"), ("sigma_hz", "frequency_sigma_hz"), ("rms_m", "rms_m")):
            row[f"{name}_{column}"] = _rounded(getattr(mode, figure, None))
    filtered = log.filters.applied(recording.airframe)
    for station in Station:
        stream = log.info.streams.get(station)
        rate_hz = None if stream is None else stream.rate_hz
        row[f"{station.name.lower()}_rate_hz"] = None if rate_hz is None else round(rate_hz, 2)
        row[f"{station.name.lower()}_noise"] = _rounded(
            log.noise_density(station, filtered.sensor(station).lowpass_accel_hz)
        )
    for reason, count in log.withheld().items():
        row[f"withheld: {reason}"] = count
    return row


def diagnosis_row(result: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of one diagnosis (its JSON): what was named, and the first parameter of each named effect."""
    causes = result["causes"]
    row: dict[str, Any] = {
        "airframe": result["airframe"],
        "verdict": result["verdict"],
        "effects": ", ".join(cause["name"] for cause in causes),
        "held_out_gain_nat": None if result["gain"] is None else _rounded(result["gain"]["total"]["after"]),
        "reason": result["reason"],
    }
    for cause in causes:
        first = next(iter(cause["parameters"].values()), None)
        row[f"effect: {cause['name']}"] = None if first is None else _rounded(first["value"])
    return row


def identification_row(result: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of one flight's modes: the lowest of each family that is resolved (a steady tone is not one of the wing).

    They have the names that a report's row has for them.
    """
    row: dict[str, Any] = {"airframe": result["airframe"]}
    for family in FAMILIES:
        modes = [mode for mode in result[family] if mode["resolved"]]
        lowest = modes[0] if modes else {}
        for figure in ("frequency_hz", "frequency_sigma_hz", "damping", "damping_sigma"):
            row[f"{family}_{figure.removeprefix('frequency_')}"] = _rounded(lowest.get(figure))
        row[f"{family}_modes"] = len(modes)
    return row


def tuning_row(result: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of one tuning: what was flown, what is proposed, and what that would have given."""
    flown, proposal = result["trials"][0]["outcome"], result["proposal"]
    changed = [trial["outcome"] for trial in result["trials"] if proposal and trial["changes"] == proposal]
    row: dict[str, Any] = {
        "trials": len(result["trials"]) - 1,
        "proposal": ", ".join(f"{name}={value:g}" for name, value in proposal.items()),
        "ranges": flown["ranges"],
        "trusted": flown["trusted"],
        "trusted_then": changed[0]["trusted"] if changed else None,
        "sigma_ratio": _rounded(flown["sigma_ratio"]),
        "sigma_ratio_then": _rounded(changed[0]["sigma_ratio"]) if changed else None,
    }
    return row | {f"proposed: {name}={value:g}": True for name, value in proposal.items()}


def flattened(result: Mapping[str, Any], prefix: str = "", depth: int = 0) -> dict[str, Any]:
    """Scalars of a nested result, by dotted names; lists are counted."""
    row: dict[str, Any] = {}
    for key, value in result.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and depth < _DEEPEST:
            row |= flattened(value, f"{name}.", depth + 1)
        elif isinstance(value, list):
            row[name] = ", ".join(map(str, value))[:_MOST_TEXT] if _is_plain(value) else len(value)
        elif isinstance(value, str):
            row[name] = value[:_MOST_TEXT]
        elif not isinstance(value, Mapping):
            row[name] = value
    return row


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """All rows as one table, columns in the order in which they first come."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    table = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()


def _median(values: list[float]) -> float | None:
    return _rounded(float(np.median(values))) if values else None


def _rounded(value: float | None) -> float | None:
    """Six digits: what a table holds and a further run gives again."""
    return None if value is None else float(f"{value:.6g}")


def _is_plain(values: list[Any]) -> bool:
    return all(isinstance(value, str | int | float) for value in values)
