"""Constants of a flight that the tracker estimates, at its end, beside the truth."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import numpy as np

from companion.core.tracking.tracker import WingTracker
from companion.params.airframe import FAMILIES, Airframe
from companion.records import Station
from companion.sim.flight.perturb import SensorErrors, TruthAirframe

_INSIDE_3_SIGMA = 0.98
_SCALES = {"kz": ("accel_scale", 2), "ky": ("accel_scale", 1), "kp": ("gyro_scale", 0)}
_MISALIGNMENTS = ("mx", "my", "mz")


def constants(tracker: WingTracker, believed: Airframe, real: TruthAirframe) -> dict[str, list[float]]:
    """Estimate, sigma and truth of every constant that the tips' samples tell of, by name, SI units."""
    wing, actual = believed.wing, real.actual.wing
    deviations = {f"slope.{name}": (mode.slope_factor_radpm, actual.modes[name].slope_factor_radpm)
                  for name, mode in wing.modes.items()}  # fmt: skip
    deviations |= {
        "trim": (wing.trim_bend_m, actual.trim_bend_m),
        "bend_per_g": (wing.bend_per_g_m, actual.bend_per_g_m),
    }
    true = {name: after.value - before.value for name, (before, after) in deviations.items()}
    for station in (Station.LEFT, Station.RIGHT):
        true |= {f"{station.name.lower()}.{name}": value for name, value in _errors(real.errors[station]).items()}
    judged = {name: [*estimate, true[name]] for name, estimate in tracker.bias_parameters().items() if name in true}
    return judged | _modal(tracker, real)


def _errors(errors: SensorErrors) -> dict[str, float]:
    scales = {name: float(getattr(errors, scale)[axis]) for name, (scale, axis) in _SCALES.items()}
    return scales | dict(zip(_MISALIGNMENTS, errors.misalignment_rad.tolist(), strict=True))


def _modal(tracker: WingTracker, real: TruthAirframe) -> dict[str, list[float]]:
    """Frequency and damping of the first modes."""
    wing = tracker.describe()
    if wing is None:
        return {}
    judged = {}
    for family, mode in zip(FAMILIES, (wing.symmetric, wing.antisymmetric), strict=True):
        actual = real.actual.wing.modes[family]
        judged[f"frequency.{family}"] = [mode.frequency_hz, mode.frequency_sigma_hz, actual.frequency_hz.value]
        judged[f"damping.{family}"] = [mode.damping, mode.damping_sigma, actual.damping.value]
    return judged


def constants_table(flights: Iterable[dict[str, Any]]) -> tuple[list[str], int]:
    """Lines of the table over all flights, and how many constants are inside 3 sigma too seldom."""
    over: defaultdict[str, list[float]] = defaultdict(list)
    for flown in flights:
        for name, (estimate, sigma, true) in flown.get("constants", {}).items():
            over[_either_tip(name)].append((estimate - true) / sigma)
    lines = [
        f"{'constant at the end of a flight':40s} {'flights':>8s} {'mean':>6s} {'rms':>5s} {'inside 3 sigma':>15s}"
    ]
    failures = 0
    for name, values in over.items():
        error = np.array(values)
        inside = float(np.mean(np.abs(error) <= 3.0))
        failures += inside < _INSIDE_3_SIGMA
        verdict = "" if inside >= _INSIDE_3_SIGMA else "  missed"
        lines.append(
            f"{name:40s} {len(error):8d} {error.mean():6.2f} {np.sqrt(np.mean(error**2)):5.2f}"
            f" {100 * inside:11.1f}%{verdict}"
        )
    return lines, failures


def _either_tip(name: str) -> str:
    """Name without the tip: both tips' errors are drawn alike."""
    place, _, error = name.partition(".")
    return f"tip.{error}" if place in ("left", "right") else name
