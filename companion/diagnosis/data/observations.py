"""One recording on one uniform grid: tip accelerations, load factor, covariates, toe.

Diagnosis sees nothing else of a recording; :mod:`.resampling` makes it of raw streams.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from companion.core.wing.samples import SampleDefect
from companion.diagnosis.data.grid import FADES_S, faded_share, fast_length
from companion.diagnosis.data.recoil import RecoilDelay
from companion.records import Bools, Floats, Ints, Side

_FEWEST_EXPOSURES = 5  # chosen: fewer exposures of a part are not used


@dataclass(frozen=True, slots=True)
class RawStream:
    """One station's samples as recorded: ``t_s`` (n,) as stamped, specific force (n,) in its own FRD axes.

    ``force_y_mps2`` is a tip's lateral axis where it was recorded. It shows how far the wing turns the vertical one.
    """

    t_s: Floats
    force_z_mps2: Floats
    force_y_mps2: Floats | None = None


@dataclass(frozen=True, slots=True)
class RawRanges:
    """Ranges as computed with the rigid extrinsics, and the true distances where they are known."""

    t_s: Floats
    range_m: Floats
    reference_m: Floats | None = None

    def taken(self, rows: Ints) -> RawRanges:
        """Rows of these numbers (k,), in this order."""
        reference_m = None if self.reference_m is None else self.reference_m[rows]
        return RawRanges(self.t_s[rows], self.range_m[rows], reference_m)


@dataclass(frozen=True, slots=True)
class RawRecording:
    """The channels of one recording as they came, before any grid.

    ``rigid`` has the root's further axes by letter: x, y in m/s^2, p, q, r in rad/s. Nothing is taken off the tips yet.
    """

    tips: Mapping[Side, RawStream]
    root: RawStream | None = None
    ranges: RawRanges | None = None
    covariates: Mapping[str, tuple[Floats, Floats]] = field(default_factory=dict)
    rigid: Mapping[str, tuple[Floats, Floats]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ToeData:
    """Toe as the pair measured it: y = B (1/Z_rigid - 1/Z_reference), one entry per exposure.

    Attributes
    ----------
    t_s : (k,)
        Mid-exposure, on the same time as the grid.
    toe_rad : (k,)
    inverse_m : (k,)
        1 / reference distance.
    has_reference : bool
        False where the distance had to be taken from the slow part of the ranges themselves.
    """

    t_s: Floats
    toe_rad: Floats
    inverse_m: Floats
    has_reference: bool

    def within(self, start_s: float, stop_s: float) -> ToeData | None:
        """The exposures between two times, clear of both; None where there are hardly any."""
        return self.taken(clear_of_ends(self.t_s, start_s, stop_s))

    def taken(self, inside: Bools) -> ToeData | None:
        """Some of the exposures (k,); None where there are hardly any."""
        if inside.sum() < _FEWEST_EXPOSURES:
            return None
        return ToeData(self.t_s[inside], self.toe_rad[inside], self.inverse_m[inside], self.has_reference)


@dataclass(frozen=True, slots=True)
class Observations:
    """One recording on one uniform grid.

    Attributes
    ----------
    rate_hz : float
    sides : tuple of Side
        Which tips have an accelerometer, in the order of the columns.
    up_mps2 : (m, c)
        Upward acceleration of each tip against the rigid aircraft (or its own mean without a root), mean removed.
    mean_force_mps2 : (c,)
        Mean of the vertical specific force plus gravity times the mean load factor: what a biased sensor shows.
    has_root : bool
    load_factor : (m,)
        1 everywhere without a root sensor.
    bending_factor : (m,) or None
        Slow part of ``load_factor``, which bends the wing from outside (:func:`.rigid_motion.bending_load`); None where
        that is all of it.
    covariates : dict of str to (m,)
        About their means, in units of their rms over all recordings that are judged together; ``units`` has both.
    toe : ToeData or None
    rigid : dict of str to (m,)
        The root's further axes by letter (x, y, p, q, r), where they were recorded, as far as they bend the wing.
    fine_mps2 : (M, c) or None
        ``up_mps2`` at the sensors' own rate ``fine_hz``, over the same time: what is nonlinear bends the whole band.
    turning_mps2 : (m, c) or None
        What the aircraft's turning adds to the vertical specific force of each tip; it is out of ``up_mps2``.
    inputs : dict of str to (m,)
        Measured forces (input_n) and base accelerations (input_mps2), their means removed.
    sample_defects : tuple of SampleDefect
        What the tips' samples themselves show; cut peaks have been restored.
    used_ratio : float
        Share of its recording that this part is: what is known of the whole (its mean) counts here with this weight.
    recorded_ratio : float
        Share of ``up_mps2`` that was recorded; the rest lay in gaps and was drawn.
    notes : tuple of str
    start_s : float
        Where this part begins in its recording.
    recoil : RecoilDelay or None
        Delay of the tips' readings by the fuselage's recoil, over the whole grid.
    """

    rate_hz: float
    sides: tuple[Side, ...]
    up_mps2: Floats
    mean_force_mps2: Floats
    has_root: bool
    load_factor: Floats
    covariates: dict[str, Floats]
    toe: ToeData | None
    rigid: dict[str, Floats] = field(default_factory=dict)
    turning_mps2: Floats | None = None
    inputs: dict[str, Floats] = field(default_factory=dict)
    fine_mps2: Floats | None = None
    fine_hz: float = 0.0
    sample_defects: tuple[SampleDefect, ...] = ()
    used_ratio: float = 1.0
    recorded_ratio: float = 1.0
    notes: tuple[str, ...] = ()
    start_s: float = 0.0
    units: dict[str, tuple[float, float]] = field(default_factory=dict)
    bending_factor: Floats | None = None
    recoil: RecoilDelay | None = None

    @property
    def wing_load_factor(self) -> Floats:
        """Load factor that drives the wing, (m,)."""
        return self.load_factor if self.bending_factor is None else self.bending_factor

    @property
    def roll_is_missing(self) -> bool:
        """Whether an aircraft's root was recorded, but not the roll that its tips feel against each other."""
        return self.has_root and len(self.sides) > 1 and "p" not in self.rigid

    @property
    def duration_s(self) -> float:
        """Length of the grid."""
        return len(self.up_mps2) / self.rate_hz

    @property
    def t_s(self) -> Floats:
        """Times of the grid, (m,), from the start of the recording of which this may be a part."""
        return self.start_s + np.arange(len(self.up_mps2)) / self.rate_hz

    def window(self, start_s: float, stop_s: float) -> Observations:
        """The part between two times as a recording of its own, its mean removed anew."""
        first, last = round(start_s * self.rate_hz), round(stop_s * self.rate_hz)
        last = first + fast_length(min(last, len(self.up_mps2)) - first, up=False)
        up = self.up_mps2[first:last]
        begin_s = self.start_s + first / self.rate_hz
        toe = self.toe and self.toe.within(begin_s, begin_s + (last - first) / self.rate_hz)
        return dataclasses.replace(
            self,
            up_mps2=up - up.mean(0),
            recoil=None,
            load_factor=self.load_factor[first:last],
            bending_factor=None if self.bending_factor is None else self.bending_factor[first:last],
            covariates={name: values[first:last] for name, values in self.covariates.items()},
            rigid={name: values[first:last] for name, values in self.rigid.items()},
            turning_mps2=None if self.turning_mps2 is None else self.turning_mps2[first:last],
            inputs={name: values[first:last] for name, values in self.inputs.items()},
            fine_mps2=self._fine(first, last),
            used_ratio=self.used_ratio * (last - first) / len(self.up_mps2),
            toe=toe,
            start_s=self.start_s + first / self.rate_hz,
        )

    def _fine(self, first: int, last: int) -> Floats | None:
        if self.fine_mps2 is None:
            return None
        ratio = self.fine_hz / self.rate_hz
        segment = self.fine_mps2[round(first * ratio) : round(last * ratio)]
        return np.asarray(segment - segment.mean(0))


def clear_of_ends(t_s: Floats, start_s: float, stop_s: float) -> Bools:
    """Which instants (m,) are far enough from the ends, where the smoothed wing is not known.

    In a short piece the ends fade sooner, but the smoother has no more to go by there.
    """
    margin_s = max(FADES_S, faded_share(stop_s - start_s) * (stop_s - start_s))
    return np.asarray((t_s > start_s + margin_s) & (t_s < stop_s - margin_s))
