"""An oscillator with a measured force under the engine: its linear part, and laws of its spring and damper.

    u = m q'' + c q' + k q + sum_j theta_j f_j(q, q')

is linear in everything unknown. It is written in the frequency domain, segment by segment: derivatives and laws are
made of the whole recording in time, then cut, tapered and transformed. Its error is the measured response's times
D + s(t) + j omega z(t), D = k + j omega c - omega^2 m, s and z the slopes of the laws over deflection and speed, and
that of the force, alike at all frequencies: (|D + mean s + j omega mean z|^2 + var s + omega^2 var z + rho^2)^1/2
(after Sanathanan and Koerner), rho by profile likelihood. Deflection counts from the recording's own zero: a cube about
another zero has a square.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.wing.effects.damping.coulomb_friction import CoulombFriction
from companion.core.wing.effects.damping.quadratic_damping import QuadraticDamping
from companion.core.wing.effects.stiffness.cubic_stiffness import CubicStiffness
from companion.core.wing.effects.stiffness.quadratic_stiffness import QuadraticStiffness
from companion.diagnosis.forced.even_recording import EvenRecording, evenly
from companion.diagnosis.selection.diagnosis import Diagnosis, diagnose
from companion.diagnosis.selection.recordings import Progress
from companion.diagnosis.selection.regression import (
    Coefficient,
    RegressionModel,
    RegressionResponse,
    Regressions,
    RegressionTerm,
)
from companion.errors import RecordingError
from companion.records import Floats

FORCE = "force"
_SEGMENTS = 10  # of all recordings together, held out one by one (choice)
_LEAST_BINS = 8  # chosen: bins of the band in a segment, more than the parameters of a mode
_EDGE = 0.02  # of a recording, left out at either end (choice)
_FINER = 4  # times the rate at which laws are made: a cube reaches three times as far as its argument (choice)
_PASSES = 4  # of least squares: the weight depends on the coefficients (choice)
_FORCE_NOISES = (0.0, *np.logspace(-2.0, 2.0, 41).tolist())  # rho tried: over the response's mean, by 1.26 (choice)
_INDEPENDENT = 18.0 / 35.0  # derived: of a Hann taper's bins, (sum t^2)^2 / (m sum t^4) with means 3/8 and 35/128
_SURE = 5.0  # sigmas below 0 from which a coefficient counts as negative (choice)
_WIDE = 10.0  # prior sigma of a coefficient, in rms of the force over that of its column (choice)
LAWS: dict[str, tuple[str, Callable[[Floats, Floats], Floats]]] = {
    CubicStiffness.name: ("per cubed deflection", lambda q, _v: q**3),
    QuadraticStiffness.name: ("per squared deflection", lambda q, _v: q**2),
    QuadraticDamping.name: ("per squared speed", lambda _q, v: np.abs(v) * v),
    CoulombFriction.name: ("against the speed", lambda _q, v: np.sign(v)),
}


def _slopes(q: Floats, v: Floats) -> Floats:
    """Slopes of the laws over deflection and speed (n,), (2, laws, n); of a sign that of the line nearest to it."""
    none, jump = np.zeros_like(q), math.sqrt(2.0 / math.pi) / float(v.std())
    return np.stack([[3.0 * q**2, 2.0 * q, none, none], [none, none, 2.0 * np.abs(v), np.full_like(q, jump)]])


@dataclass(frozen=True, slots=True)
class ForcedRecording:
    """One recording: ``t_s``, ``force`` and ``response`` (n,)."""

    name: str
    t_s: Floats
    force: Floats
    response: Floats


@dataclass(frozen=True, slots=True)
class ForcedDiagnosis:
    """Outcome, with the linear part (mass, damping, stiffness in force per unit of the response) of either model."""

    outcome: Diagnosis[RegressionTerm, RegressionModel]
    recordings: tuple[ForcedRecording, ...]
    scale: Floats
    notes: tuple[str, ...] = ()

    def linear(self, extended: bool) -> Floats:
        """Mass, damping and stiffness, (3,)."""
        fitted = self.outcome.final if extended else self.outcome.null
        return np.array([fitted.value(name)[0] for name in _LINEAR]) / self.scale[:3]

    def negative(self) -> list[str]:
        """Which of mass, damping and stiffness lie below 0 beyond chance."""
        fitted = self.outcome.final
        return [name for name in _LINEAR if fitted.value(name)[0] < -_SURE * fitted.value(name)[1]]


_LINEAR = ("mass", "damping", "stiffness")


def diagnose_forced(
    recordings: Sequence[ForcedRecording], band_hz: tuple[float, float], most: int, progress: Progress
) -> ForcedDiagnosis:
    """Judge recordings of one oscillator.

    Raises
    ------
    RecordingError
        A segment holds too few frequencies of the band, each has a gap, most rows are lost, or force and response have
        opposite signs.
    """
    tables, blocks, omegas, motions = [], [], [], []
    grids = [evenly(entry.name, entry.t_s, entry.force, entry.response) for entry in recordings]
    pieces = max(_SEGMENTS // len(recordings), 2)
    for k, (entry, even) in enumerate(zip(recordings, grids, strict=True)):
        series = _series(even, band_hz)
        motions.append(np.stack([series[3], series[2]]))
        for i, (table, omega) in enumerate(_segments(entry.name, even, series, band_hz, pieces)):
            tables.append(table)
            omegas.append(omega)
            blocks.append(np.full(2 * len(omega), float(k * pieces + i)))
    if not tables:
        raise RecordingError("no segment without a gap: record without losses")
    rows = np.concatenate([np.concatenate([table.real, table.imag], axis=1) for table in tables], axis=1)
    omega = np.concatenate([np.tile(omega, 2) for omega in omegas])
    force, columns = rows[0], rows[1:]
    scale = np.sqrt(np.mean(columns**2, axis=1)) / np.sqrt(np.mean(force**2))
    columns = columns / scale[:, None]
    weight = _weight(force, columns, omega, scale, _slopes(*np.concatenate(motions, axis=1)))
    block = np.concatenate(blocks)
    linear = tuple(
        Coefficient(name, FORCE, column, _WIDE, "", f"rms of its force over the force's, {name}")
        for name, column in zip(_LINEAR, columns, strict=False)
    )
    rms = float(np.sqrt(np.mean(force**2)))
    group = np.zeros(len(force), dtype=np.int64)
    response = RegressionResponse(
        FORCE, force, weight, group, block, omega, 0.0, 1e-3 * rms, 0.1 * rms, linear, independent_ratio=_INDEPENDENT
    )
    terms = [
        RegressionTerm(name, "", (Coefficient(name, FORCE, column, _WIDE, "", f"rms of its force, {unit}"),))
        for (name, (unit, _)), column in zip(LAWS.items(), columns[3:], strict=True)
    ]
    notes = tuple(note for even in grids for note in even.notes)
    diagnosis = ForcedDiagnosis(
        diagnose(Regressions([response], terms), most, progress), tuple(recordings), scale, notes
    )
    if {"mass", "stiffness"} <= set(diagnosis.negative()):
        raise RecordingError(
            "mass and stiffness come out negative: force and response have opposite signs; turn one in the mapping"
        )
    return diagnosis


def _series(even: EvenRecording, band_hz: tuple[float, float]) -> list[Floats]:
    """Force, acceleration, speed, deflection and laws over time, (n,) each."""
    count = len(even.force)
    f_hz = np.fft.rfftfreq(count, 1.0 / even.rate_hz)
    spectrum = np.where(f_hz < min(4.0 * band_hz[1], 0.5 * even.rate_hz), np.fft.rfft(even.response), 0.0)
    turn = 2j * np.pi * f_hz
    deflection, v, a = (np.fft.irfft(spectrum * turn**power, count) for power in (0, 1, 2))
    fine_q, fine_v = (np.fft.irfft(spectrum * turn**power, _FINER * count) * _FINER for power in (0, 1))
    laws = [np.fft.rfft(law(fine_q, fine_v))[: len(f_hz)] / _FINER for _, law in LAWS.values()]
    return [even.force, a, v, deflection, *(np.fft.irfft(law, count) for law in laws)]


def _segments(
    name: str, even: EvenRecording, series: Sequence[Floats], band_hz: tuple[float, float], pieces: int
) -> list[tuple[np.ndarray[tuple[int, ...], np.dtype[np.complex128]], Floats]]:
    """All series (s, f) of each segment without a gap in the band, and omega (f,)."""
    segments, count = [], len(series[0])
    edge = int(_EDGE * count)  # there a transform of what is not periodic rings
    for index in np.array_split(np.arange(edge, count - edge), pieces):
        part_hz = np.fft.rfftfreq(len(index), 1.0 / even.rate_hz)
        inside = (part_hz > band_hz[0]) & (part_hz < band_hz[1])
        if inside.sum() < _LEAST_BINS:
            raise RecordingError(f"{name}: too short: {pieces} segments must hold {_LEAST_BINS} frequencies each")
        if even.lost[index].any():
            continue
        taper = np.hanning(len(index))
        rows = np.stack([np.fft.rfft(taper * values[index])[inside] / np.sqrt(len(index)) for values in series])
        segments.append((rows, np.asarray(2.0 * np.pi * part_hz[inside])))
    return segments


def _weight(force: Floats, columns: Floats, omega: Floats, scale: Floats, slopes: Floats) -> Floats:
    """Relative standard deviation of each row, (n,); ``slopes`` (2, laws, samples) over deflection and over speed."""
    weight = np.ones(len(force))
    for _ in range(_PASSES):
        values = np.linalg.lstsq((columns / weight).T, force / weight, rcond=None)[0]
        m, c, k, *laws = values / scale
        stiff, damp = np.array(laws) @ slopes
        mean = k + stiff.mean() - omega**2 * m + 1j * omega * (c + damp.mean())
        dynamic = np.sqrt(np.abs(mean) ** 2 + stiff.var() + omega**2 * damp.var())
        weight = _beside_noise_of_force(dynamic / float(dynamic.mean()), force - values @ columns)
    return weight


def _beside_noise_of_force(weight: Floats, residual: Floats) -> Floats:
    """The response's weight (n,) and the force's together, in the ratio that makes the residual (n,) most likely."""
    together = [np.hypot(weight, ratio) for ratio in _FORCE_NOISES]
    each = [-0.5 * len(residual) * np.log(np.mean((residual / w) ** 2)) - np.log(w).sum() for w in together]
    best = together[int(np.argmax(each))]
    return np.asarray(best / best.mean())
