"""A shot of an experiment, judged by the truth: what every way of ranging reads, how blurred, how near the peak."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from companion.core.stereo.geometry import Rig
from companion.core.stereo.ranging import correct
from companion.evaluation.true_geometry import TrueGeometry, TrueReading
from companion.records import CorrectedRange, Deflection, Floats, MatchSet, Reject, RelativeRotation, Side
from companion.sim.flight.flight import Flight

WAYS = ("rigid", "in_trim", "corrected", "published", "oracle")
"""Ways of ranging: the calibration unmodified; that of level flight; the wing's sensors (the paper's way); with what
the matched features tell as well, as the service publishes it; the true extrinsics."""

Readings = Mapping[str, TrueReading | None]


@dataclass(frozen=True, slots=True)
class Answer:
    """Pipeline's answer to one pair: the range, the wing at both exposures, and what the matches add to it."""

    range: CorrectedRange
    left: Deflection
    right: Deflection
    turned: RelativeRotation | None


@dataclass(frozen=True, slots=True)
class ScoredShot:
    """One shot: what triggered it, what every way reads (None: no reading), and what the wing did.

    ``upper`` is the same from the upper third of the image alone, for pairs that look forward (else empty).
    ``tip_rad`` is the true slope of the left and right tip beyond rest, ``toe_rad`` their sum; ``blur_px`` is what
    bending alone smears in the worse camera; ``phase_deg`` is 0 where that camera's slope turns and 90 where it is
    fastest; ``reject`` is why the range was not trusted. ``sigma_m`` is one sigma of the ranges that state one: by the
    wing's sensors (``corrected``) and as published.
    """

    planned: bool
    all_features: Readings
    upper: Readings
    reject: Reject | None
    tip_rad: tuple[float, float]
    blur_px: float
    phase_deg: float
    sigma_m: Mapping[str, float]

    @property
    def toe_rad(self) -> float:
        """Relative toe beyond rest."""
        return sum(self.tip_rad)


@dataclass(frozen=True, slots=True)
class Flown:
    """Scored shots, and how many were left out and why.

    ``warm_up`` were fired before shots count, so that the trigger's latency is learned; ``refused`` gave no range at
    all, by reason.
    """

    shots: tuple[ScoredShot, ...]
    warm_up: int
    refused: Mapping[str, int]


@dataclass(frozen=True, slots=True, eq=False)
class SlopeSpread:
    """Spread of each tip's slope and slope rate over the flight, and the slope at rest; all (2,)."""

    slope_rad: Floats
    rate_radps: Floats
    rest_rad: Floats

    @classmethod
    def of(cls, flight: Flight) -> SlopeSpread:
        """From every tenth knot of the truth."""
        series = flight.truth.series(flight.truth.t_boot_ns[::10])
        rest = flight.model.tip_slope_rad(flight.model.q_static(1.0))
        return cls(series.slope_rad.std(axis=0), series.slope_rate_radps.std(axis=0), np.asarray(rest))

    def phase_deg(self, side: int, slope_rad: float, rate_radps: float) -> float:
        """From the nearest peak of that tip, 0 to 90, for its slope beyond rest and its slope rate.

        Both are taken in units of their spread: for a sine that is the phase, for a narrow-band wing nearly so.
        """
        speed, place = abs(rate_radps) / self.rate_radps[side], abs(slope_rad) / self.slope_rad[side]
        return float(np.degrees(np.arctan2(speed, place)))


def score(geometry: TrueGeometry, spread: SlopeSpread, matches: MatchSet, answer: Answer, planned: bool) -> ScoredShot:
    """Judge one shot by the truth."""
    flight, lens = geometry.flight, geometry.pair.rig.left.lens
    samples = [flight.truth.at(int(t_ns) - geometry.start_host_ns) for t_ns in matches.mid_exposure_ns]
    slope = np.array([samples[side].slope_rad[side] for side in Side]) - spread.rest_rad
    rate = np.abs([samples[side].slope_rate_radps[side] for side in Side])
    worse = int(np.argmax(rate))
    upper = _upper_third(matches, lens.size_px[1])
    return ScoredShot(
        planned=planned,
        all_features=_readings(geometry, matches, answer),
        upper=_readings(geometry, upper, answer) if flight.airframe.looks_forward else {},
        reject=answer.range.reject,
        tip_rad=(float(slope[0]), float(slope[1])),
        blur_px=lens.focal_px * matches.exposure_ns * 1e-9 * float(rate[worse]),
        phase_deg=spread.phase_deg(worse, float(slope[worse]), float(rate[worse])),
        sigma_m={"corrected": _sensors_sigma_m(geometry, matches, answer), "published": answer.range.sigma_m},
    )


def _sensors_sigma_m(geometry: TrueGeometry, matches: MatchSet, answer: Answer) -> float:
    """One sigma, in metres, of the range by the wing's sensors alone."""
    airframe = geometry.flight.airframe
    rig = Rig.from_airframe(airframe)
    return correct(matches, answer.left, answer.right, rig, airframe, geometry.settings).range.sigma_m


def _readings(geometry: TrueGeometry, matches: MatchSet, answer: Answer) -> dict[str, TrueReading | None]:
    return {
        "rigid": geometry.rigid(matches),
        "in_trim": geometry.rigid_in_trim(matches),
        "corrected": geometry.corrected(matches, answer.left, answer.right),
        "published": geometry.corrected(matches, answer.left, answer.right, answer.turned),
        "oracle": geometry.oracle(matches),
    }


def _upper_third(matches: MatchSet, rows: int) -> MatchSet:
    """The matches that lie in the upper third of the left image."""
    inside = matches.left_px[:, 1] < rows / 3
    return dataclasses.replace(
        matches, left_px=matches.left_px[inside], right_px=matches.right_px[inside], sigma_px=matches.sigma_px[inside]
    )
