"""Fig. 4 and Figs. 11, 12: the boom's first mode, and the boom on a shaker with random noise from 0 to 200 Hz."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.cli.audit import printed
from companion.cli.audit.beam_tables import corrected_beam
from companion.cli.audit.drawing import BLUE, GREY, RED, draw
from companion.cli.audit.findings import Picture, Section, Table, number, percent
from companion.core.wing.beam import BeamMode
from companion.core.wing.model import WingModel
from companion.params.airframe import Airframe, Gust, Mode, Uncertain, Wing
from companion.params.files import load_airframe
from companion.records import Floats
from companion.sim.wing import SUBSTEP_S, integrate

_WINDOW_S = 4.0  # long enough for a mode of 1 % damping
_SHAKER_RMS_MPS2 = 1.0
_SEED = 11
_BURN_IN_S = 5.0
_SHOWN_S = 2.0


def fig_4() -> Section:
    """First mode shape and slope of the boom."""
    beam = corrected_beam()
    mode = beam.modes(1)[0]
    station = np.linspace(0.0, beam.length_m, 201)
    factor = mode.slope_at_tip_radpm
    # a massless beam with a force at its tip: Y = (3 xi^2 - xi^3) / 2, of tip slope 1.5 / l
    cubic = 1.5 * (station / beam.length_m) ** 2 - 0.5 * (station / beam.length_m) ** 3
    gap = float(np.max(np.abs(mode.shape(station) - cubic)))
    data: dict[str, Any] = {
        "slope_at_tip_radpm": factor,
        "slope_at_tip_times_length": factor * beam.length_m,
        "largest_gap_to_static_cubic": gap,
        "station_m": station[::10].tolist(),
        "shape": mode.shape(station)[::10].tolist(),
        "slope_radpm": mode.slope(station)[::10].tolist(),
    }
    findings = (
        f"The tip turns {number(factor)} rad per metre of deflection ({number(factor * beam.length_m)} / l): 0.4 mm at "
        f"each camera is {0.8 * factor:.1f} mrad of relative toe.",
        f"So heavy a tip bends the strip as a static force would: the shape differs from the cubic by {percent(gap)}.",
    )
    return Section("fig_4", "Fig. 4: first mode of the boom", findings, (), (_draw_mode(station, mode),), data)


def _draw_mode(station: Floats, mode: BeamMode) -> Picture:
    def paint(axes: Any) -> None:
        shape, slope = axes[0]
        shape.plot(1e3 * station, mode.shape(station), color=BLUE)
        shape.set(title="Normalised shape", xlabel="station, mm", ylabel="deflection / tip")
        slope.plot(1e3 * station, mode.slope(station) / mode.slope_at_tip_radpm, color=RED)
        slope.set(title="Normalised slope", xlabel="station, mm", ylabel="slope / tip")

    return draw("Fig. 4: normalised first mode shape and slope along the boom", 1, 2, paint)


@dataclass(frozen=True, slots=True, eq=False)
class Shaken:
    """The boom under random drive: base and tip acceleration (n,), modal coordinates (n, 2), and what they show."""

    rate_hz: float
    base_mps2: Floats
    tip_mps2: Floats
    q_m: Floats
    slope_factors_radpm: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Averaged spectra: frequencies (k,), coherence (k,), gain of the tip's over the base's acceleration (k,)."""

    frequency_hz: Floats
    coherence: Floats
    gain: Floats
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
    wing, modes = boom_wing(airframe.wing.symmetric.damping.value)
    model = WingModel(wing)
    rate_hz = 1.0 / SUBSTEP_S
    burn = round(_BURN_IN_S * rate_hz)
    count = burn + round((_WINDOW_S * (printed.AVERAGES + 1) / 2) * rate_hz)
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
    slopes = np.array([mode.slope_at_tip_radpm for mode in modes])
    return Shaken(rate_hz, measured[burn:], tip[burn:], q[1 + burn :, columns], slopes)


def _band_noise(rng: np.random.Generator, count: int, rate_hz: float) -> Floats:
    spectrum = np.fft.rfft(rng.standard_normal(count))
    spectrum[np.fft.rfftfreq(count, 1.0 / rate_hz) > printed.NOISE_BAND_HZ] = 0.0
    noise = np.fft.irfft(spectrum, count)
    return np.asarray(_SHAKER_RMS_MPS2 * noise / np.std(noise))


def respond(shaken: Shaken) -> Response:
    """Welch's averages over half-overlapping Hann windows."""
    from scipy.signal import coherence, csd, welch  # 0.8 s to import, so late

    window = round(_WINDOW_S * shaken.rate_hz)
    averages = (len(shaken.base_mps2) - window // 2) // (window - window // 2)
    kind: dict[str, Any] = {"fs": shaken.rate_hz, "nperseg": window}
    frequency, cross = csd(shaken.base_mps2, shaken.tip_mps2, **kind)
    _, power = welch(shaken.base_mps2, **kind)
    _, alike = coherence(shaken.base_mps2, shaken.tip_mps2, **kind)
    inside = (frequency > 1.0) & (frequency < printed.NOISE_BAND_HZ - 1.0)
    gain = np.abs(cross[inside]) / power[inside]
    return Response(frequency[inside], np.asarray(alike[inside]), np.asarray(gain), averages)


def figs_11_12() -> Section:
    """Random drive: the first mode dominates, and by how much."""
    airframe = load_airframe("paper-beam")
    shaken = shake(airframe)
    response = respond(shaken)
    data = _dominance(shaken, response)
    felt = data["share_of_acceleration_variance"]
    data["averages"] = response.averages
    data["damping"] = airframe.wing.symmetric.damping.value
    findings = (
        f"The first mode dominates: it makes all but {_rest(data['share_of_deflection_variance'])} of the variance of "
        f"the tip's deflection and all but {_rest(data['share_of_slope_variance'])} of its slope's, which turns the "
        f"cameras; of the tip's acceleration, which the paper plots, it is {percent(felt, 1)}.",
        f"Transfer function: {number(data['peak_gain'], 3)} at {number(data['peak_hz'])} Hz (mode 1 is at "
        f"{number(data['first_hz'])} Hz); beyond 60 Hz it stays below {number(data['largest_gain_beyond_60_hz'], 3)}.",
        f"The second mode, {number(data['second_hz'])} Hz, lies outside the drive's 0-200 Hz: what the figure shows is "
        "in part the drive's band, not the beam.",
        f"Coherence: median {data['median_coherence']:.4f}, least {data['least_coherence']:.3f} at "
        f"{number(data['least_coherence_hz'], 3)} Hz, with {response.averages} averages.",
    )
    table = Table(
        "Dominance of the first mode under random drive",
        ("of", "not mode 1, share of variance"),
        (
            ("tip deflection", _rest(data["share_of_deflection_variance"])),
            ("tip slope", _rest(data["share_of_slope_variance"])),
            ("tip acceleration (mode 1: 10 to 40 Hz)", _rest(data["share_of_acceleration_variance"])),
        ),
        f"Damping {data['damping']:g} is the airframe's belief; the paper gives none. Modes 1 and 2 of Table 2's beam.",
    )
    pictures = (_draw_time(shaken), _draw_response(response))
    return Section("figs_11_12", "Figs. 11 and 12: random excitation", findings, (table,), pictures, data)


def _dominance(shaken: Shaken, response: Response) -> dict[str, Any]:
    first, second = corrected_beam().modes(2)
    slopes = shaken.q_m * shaken.slope_factors_radpm
    spectrum = np.abs(np.fft.rfft(shaken.tip_mps2)) ** 2
    frequency = np.fft.rfftfreq(len(shaken.tip_mps2), 1.0 / shaken.rate_hz)
    inside = frequency <= printed.NOISE_BAND_HZ
    near = (frequency >= 10.0) & (frequency <= 40.0)
    peak, least = int(np.argmax(response.gain)), int(np.argmin(response.coherence))
    return {
        "share_of_deflection_variance": _share(shaken.q_m),
        "share_of_slope_variance": _share(slopes),
        "share_of_acceleration_variance": float(spectrum[near].sum() / spectrum[inside].sum()),
        "peak_gain": float(response.gain[peak]),
        "peak_hz": float(response.frequency_hz[peak]),
        "largest_gain_beyond_60_hz": float(np.max(response.gain[response.frequency_hz > 60.0])),
        "first_hz": first.frequency_hz,
        "second_hz": second.frequency_hz,
        "median_coherence": float(np.median(response.coherence)),
        "least_coherence": float(response.coherence[least]),
        "least_coherence_hz": float(response.frequency_hz[least]),
        "tip_deflection_rms_mm": 1e3 * float(np.std(shaken.q_m.sum(axis=1))),
    }


def _rest(share: float) -> str:
    return f"{number(100.0 * (1.0 - share), 2)} %"


def _share(parts: Floats) -> float:
    """Variance of the first column over the sum of both."""
    variance = np.var(parts, axis=0)
    return float(variance[0] / variance.sum())


def _draw_time(shaken: Shaken) -> Picture:
    shown = round(_SHOWN_S * shaken.rate_hz)
    t_s = np.arange(shown) / shaken.rate_hz

    def paint(axes: Any) -> None:
        top, bottom = axes[:, 0]
        top.plot(t_s, shaken.base_mps2[:shown], color=GREY, lw=0.6, rasterized=True)
        top.set(title="Input to the shaker, 0-200 Hz", ylabel="m/s²")
        bottom.plot(t_s, shaken.tip_mps2[:shown], color=BLUE, lw=0.6, rasterized=True)
        bottom.set(title="Accelerometer at the tip", xlabel="time, s", ylabel="m/s²")

    return draw("Fig. 11: random input (top) and the tip's response (bottom)", 2, 1, paint, 1.9)


def _draw_response(response: Response) -> Picture:
    def paint(axes: Any) -> None:
        top, bottom = axes[:, 0]
        top.plot(response.frequency_hz, response.coherence, color=GREY, lw=0.9)
        top.set(title="Coherence", ylim=(0, 1.05))
        bottom.semilogy(response.frequency_hz, response.gain, color=BLUE, lw=0.9)
        bottom.set(title="Transfer function, tip over base", xlabel="frequency, Hz", ylabel="gain")

    return draw(f"Fig. 12: coherence and transfer function, {response.averages} averages", 2, 1, paint, 1.9)
