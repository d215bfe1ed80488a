"""From files to the models that a diagnosis judges: recordings share one belief, long ones are cut in pieces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from companion.adapters.recordings.tables.mapping import TableMapping
from companion.diagnosis.data.observations import Observations, observe
from companion.diagnosis.model.belief import Belief, believe
from companion.diagnosis.model.flight_model import FlightModel
from companion.evaluation.recorded_evidence import load
from companion.params.airframe import Airframe

_LOAD_VARIES = 0.02  # rms g: below, the flight was level
_TOP = 8.0  # highest frequency modelled, in first modes: the third mode of a beam lies at 17.5, the second at 6.3
_LONGEST_S = 120.0


def models_of(paths: Sequence[Path], airframe: Airframe, mapping: TableMapping | None = None) -> list[FlightModel]:
    """Read recordings and hold them against one belief.

    A recording longer than two minutes is cut into equal pieces that share everything, so that the time a diagnosis
    takes grows with the length and its memory does not.

    Raises
    ------
    RecordingError
        One cannot be read, has no wing accelerometer, or no gap-free stretch that is long enough.
    """
    top_hz = top_of(airframe)
    seen = [observe(load(path, airframe, mapping), airframe, top_hz) for path in paths]
    belief = belief_for(airframe, seen)
    return [FlightModel(belief, piece, top_hz, k) for k, whole in enumerate(seen) for piece in _pieces(whole)]


def top_of(airframe: Airframe) -> float:
    """The highest frequency worth judging, Hz."""
    wing = airframe.wing
    modes = [wing.symmetric, wing.antisymmetric, wing.second_symmetric, wing.second_antisymmetric]
    present = [mode.frequency_hz.value for mode in modes if mode is not None]
    return max(_TOP * present[0], 1.6 * max(present))


def belief_for(airframe: Airframe, seen: Sequence[Observations]) -> Belief:
    """The nuisances that any of the recordings has an opinion about."""
    sides = sorted({side for one in seen for side in one.sides})
    varies = any(float(one.load_factor.std()) > _LOAD_VARIES for one in seen)
    inputs = {name: float(values.std()) for one in seen for name, values in one.inputs.items()}
    with_range, has_root = any(one.toe is not None for one in seen), any(one.has_root for one in seen)
    return believe(airframe, sides, with_range, varies, len(seen), inputs, has_root)


def _pieces(whole: Observations) -> list[Observations]:
    count = math.ceil(whole.duration_s / _LONGEST_S)
    if count < 2:
        return [whole]
    length = whole.duration_s / count
    return [whole.window(k * length, (k + 1) * length) for k in range(count)]
