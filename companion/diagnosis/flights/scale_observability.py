"""Whether a recording's distances separate a wrong baseline or focal length from a wrong toe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.records import Floats

_PRECISE = 0.02  # of the baseline, one sigma: beyond, an error of 6 % passes for chance (choice)


def scale_sigma(models: Sequence[FlightModel], expectations: Sequence[Expectation]) -> float:
    """Relative sigma of the baseline by ranges, with a toe without prior; infinite where it is not observable.

    The toe y = toe_0 + e / Z has the information J = [1, 1/Z]^T C^-1 [1, 1/Z]: at one distance the columns are one,
    and an error e of the baseline is as good as a toe of e / Z.
    """
    information, baseline_m = np.zeros((2, 2)), 0.0
    for model, expectation in zip(models, expectations, strict=True):
        toe = model.observations.toe
        if toe is not None and toe.has_reference:
            baseline_m = model.baseline_m
            columns = np.stack([np.full(len(toe.t_s), 1.0), baseline_m * toe.inverse_m], 1)
            information += columns.T @ expectation.toe_errors.precision @ columns
    left = _beside_the_first(information)
    return float(1.0 / np.sqrt(left)) if left > 0.0 else float("inf")


def scale_note(models: Sequence[FlightModel], expectations: Sequence[Expectation]) -> list[str]:
    """Advice where the distances of all recordings observe neither baseline nor focal length; else empty."""
    measured = [model.observations.toe for model in models]
    inverse_m = [toe.inverse_m for toe in measured if toe is not None and toe.has_reference]
    if not inverse_m:
        return []
    sigma = scale_sigma(models, expectations)
    if sigma < _PRECISE:
        return []
    all_m = 1.0 / np.maximum(np.concatenate(inverse_m), 1e-9)
    how_well = f"to {100.0 * sigma:.0f} % only" if sigma < 1.0 else "not at all"
    return [
        f"ranges at {all_m.min():.3g} to {all_m.max():.3g} m tell the baseline and the focal length {how_well}: at one "
        "distance an error of either looks like one of the toe; record level flight at two known distances, one half "
        "of the other or less, half a minute at each"
    ]


def _beside_the_first(information: Floats) -> float:
    """Information (2, 2) on the second of two with the first projected out; rounding is none."""
    level, mixed, slope = information[0, 0], information[0, 1], information[1, 1]
    left = slope - mixed**2 / level if level > 0.0 else 0.0
    return float(left) if left > 1e-9 * slope else 0.0
