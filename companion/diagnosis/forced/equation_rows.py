"""Rows of the equation of motion: force, derivatives and laws of all segments at the frequencies that count."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.ndimage import uniform_filter1d

from companion.core.wing.effects.damping.coulomb_friction import CoulombFriction
from companion.core.wing.effects.damping.quadratic_damping import QuadraticDamping
from companion.core.wing.effects.stiffness.cubic_stiffness import CubicStiffness
from companion.core.wing.effects.stiffness.quadratic_stiffness import QuadraticStiffness
from companion.diagnosis.forced.even_recording import EvenRecording
from companion.diagnosis.forced.force_delay import real_rows
from companion.diagnosis.forced.response_kind import ResponseKind
from companion.errors import RecordingError
from companion.records import Bools, Complexes, Floats, Ints

_SEGMENTS = 10  # of all recordings together, held out one by one (choice)
_LEAST_BINS = 8  # chosen: bins of the band in a segment, more than the parameters of a mode
_EDGE = 0.02  # of a recording, left out at either end (choice)
FINER = 4  # times the rate at which laws are made: a cube reaches three times as far as its argument (choice)
_LEAST_SPREAD = 1.0  # chosen, bins rms: a tone in a Hann taper has 0.33 to 0.5
_SMOOTHED = 9  # chosen: bins over which a power is averaged to tell what was excited, a tenth of a usual segment
_EXCITED = 0.01  # of the segment's largest power of the force, from which a bin is excited (choice)
_ABOVE_NOISE = 100.0  # chosen, times the response's least power in the band: noise moves such a bin little
_MOST_NOISE = 0.05  # chosen, of an integrated deflection's power: a cube came out 31 % too small at 0.14, 3 % at 0.02
_MIDDLE = 0.3  # chosen, standard deviations of the deflection: a gap that shows is no narrower than a tenth
LAWS: dict[str, tuple[str, Callable[[Floats, Floats], Floats]]] = {
    CubicStiffness.name: ("per cubed deflection", lambda q, _v: q * q * q),
    QuadraticStiffness.name: ("per squared deflection", lambda q, _v: q**2),
    QuadraticDamping.name: ("per squared speed", lambda _q, v: np.abs(v) * v),
    CoulombFriction.name: ("against the speed", lambda _q, v: np.sign(v)),
}
NAMELESS: dict[str, Callable[[Floats, Floats], Floats]] = {
    "a spring with another stiffness about the middle": lambda q, _v: np.tanh(q / (_MIDDLE * q.std())),
    "a spring whose force turns with the deflection's sign": lambda q, _v: np.abs(q) * q,
}
"""Laws that no catalogue has: a gap, a stop or a clamp that slips shows in them as in no polynomial."""
Numbers = TypeVar("Numbers", Floats, Complexes)
_SIGN = list(LAWS).index(CoulombFriction.name)
_NAMED = tuple(law for _, law in LAWS.values())


@dataclass(frozen=True, slots=True)
class ForcedRecording:
    """One recording: ``t_s``, ``force`` and ``response`` (n,), in any unit."""

    name: str
    t_s: Floats
    force: Floats
    response: Floats
    kind: ResponseKind = ResponseKind.DISPLACEMENT


@dataclass(frozen=True, slots=True)
class TaperedSegment:
    """Samples of a recording from ``first`` to before ``stop``, and the ``bins`` (f,) of their transform that count."""

    recording: int
    first: int
    stop: int
    bins: Bools

    def rows(self, series: Sequence[Floats]) -> Complexes:
        """Tapered transforms (s, b) of whole series (n,) in the bins."""
        count = self.stop - self.first
        taper = np.hanning(count) / np.sqrt(count)
        return np.stack([np.fft.rfft(taper * values[self.first : self.stop]) for values in series])[:, self.bins]

    def turned_back(self, weights: Complexes) -> Floats:
        """Factors (stop - first,) of the samples of a series in the real sum of ``weights``^* (b,) times its rows."""
        count = self.stop - self.first
        spectrum = np.zeros(len(self.bins), dtype=np.complex128)
        spectrum[self.bins] = weights
        return np.asarray(np.hanning(count) * np.fft.irfft(spectrum, count) * (0.5 * np.sqrt(count)))


@dataclass(frozen=True, slots=True)
class EquationRows:
    """Bins (n,) of all segments: ``table`` (s, n) is force, m, c and k's columns and the laws', ``block`` the segment.

    They are those of ``band_hz`` of the ``recordings``, put on even ``grids``. ``kind`` is the response's, ``motions``
    (2, samples) are deflection and speed over time, and ``power`` is the deflection's at all frequencies.
    """

    recordings: tuple[ForcedRecording, ...]
    grids: tuple[EvenRecording, ...]
    band_hz: tuple[float, float]
    table: Complexes
    omega: Floats
    kind: Floats
    block: Floats
    motions: Floats
    power: float
    segments: tuple[TaperedSegment, ...]

    def force(self, delay_s: float) -> Floats:
        """Force advanced by a delay, real rows (2 * n,)."""
        return real_rows(self.table[0] * np.exp(1j * self.omega * delay_s))

    def force_per_delay(self, delay_s: float) -> Floats:
        """Change of that force per second by which it came later still, real rows (2 * n,)."""
        return real_rows(-1j * self.omega * self.table[0] * np.exp(1j * self.omega * delay_s))

    def by_segment(self, values: Numbers) -> list[Numbers]:
        """Values (..., n) of the bins, split into those of each segment."""
        return np.split(values, np.cumsum(self._bins)[:-1], axis=-1)

    @property
    def _bins(self) -> list[int]:
        """Number of bins of each segment."""
        return [int(segment.bins.sum()) for segment in self.segments]

    @property
    def recording(self) -> Ints:
        """Number of each bin's recording, (n,)."""
        return np.repeat([segment.recording for segment in self.segments], self._bins)

    @property
    def slopes_by_recording(self) -> tuple[Floats, ...]:
        """Slopes of the laws of each recording over deflection and speed, (2, laws, samples) each."""
        return tuple(np.split(self.slopes, np.cumsum([len(even.force) for even in self.grids])[:-1], axis=2))

    @property
    def slopes(self) -> Floats:
        """Slopes of the laws over deflection and speed, (2, laws, samples); of a sign the nearest line's."""
        q, v = self.motions
        slopes = law_slopes(q, v)
        slopes[1, _SIGN] = math.sqrt(2.0 / math.pi) / float(v.std())
        return slopes


def law_slopes(q: Floats, v: Floats) -> Floats:
    """Slopes of the laws over deflection and speed (n,), (2, laws, n); of a sign 0."""
    none = np.zeros_like(q)
    return np.stack([[3.0 * q**2, 2.0 * q, none, none], [none, none, 2.0 * np.abs(v), none]])


def equation_rows(
    recordings: Sequence[ForcedRecording],
    grids: Sequence[EvenRecording],
    band_hz: tuple[float, float],
    kind: ResponseKind | None = None,
) -> EquationRows:
    """Bins of all recordings; ``kind`` is what every response is taken for, None: what it says."""
    n_segments = max(_SEGMENTS // len(recordings), 2)
    tables, omegas, kinds, blocks, motions, power = [], [], [], [], [], 0.0
    segments: list[TaperedSegment] = []
    for k, (entry, even) in enumerate(zip(recordings, grids, strict=True)):
        taken = entry.kind if kind is None else kind
        series = _series(even, band_hz, taken)
        motions.append(np.stack([series[3], series[2]]))
        for i, segment in enumerate(_segments(entry.name, k, even, series, taken, band_hz, n_segments)):
            omega = 2.0 * np.pi * _frequencies_hz(segment, even.rate_hz)[segment.bins]
            segments.append(segment)
            tables.append(segment.rows(series))
            omegas.append(omega)
            everywhere = replace(segment, bins=np.ones_like(segment.bins))
            power += float(np.sum(np.abs(everywhere.rows(series[3:4])) ** 2))
            kinds.append(np.full(len(omega), float(taken)))
            blocks.append(np.full(len(omega), float(k * n_segments + i)))
    if not tables:
        raise RecordingError("no segment without a gap: record without losses")
    table, omega, kinds_of, block, motion = (
        np.concatenate(each, axis=-1) for each in (tables, omegas, kinds, blocks, motions)
    )
    bins_radps = [float(np.diff(each).min()) for each in omegas if len(each) > 1]  # without force none
    _check_spread(np.abs(table[0]) ** 2, omega, max(bins_radps, default=np.inf))
    shown = (tuple(recordings), tuple(grids), band_hz)
    return EquationRows(*shown, table, omega, kinds_of, block, motion, power, tuple(segments))


def nameless_columns(rows: EquationRows) -> Floats:
    """Real rows (laws, 2 * n) of the laws without a name."""
    laws = tuple(NAMELESS.values())
    series = []
    for entry, even in zip(rows.recordings, rows.grids, strict=True):
        spectrum, jw = _motion_spectrum(even, rows.band_hz, entry.kind)
        series.append(_in_time(_law_spectra(spectrum, jw, len(even.force), laws), len(even.force)))
    return real_rows(np.concatenate([segment.rows(series[segment.recording]) for segment in rows.segments], axis=1))


def refuse_integrated_noise(rows: EquationRows) -> None:
    """Noise of a speed or an acceleration grows towards low frequencies by integration, and laws take it for motion.

    Raises
    ------
    RecordingError
        Much of the deflection lies in bins that do not count.
    """
    noise_ratio = 1.0 - float(np.sum(np.abs(rows.table[3]) ** 2)) / rows.power
    if rows.kind.any() and noise_ratio > _MOST_NOISE:
        raise RecordingError(
            f"{100.0 * noise_ratio:.0f} % of the deflection that was integrated from the response are at frequencies "
            f"of no force, as noise is: let band_hz, {rows.band_hz[0]:g} to {rows.band_hz[1]:g} Hz, begin and end "
            "where the force does"
        )


def beyond_half_rate(rows: EquationRows, linear: Floats, laws: Floats) -> float:
    """Rms of the deflection that laws put beyond half the rate over that of all, the largest of all recordings.

    ``linear`` (3,) are mass, damping and stiffness, ``laws`` (laws,) the coefficients of all laws: a law's force f
    moves the structure by f/(k + j omega c - omega^2 m).
    """
    m, c, k = linear.tolist()
    ratios = []
    for entry, even in zip(rows.recordings, rows.grids, strict=True):
        spectrum, jw = _motion_spectrum(even, rows.band_hz, entry.kind)
        omega = 2.0 * np.pi * np.fft.rfftfreq(FINER * len(even.force), 1.0 / (FINER * even.rate_hz))
        moved = laws @ _law_spectra(spectrum, jw, len(even.force), _NAMED) / (k + 1j * omega * c - omega**2 * m)
        ratios.append(float(np.linalg.norm(moved[omega > np.pi * even.rate_hz]) / np.linalg.norm(spectrum)))
    return max(ratios)


def _motion_spectrum(
    even: EvenRecording, band_hz: tuple[float, float], kind: ResponseKind
) -> tuple[Complexes, Complexes]:
    """Spectrum of the deflection, and j omega, (f,)."""
    integral, jw = integration(even, band_hz, kind)
    return integral * np.fft.rfft(even.response), jw


def integration(even: EvenRecording, band_hz: tuple[float, float], kind: ResponseKind) -> tuple[Complexes, Complexes]:
    """Spectrum of the deflection over that of the response, and j omega, (f,).

    A speed or acceleration is integrated above half of the band's lower edge.
    """
    f_hz = np.fft.rfftfreq(len(even.force), 1.0 / even.rate_hz)
    jw: Complexes = np.asarray(2j * np.pi * f_hz, dtype=np.complex128)
    least_hz = 0.5 * band_hz[0] if kind else 0.0
    measured = (f_hz < min(4.0 * band_hz[1], 0.5 * even.rate_hz)) & (f_hz >= least_hz)
    return np.asarray(measured / np.where(measured & (kind > 0), jw, 1.0) ** kind, dtype=np.complex128), jw


def _law_spectra(
    spectrum: Complexes, jw: Complexes, count: int, laws: Sequence[Callable[[Floats, Floats], Floats]]
) -> Complexes:
    """Spectra of laws at several times the rate, (laws, f)."""
    fine_q, fine_v = (np.fft.irfft(spectrum * jw**power, FINER * count) * FINER for power in (0, 1))
    return np.stack([np.fft.rfft(law(fine_q, fine_v)) / FINER for law in laws])


def _in_time(spectra: Complexes, count: int) -> list[Floats]:
    """Laws at the recording's own rate, (count,) each, by their spectra at several times it."""
    return [np.fft.irfft(law[: count // 2 + 1], count) for law in spectra]


def _series(even: EvenRecording, band_hz: tuple[float, float], kind: ResponseKind) -> list[Floats]:
    """Force, acceleration, speed, deflection and laws over time, (n,) each."""
    count = len(even.force)
    spectrum, jw = _motion_spectrum(even, band_hz, kind)
    deflection, v, a = (np.fft.irfft(spectrum * jw**power, count) for power in (0, 1, 2))
    return [even.force, a, v, deflection, *_in_time(_law_spectra(spectrum, jw, count, _NAMED), count)]


def _segments(
    name: str,
    number: int,
    even: EvenRecording,
    series: Sequence[Floats],
    kind: ResponseKind,
    band_hz: tuple[float, float],
    n_segments: int,
) -> list[TaperedSegment]:
    """Segments of recording ``number`` without a gap, with the excited bins of the band."""
    segments, count = [], len(series[0])
    edge = int(_EDGE * count)  # there a transform of what is not periodic rings
    for index in np.array_split(np.arange(edge, count - edge), n_segments):
        segment = TaperedSegment(
            number, int(index[0]), int(index[-1]) + 1, np.ones(len(index) // 2 + 1, dtype=np.bool_)
        )
        segment_hz = _frequencies_hz(segment, even.rate_hz)
        inside = (segment_hz > band_hz[0]) & (segment_hz < band_hz[1])
        if inside.sum() < _LEAST_BINS:
            raise RecordingError(f"{name}: too short: {n_segments} segments must hold {_LEAST_BINS} frequencies each")
        if even.lost[index].any():
            continue
        force, response = segment.rows([series[0], series[3 - kind]])
        segments.append(replace(segment, bins=inside & (_excited(force, inside) | _above_noise(response, inside))))
    return segments


def _frequencies_hz(segment: TaperedSegment, rate_hz: float) -> Floats:
    return np.asarray(np.fft.rfftfreq(segment.stop - segment.first, 1.0 / rate_hz))


def _check_spread(power: Floats, omega: Floats, bin_radps: float) -> None:
    """Refuse a force of one frequency: of its power (n,) at omega (n,), rad/s, nothing tells a mass from a spring."""
    middle = float(power @ omega / power.sum())
    if float(power @ (omega - middle) ** 2 / power.sum()) < (_LEAST_SPREAD * bin_radps) ** 2:
        raise RecordingError(
            f"the force has one frequency alone, {middle / (2.0 * np.pi):.4g} Hz, at which a mass is not "
            "distinguishable from a spring: drive with noise, a sweep, or one frequency after the other"
        )


def _excited(force: Complexes, inside: Bools) -> Bools:
    """Bins (f,) with force: rows of nothing but the response's noise would draw all coefficients to 0."""
    power = uniform_filter1d(np.abs(force) ** 2, _SMOOTHED)
    return np.asarray(power > _EXCITED * float(power[inside].max()))


def _above_noise(response: Complexes, inside: Bools) -> Bools:
    """Bins (f,) in which the response stands far above its noise: harmonics have no force and tell of laws.

    The response is what was recorded, whose noise is alike at all frequencies, and its noise is its least in the band:
    above, it is cut off.
    """
    power = uniform_filter1d(np.abs(response) ** 2, _SMOOTHED)
    return np.asarray(power > _ABOVE_NOISE * float(power[inside].min()))
