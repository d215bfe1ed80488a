"""Modes of a wing from several runs of a vibration test: matched across runs, with shapes, scatter and assurance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.calibration.poles import Pole, stable_poles
from companion.records import Complexes, Floats, Ints

_LINK = 0.017  # relative gap between runs within one mode: roving accelerometers shift it as they travel (choice)
_LEAST_RUNS = 0.5  # of the runs: what fewer show is no mode of the wing (choice)
# lines within the half-power bandwidth: with fewer, damping and residue are those of the record (choice)
_RESOLVED = 4.0


@dataclass(frozen=True, slots=True)
class FrequencyResponse:
    """One run: responses of a few points to the measured force.

    Attributes
    ----------
    name : str
    points : (m,) int64
        Numbers of the measured points of the structure.
    frequency_hz : (k,) float64
    response : (m, k) complex128
        Acceleration over force, m/s^2/N.
    """

    name: str
    points: Ints
    frequency_hz: Floats
    response: Complexes

    def lines(self, first: int, step: int) -> FrequencyResponse:
        """Every ``step``-th line from the ``first``: halves without a common sample of noise."""
        chosen = slice(first, None, step)
        return FrequencyResponse(self.name, self.points, self.frequency_hz[chosen], self.response[:, chosen])


@dataclass(frozen=True, slots=True)
class IdentifiedMode:
    """A mode of the structure.

    Attributes
    ----------
    frequency_hz, damping : float
        Mean over the runs; ``*_sigma`` is the standard deviation of one run, that of the mean is smaller by the root of
        the number of runs. NaN where a single run shows the mode.
    shape : (points,) float64
        Real displacement shape, largest entry 1, NaN where no run measured.
    shape_sigma : (points,) float64
        From the two halves of the lines, each with poles of its own.
    assurance : float
        Modal assurance criterion between the shapes of the two halves.
    phase_scatter_rad : float
        How far the points are from moving in phase, weighted by the shape: 0 for a real mode.
    runs : int
        In how many runs it was found.
    bandwidth_lines : float
        Half-power bandwidth ``2 zeta f`` in lines of the spectrum.
    per_run : (runs, 3) float64
        Index of the run, frequency in Hz and damping ratio in it.
    halves : (2, points) complex128
        Shapes from the even and the odd lines.
    """

    frequency_hz: float
    frequency_sigma_hz: float
    damping: float
    damping_sigma: float
    shape: Floats
    shape_sigma: Floats
    assurance: float
    phase_scatter_rad: float
    runs: int
    bandwidth_lines: float
    per_run: Floats
    halves: Complexes

    @property
    def resolved(self) -> bool:
        """Whether the record is long enough to tell the mode's width from its own.

        Cords of a soft suspension, hum and harmonics of a resonance make narrower lines; a wing's damping does not.
        """
        return self.bandwidth_lines >= _RESOLVED


def identify_runs(runs: list[FrequencyResponse], points: int) -> list[IdentifiedMode]:
    """Modes that at least half of the runs show, by frequency.

    All runs have the same drive point; ``points`` is the number of points of the structure.
    """
    poles_per_run = [stable_poles(run.frequency_hz, run.response) for run in runs]
    groups = _grouped(poles_per_run, len(runs))
    per_run = [_completed(poles, groups, index) for index, poles in enumerate(poles_per_run)]
    all_lines = [residues(run.frequency_hz, run.response, poles) for run, poles in zip(runs, per_run, strict=True)]
    even, odd = (
        [_of_half(run.lines(first, 2), poles) for run, poles in zip(runs, per_run, strict=True)] for first in (0, 1)
    )
    order = range(len(groups))
    spacing_hz = float(np.median([np.median(np.diff(run.frequency_hz)) for run in runs]))
    shapes = [[_shape(runs, lines, k, points) for lines in (all_lines, even, odd)] for k in order]
    return [_describe(groups[k], spacing_hz, *shapes[k]) for k in order]


def assurance(first: Floats | Complexes, second: Floats | Complexes) -> float:
    """Modal assurance criterion ``|a^H b|^2 / (a^H a b^H b)`` over the points (n,) that both have.

    Allemang, Brown, IMAC 1 (1982); points that are not finite are left out.
    """
    both = np.isfinite(first) & np.isfinite(second)
    a, b = first[both], second[both]
    return float(np.abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a).real * np.vdot(b, b).real))


def residues(frequency_hz: Floats, response: Complexes, poles: list[Pole]) -> Complexes:
    """Acceleration residues (outputs, poles) of a sum of modes, with terms for what lies below and above the band.

    ``H(omega) = sum_k -omega^2 [r_k / (j omega - p_k) + conj(...)] + lower + upper omega^2``; for a real mode of unit
    force ``r = -j phi phi_drive / (2 m omega_d)``. Least squares frequency domain, linear in ``r``.
    """
    omega = 2.0 * np.pi * frequency_hz
    columns = []
    for pole in poles:
        direct = 1.0 / (1j * omega - pole.value)
        mirrored = 1.0 / (1j * omega - np.conj(pole.value))
        columns += [-(omega**2) * (direct + mirrored), -(omega**2) * 1j * (direct - mirrored)]
    scale = omega[-1]
    columns += [np.ones_like(omega) + 0j, (omega / scale) ** 2 + 0j]
    design = np.stack(columns, axis=1)
    stacked = np.concatenate([design.real, design.imag])
    wanted = np.concatenate([response.real, response.imag], axis=1).T
    norms = np.linalg.norm(stacked, axis=0)
    fitted, *_ = np.linalg.lstsq(stacked / norms, wanted, rcond=None)
    pairs = (fitted / norms[:, np.newaxis])[: 2 * len(poles)].reshape(len(poles), 2, len(response))
    answer: Complexes = (pairs[:, 0] + 1j * pairs[:, 1]).T
    return answer


_PoleChain = list[tuple[int, Pole]]


def _grouped(poles_per_run: list[list[Pole]], runs: int) -> list[_PoleChain]:
    """Poles of the same mode, one per run; modes that too few runs show are left out."""
    every = sorted(
        ((run, pole) for run, poles in enumerate(poles_per_run) for pole in poles), key=lambda e: e[1].frequency_hz
    )
    chains: list[_PoleChain] = []
    for entry in every:
        near = chains and entry[1].frequency_hz < (1.0 + _LINK) * chains[-1][-1][1].frequency_hz
        if near:
            chains[-1].append(entry)
        else:
            chains.append([entry])
    modes = [_best_per_run(chain) for chain in chains]
    return [mode for mode in modes if len(mode) >= _LEAST_RUNS * runs]


def _best_per_run(chain: _PoleChain) -> _PoleChain:
    best: dict[int, Pole] = {}
    for run, pole in chain:
        if run not in best or pole.order_fraction > best[run].order_fraction:
            best[run] = pole
    return sorted(best.items())


def _completed(poles: list[Pole], groups: list[_PoleChain], run: int) -> list[Pole]:
    """The poles of a run: one for every mode first (that of the others where it has none), then its own extra ones."""
    chosen = []
    for group in groups:
        run_poles = [pole for index, pole in group if index == run]
        chosen.append(run_poles[0] if run_poles else _middle(group))
    taken = {(pole.frequency_hz, pole.damping) for pole in chosen}
    clear = [p for p in poles if all(abs(p.frequency_hz - f) > 0.004 * f for f, _ in taken)]
    return chosen + clear


def _middle(group: _PoleChain) -> Pole:
    frequency, damping = (
        float(np.median([getattr(p, name) for _, p in group])) for name in ("frequency_hz", "damping")
    )
    return Pole(frequency, damping, 0.0)


def _of_half(half: FrequencyResponse, poles: list[Pole]) -> Complexes:
    """Residues of one half of the lines, by the poles that this half shows itself, where it shows them."""
    half_poles = stable_poles(half.frequency_hz, half.response)
    return residues(half.frequency_hz, half.response, [_nearest(half_poles, pole) for pole in poles])


def _nearest(half_poles: list[Pole], wanted: Pole) -> Pole:
    best = min(half_poles, key=lambda pole: abs(pole.frequency_hz - wanted.frequency_hz), default=wanted)
    return best if abs(best.frequency_hz - wanted.frequency_hz) < 0.5 * _LINK * wanted.frequency_hz else wanted


def _shape(runs: list[FrequencyResponse], residues_per_run: list[Complexes], mode: int, points: int) -> Complexes:
    """Residues of one mode at all points (mean where runs overlap); NaN where no run measured."""
    total, count = np.zeros(points, dtype=np.complex128), np.zeros(points)
    for run, run_residues in zip(runs, residues_per_run, strict=True):
        total[run.points] += run_residues[:, mode]
        count[run.points] += 1
    mean = total / np.where(count > 0, count, 1.0)
    shape: Complexes = np.where(count > 0, mean, np.nan)
    return shape


def _describe(
    group: _PoleChain, spacing_hz: float, all_lines: Complexes, even: Complexes, odd: Complexes
) -> IdentifiedMode:
    frequencies = np.array([pole.frequency_hz for _, pole in group])
    dampings = np.array([pole.damping for _, pole in group])
    measured = np.isfinite(all_lines)
    # the common phase that makes the shape as real as it gets
    turn = np.exp(-0.5j * np.angle(np.sum(all_lines[measured] ** 2)))
    real = np.real(all_lines * turn)
    largest = int(np.nanargmax(np.abs(real)))
    scale = turn / real[largest]
    difference = np.real((even - odd) * scale)
    weight = np.abs(real[measured]) ** 2
    off = np.arctan2(np.imag(all_lines * turn)[measured], np.abs(real[measured]))
    return IdentifiedMode(
        frequency_hz=float(frequencies.mean()),
        frequency_sigma_hz=float(frequencies.std(ddof=1)) if len(group) > 1 else float("nan"),
        damping=float(dampings.mean()),
        damping_sigma=float(dampings.std(ddof=1)) if len(group) > 1 else float("nan"),
        shape=np.real(all_lines * scale),
        # each half has twice the variance of the whole, their difference four times
        shape_sigma=np.abs(difference) / 2.0,
        assurance=assurance(even, odd),
        phase_scatter_rad=float(np.sqrt(np.sum(weight * off**2) / np.sum(weight))),
        runs=len(group),
        bandwidth_lines=float(2.0 * dampings.mean() * frequencies.mean() / spacing_hz),
        per_run=np.column_stack([[run for run, _ in group], frequencies, dampings]).astype(np.float64),
        halves=np.stack([even * scale, odd * scale]),
    )
