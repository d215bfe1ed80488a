"""Constants of a flight that the tracker estimates, at its end, beside the truth."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

import numpy as np

from companion.core.tracking.tracker import WingTracker
from companion.core.wing.foreshortening import foreshortening_pm
from companion.params.airframe import FAMILIES, Airframe, Wing
from companion.records import Station
from companion.sim.flight.perturb import SensorErrors, TruthAirframe

_INSIDE_3_SIGMA = 0.98
_SCALES = {"kz": ("accel_scale", 2), "ky": ("accel_scale", 1), "kp": ("gyro_scale", 0)}
_MISALIGNMENTS = ("mx", "my", "mz")


def constants(tracker: WingTracker, believed: Airframe, real: TruthAirframe) -> dict[str, list[float]]:
    """Estimate, sigma and truth of every constant that is observable by the tips' samples, by name, SI units."""
    wing, actual = believed.wing, real.actual.wing
    deviations = {f"slope.{name}": (mode.slope_factor_radpm, actual.modes[name].slope_factor_radpm)
                  for name, mode in wing.modes.items()}  # fmt: skip
    deviations |= {
        "trim": (wing.trim_bend_m, actual.trim_bend_m),
        "bend_per_g": (wing.bend_per_g_m, actual.bend_per_g_m),
    }
    true = {name: after.value - before.value for name, (before, after) in deviations.items()}
    true["shortening"] = actual.shortening.value / wing.shortening.value - 1.0
    true["further_shortening"] = _by_second_mode(actual) / _by_second_mode(wing) - 1.0
    for station in (Station.LEFT, Station.RIGHT):
        place = station.name.lower()
        true |= {f"{place}.{name}": value for name, value in _errors(real.errors[station]).items()}
        true[f"{place}.height"] = believed.sensor(station).position_m[2] - real.actual.sensor(station).position_m[2]
    judged = {name: [*estimate, true[name]] for name, estimate in tracker.bias_parameters().items() if name in true}
    return judged | _modal(tracker, real)


def _by_second_mode(wing: Wing) -> float:
    """Way inboard by the product of the first two modes, over that of a cantilever; 1 without a second mode."""
    second = wing.second_symmetric
    slopes = (0.0, wing.semispan_m * second.slope_factor_radpm.value) if second else ()
    return wing.shortening.value * float(
        foreshortening_pm((0, 1), 1.0, slopes)[0, 1] / foreshortening_pm((0, 1), 1.0)[0, 1]
    )


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


def constants_table(flights: Iterable[tuple[str, dict[str, list[float]]]]) -> tuple[list[str], int]:
    """Lines of the table over flights, each its world and constants, and how many are inside 3 sigma too seldom."""
    over: defaultdict[str, list[float]] = defaultdict(list)
    worlds: defaultdict[str, list[str]] = defaultdict(list)
    for world, constants_of_flight in flights:
        for name, (estimate, sigma, true) in constants_of_flight.items():
            over[_either_tip(name)].append((estimate - true) / sigma)
            worlds[_either_tip(name)].append(world)
    columns = sorted({world for of in worlds.values() for world in of})
    head = f"{'constant at the end of a flight, over sigma':44s} {'values':>6s} {'mean':>6s} {'rms':>6s} {'in 3':>7s}"
    lines, failures = [head + "".join(f" {world:>7s}" for world in columns)], 0
    for name, values in over.items():
        error, of = np.array(values), np.array(worlds[name])
        within = np.abs(error) <= 3.0
        missed = bool(within.mean() < _INSIDE_3_SIGMA)
        failures += missed
        shares = "".join(f" {100 * within[of == world].mean():6.1f}%" for world in columns)
        lines.append(
            f"{name:44s} {len(error):6d} {error.mean():6.2f} {np.sqrt(np.mean(error**2)):6.2f}"
            f" {100 * within.mean():6.1f}%{shares}{'  missed' if missed else ''}"
        )
    return lines, failures


def _either_tip(name: str) -> str:
    """Name without the tip: both tips' errors are drawn alike."""
    place, _, error = name.partition(".")
    return f"tip.{error}" if place in ("left", "right") else name
