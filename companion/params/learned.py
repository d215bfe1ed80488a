"""Trigger latencies learned in a flight, kept for the next one in a small TOML file beside the parameters.

Latency belongs to a path: these cameras behind this trigger. The file says which; on another path it is not used. It
comes back as the airframe's ``latency_s``, so that a recording, which holds the airframe, replays with it.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.errors import ConfigError
from companion.params.airframe import Airframe, Uncertain
from companion.params.persist import write_atomically
from companion.params.toml import quoted
from companion.records import TriggerLatency

_LEAST_SHOTS = 10  # for a spread known to a quarter (choice)
_LONGEST_S = 0.5  # chosen: the longest latency that is learned in flight (core/trigger/latency.py)
_SIDES = ("left", "right")


@dataclass(frozen=True, slots=True)
class LearnedLatency:
    """Latency of one path, left and right camera.

    ``path`` is trigger and cameras as they were named.
    """

    path: str
    latency_s: tuple[Uncertain, Uncertain]
    shots: int


def keep_latency(file: Path, path: str, learned: TriggerLatency) -> bool:
    """Write what was learned, whole or not at all; False where it rests on too few shots to be worth it.

    Raises
    ------
    ConfigError
        The file cannot be written.
    """
    if learned.shots < _LEAST_SHOTS:
        return False
    lines = [f"path = {quoted(path)}", f"shots = {learned.shots}"]
    for side, value, sigma in zip(_SIDES, learned.latency_s.tolist(), learned.sigma_s.tolist(), strict=True):
        lines.append(f"{side}_s = {{ value = {value!r}, sigma = {sigma!r} }}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(file, "\n".join(lines) + "\n")
    except OSError as error:
        raise ConfigError(f"cannot keep the trigger's latency in {file}: {error.strerror}") from error
    return True


def load_latency(file: Path) -> LearnedLatency | None:
    """Read what was kept; None where nothing can be read. Raises :class:`ConfigError` for a file that is damaged."""
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
        left, right = (_uncertain(table[f"{side}_s"]) for side in _SIDES)
        return LearnedLatency(str(table["path"]), (left, right), int(table["shots"]))
    except OSError:
        return None
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise ConfigError(f"{file}: not a latency that was kept here ({error}); delete it") from error


def with_latency(airframe: Airframe, learned: LearnedLatency | None, path: str) -> Airframe:
    """The airframe with the latency that this path had in the last flight; unchanged where that is not known."""
    if learned is None or learned.path != path or airframe.left_camera is None:
        return airframe
    latency_s = learned.latency_s
    return airframe.with_cameras(lambda side, camera: dataclasses.replace(camera, latency_s=latency_s[side]))


def _uncertain(entry: Any) -> Uncertain:
    value, sigma = float(entry["value"]), float(entry["sigma"])
    if not (0.0 <= value <= _LONGEST_S and 0.0 < sigma <= _LONGEST_S and math.isfinite(value + sigma)):
        raise ValueError(f"{value!r} +- {sigma!r} s is no latency")
    return Uncertain(value, sigma)
