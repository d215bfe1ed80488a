"""The boom on a shaker with random noise from 0 to 200 Hz: a simulated test, its averaged spectra, and closed forms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.core.wing.beam import BeamMode
from companion.core.wing.model import WingModel
from companion.paper import printed
from companion.paper.beam_tables import corrected_beam
from companion.params.airframe import Airframe, Gust, Mode, Uncertain, Wing
from companion.records import Floats
from companion.sim.flight.wing import SUBSTEP_S, integrate

WINDOW_S = 8.0
"""Of each average: bins a third as wide as the peak of a mode of 1 % damping (choice)."""

_SHAKER_RMS_MPS2 = 1.0  # convention: the closed forms are linear, any drive gives the same shares
_SEED = 11  # convention: any fixed number
_BURN_IN_S = 5.0  # chosen: many decay times of the boom's first mode


@dataclass(frozen=True, slots=True, eq=False)
class Shaken:
    """The boom under random drive: base and tip acceleration (n,), modal coordinates (n, 2), and what they show."""

    rate_hz: float
    base_mps2: Floats
    tip_mps2: Floats
    q_m: Floats
    modes: tuple[BeamMode, BeamMode]
    damping: float


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Averaged spectra: frequencies, coherence, gain of the tip's over the base's acceleration; all (k,)."""

    frequency_hz: Floats
    coherence: Floats
    gain: Floats
    closed_gain: Floats
    averages: int


def boom_wing(damping: float) -> tuple[Wing, tuple[BeamMode, BeamMode]]:
    """The corrected beam's first two modes as a wing of the simulator."""
    first, second = corrected_beam().modes(2)

    def as_mode(mode: BeamMode) -> Mode:
        return Mode(Uncertain(mode.frequency_hz), Uncertain(damping), Uncertain(mode.slope_at_tip_radpm))

    gust = Gust(Uncertain(0.0))
    zero = Uncertain(0.0)
    wing = Wing(first.length_m, as_mode(first), as_mode(first), gust, zero, zero, second_symmetric=as_mode(second))
    return wing, (first, second)


def shake(airframe: Airframe, seed: int = _SEED) -> Shaken:
    """Drive the base with white noise up to 200 Hz for as long as the averages need."""
    rng = np.random.default_rng(seed)
    damping = airframe.wing.symmetric.damping.value
    wing, modes = boom_wing(damping)
    model = WingModel(wing)
    rate_hz = 1.0 / SUBSTEP_S
    burn = round(_BURN_IN_S * rate_hz)
    count = burn + round((WINDOW_S * (printed.AVERAGES + 1) / 2) * rate_hz)
    base = _band_noise(rng, count, rate_hz)
    load = np.zeros((count, model.count))
    for slot, mode in zip((0, 2), modes, strict=True):
        load[:, model.structure.slots.index(slot)] = -mode.base_participation() * base
    q, qdot = integrate(model, load, np.ones(count))
    columns = [model.structure.slots.index(slot) for slot in (0, 2)]
    felt = np.diff(qdot[:, columns], axis=0) * rate_hz
    noise = airframe.left.accel_noise_mps2_rthz * np.sqrt(rate_hz / 2)
    tip = base + felt.sum(axis=1) + noise * rng.standard_normal(count)
    measured = base + noise * rng.standard_normal(count)
    return Shaken(rate_hz, measured[burn:], tip[burn:], q[1 + burn :, columns], modes, damping)


def _band_noise(rng: np.random.Generator, count: int, rate_hz: float) -> Floats:
    spectrum = np.fft.rfft(rng.standard_normal(count))
    spectrum[np.fft.rfftfreq(count, 1.0 / rate_hz) > printed.NOISE_BAND_HZ] = 0.0
    noise = np.fft.irfft(spectrum, count)
    return np.asarray(_SHAKER_RMS_MPS2 * noise / np.std(noise))


def respond(shaken: Shaken) -> Response:
    """Welch's averages over half-overlapping Hann windows."""
    from scipy.signal import coherence, csd, welch  # 0.8 s to import, so late

    window = round(WINDOW_S * shaken.rate_hz)
    averages = (len(shaken.base_mps2) - window // 2) // (window - window // 2)
    kind: dict[str, Any] = {"fs": shaken.rate_hz, "nperseg": window}
    frequency, cross = csd(shaken.base_mps2, shaken.tip_mps2, **kind)
    _, power = welch(shaken.base_mps2, **kind)
    _, alike = coherence(shaken.base_mps2, shaken.tip_mps2, **kind)
    inside = (frequency > 1.0) & (frequency < printed.NOISE_BAND_HZ - 1.0)
    gain = np.abs(cross[inside]) / power[inside]
    closed = closed_gain(frequency[inside], shaken.modes, shaken.damping)
    return Response(frequency[inside], np.asarray(alike[inside]), np.asarray(gain), closed, averages)


def closed_gain(frequency_hz: Floats, modes: Sequence[BeamMode], damping: float) -> Floats:
    """Closed form of the tip's over the base's acceleration, (k,).

    ``|1 + sum p f^2 / (f_k^2 - f^2 + 2 i zeta f_k f)|``, ``p`` each mode's base participation: how
    strongly a moving clamp drives it.
    """
    total = np.ones(len(frequency_hz), dtype=np.complex128)
    for mode in modes:
        mode_hz = mode.frequency_hz
        total += (
            mode.base_participation()
            * frequency_hz**2
            / (mode_hz**2 - frequency_hz**2 + 2j * damping * mode_hz * frequency_hz)
        )
    return np.asarray(np.abs(total))


def white_share(modes: tuple[BeamMode, BeamMode], *, of_slope: bool) -> float:
    """Closed form of mode 2's variance over mode 1's at the tip, for a drive that is white at all frequencies.

    A mode of participation p driven by white noise has variance proportional to ``p^2 / (zeta f^3)``; damping is equal.
    """
    first, second = modes
    ratio = second.base_participation() / first.base_participation()
    if of_slope:
        ratio *= second.slope_at_tip_radpm / first.slope_at_tip_radpm
    return float(ratio**2 * (first.frequency_hz / second.frequency_hz) ** 3)
