"""From files to the models that a diagnosis judges: recordings share one belief, long ones are cut in pieces."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

from companion.adapters.recordings.tables.mapping import TableMapping
from companion.diagnosis.data.observations import Observations
from companion.diagnosis.data.recoil import recoil_delay
from companion.diagnosis.data.resampling import in_common_units, observe
from companion.diagnosis.model.belief import Belief, believe
from companion.diagnosis.model.flight_model import FlightModel
from companion.evaluation.recorded_evidence import load
from companion.params.airframe import Airframe
from companion.units import GRAVITY_MPS2

_LOAD_VARIES = 0.02  # rms g: below, the flight was level (choice)
# highest frequency modelled, in first modes: the third mode of a beam lies at 17.5, the second at 6.3 (choice)
_TOP = 8.0
_LONGEST_S = 120.0  # chosen: airspeed and warmth change little in two minutes, and a model fits in memory


def models_of(paths: Sequence[Path], airframe: Airframe, mapping: TableMapping | None = None) -> list[FlightModel]:
    """Read recordings and hold them against one belief.

    A recording longer than two minutes is cut into equal segments that share everything, so that the time a diagnosis
    takes grows with the length and its memory does not.

    Raises
    ------
    RecordingError
        One cannot be read, has no wing accelerometer, or less than 8 s in all can be used.
    """
    top_hz = top_of(airframe)
    recorded = in_common_units([observe(load(path, airframe, mapping), airframe, top_hz) for path in paths], airframe)
    belief = belief_for(airframe, recorded)
    return [
        FlightModel(belief, short, top_hz, k)
        for k, segments in enumerate(recorded)
        for segment in segments
        for short in _short_segments(segment, airframe)
    ]


def top_of(airframe: Airframe) -> float:
    """The highest frequency worth judging, Hz."""
    present = [mode.frequency_hz.value for mode in airframe.wing.modes.values()]
    return max(_TOP * present[0], 1.6 * max(present))


def belief_for(airframe: Airframe, recorded: Sequence[Sequence[Observations]]) -> Belief:
    """The nuisances that any of the recordings, given by their segments, has an opinion about."""
    segments = [segment for recording in recorded for segment in recording]
    sides = sorted({side for segment in segments for side in segment.sides})
    varies = any(float(segment.load_factor.std()) > _LOAD_VARIES for segment in segments)
    inputs = {name: float(values.std()) for segment in segments for name, values in segment.inputs.items()}
    with_range = any(segment.toe is not None for segment in segments)
    has_root = any(segment.has_root for segment in segments)
    return believe(airframe, sides, with_range, varies, len(recorded), inputs, has_root)


def _short_segments(recording: Observations, airframe: Airframe) -> list[Observations]:
    count = math.ceil(recording.duration_s / _LONGEST_S)
    if count < 2:
        return [recording]
    length = recording.duration_s / count
    windows = [recording.window(k * length, (k + 1) * length) for k in range(count)]
    return [_with_recoil(window, airframe) for window in windows] if recording.recoil else windows


def _with_recoil(window: Observations, airframe: Airframe) -> Observations:
    """A window with the delay of the tips in its own time, for a clock may drift."""
    root = -GRAVITY_MPS2 * window.load_factor
    recoil = recoil_delay(root[:, None] - window.up_mps2, root, window.rate_hz, airframe)
    return dataclasses.replace(window, recoil=recoil)
