"""The two hands that fly blind trials: who hides and records, and the airframe file that the diagnosis believes in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from companion.evaluation.flight_models import top_of
from companion.params.airframe import Airframe
from companion.params.files import parse_airframe
from tools.trial_truths import belief, cases, strengths
from tools.trial_truths.stranger import airframe as stranger_airframe
from tools.trial_truths.stranger import cases as stranger_cases

_TOP_HZ = 51.2
Flights = list[cases.Tables]


@dataclass(frozen=True)
class Generator:
    """One truth.

    ``names`` are what it hides of the catalogue, ``outside`` what no catalogue has, ``corners_hz`` its believed gusts;
    ``airspeed_rms_mps`` is what its airspeed wanders, ``units`` what one unit of a magnitude that it hides is in the
    catalogue's parameter, where it is another.
    """

    name: str
    names: tuple[str, ...]
    outside: tuple[str, ...]
    corners_hz: tuple[float, ...]
    hide: Callable[[list[str], tuple[float, float], np.random.Generator, float], cases.Hidden]
    fly: Callable[[Sequence[cases.Hidden], Sequence[float], int, float, Sequence[float]], Flights]
    airframe: Callable[[float, float], Airframe]
    airspeed_rms_mps: float
    top_hz: float
    units: Mapping[str, float] = field(default_factory=dict)


def _first_airframe(snr_db: float, corner_hz: float) -> Airframe:
    return parse_airframe(belief.airframe_text(cases.noise_density(snr_db), corner_hz), "trial")


def _stranger_airframe(_snr_db: float, corner_hz: float) -> Airframe:
    return parse_airframe(stranger_airframe.airframe_text(corner_hz), "stranger")


FIRST = Generator(
    "first",
    (*strengths.SIGMA, *strengths.IN_SAMPLES),
    (),
    (0.0, 0.0, 12.0, 30.0),
    cases.hide,
    lambda labels, snr, seed, duration_s, corners: cases.fly(list(labels), snr, seed, duration_s, corners),
    _first_airframe,
    cases.AIRSPEED_RMS_MPS,
    _TOP_HZ,
)
STRANGER = Generator(
    "stranger",
    (*stranger_cases.SIGMA, *strengths.IN_SAMPLES),
    tuple(stranger_cases.OUTSIDE),
    stranger_cases.CORNERS_HZ,
    stranger_cases.hide,
    stranger_cases.fly_all,
    _stranger_airframe,
    stranger_cases.AIRSPEED_RMS_MPS,
    top_of(_stranger_airframe(0.0, 0.0)),
    stranger_cases.UNITS,
)
GENERATORS = {entry.name: entry for entry in (FIRST, STRANGER)}
