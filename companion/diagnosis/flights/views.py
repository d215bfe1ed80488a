"""Views without a name: autocorrelation of the innovations, backbone, restoring force, left against right.

Each view has a statistic, and :func:`strengths` says how far it lies from what the fitted model itself shows by chance,
in recordings simulated from it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.records import Floats

_LAGS_S = 1.0  # chosen: five periods at 5 Hz, within which a forgotten mode shows
_CELLS = 13  # of a map, odd so that one stands at zero (choice)
_REACH = 2.2  # chosen: rms: of a normal motion 97 % lies within
_AMPLITUDE_BINS = 8  # points of a backbone, of equally many samples (choice)
_FEWEST = 12  # chosen: samples of a cell that is drawn: a mean known to a third of its scatter
_DRAWS = 40  # a bound on the cost of a view
_SEED = 20250103  # convention: any fixed number
_PARTS = 12  # of a recording, for the scatter of a coherence (choice)
AUTOCORRELATION = "autocorrelation of the innovations"
BACKBONE = "frequency by amplitude"
WORK = "damping by amplitude"
FORCE = "force over deflection and speed"
SIDES = "left against right"


@dataclass(frozen=True, slots=True)
class Autocorrelation:
    """Autocorrelation of the whitened residual: lags (l,), values (c, l), and the bound of 95 % of chance."""

    lag_s: Floats
    values: Floats
    bound: float


@dataclass(frozen=True, slots=True)
class ForceMap:
    """Mean residual force on the symmetric mode over deflection and speed in units of their rms; NaN where too few."""

    edges: Floats
    force: Floats


@dataclass(frozen=True, slots=True)
class Backbone:
    """The symmetric mode by amplitude: its frequency, and the work that a missing force takes out of it, with sigmas.

    The work is force times speed in units of their rms: above 0 the wing is damped more than the model is.
    """

    amplitude_m: Floats
    frequency_hz: Floats
    frequency_sigma_hz: Floats
    work: Floats
    work_sigma: Floats


def autocorrelation(model: FlightModel, expectation: Expectation) -> Autocorrelation:
    """Autocorrelation of each accelerometer's residual; white where nothing is left."""
    white = expectation.white_residual
    lag_s = np.linspace(0.0, _LAGS_S, 201)[1:]
    phasors = np.exp(2j * np.pi * np.outer(model.band_hz, lag_s))
    values = (np.abs(white) ** 2 @ phasors).real / np.sum(np.abs(white) ** 2, axis=1, keepdims=True)
    # a mean of b exponentials of random phases has variance 1/2b; the band's own ringing is taken off
    window = np.mean(phasors, axis=0).real
    bound = 1.96 * float(np.sqrt(0.5 / (len(model.band_hz) * model.weight)))
    return Autocorrelation(lag_s, np.asarray(values - window), bound)


def force_map(model: FlightModel, expectation: Expectation) -> ForceMap:
    """Mean residual force over deflection and speed."""
    force = _force(model, expectation)
    q, v = expectation.q_m[0] / np.std(expectation.q_m[0]), expectation.qdot_mps[0] / np.std(expectation.qdot_mps[0])
    edges = np.linspace(-_REACH, _REACH, _CELLS + 1)
    total = np.histogram2d(v, q, (edges, edges), weights=force)[0]
    count = np.histogram2d(v, q, (edges, edges))[0]
    return ForceMap(edges, np.where(count >= _FEWEST, total / np.maximum(count, 1), np.nan))


def backbone(model: FlightModel, expectation: Expectation) -> Backbone:
    """Frequency and damping of the symmetric mode over its amplitude."""
    wing = model.belief.airframe.wing.symmetric
    omega = 2.0 * np.pi * wing.frequency_hz.value
    spectrum = np.fft.rfft(expectation.q_m[0])
    f_hz = np.fft.rfftfreq(len(expectation.q_m[0]), 1.0 / model.observations.rate_hz)
    near = (f_hz > 0.6 * wing.frequency_hz.value) & (f_hz < 1.5 * wing.frequency_hz.value)
    analytic = np.fft.ifft(np.where(near, 2.0 * spectrum, 0.0), len(expectation.q_m[0]))
    amplitude = np.abs(analytic)
    phase_step = np.diff(np.unwrap(np.angle(analytic)), append=np.nan)
    instantaneous_hz = phase_step * model.observations.rate_hz / (2.0 * np.pi)
    instantaneous_hz[-1] = instantaneous_hz[-2]
    force, speed = _force(model, expectation), expectation.qdot_mps[0]
    rows = []
    for index in np.array_split(np.argsort(amplitude), _AMPLITUDE_BINS):
        weight = amplitude[index] ** 2
        mean = float(np.sum(weight * instantaneous_hz[index]) / np.sum(weight))
        # neighbours swing together for about 1/(zeta omega)
        alone = max(len(index) / (model.observations.rate_hz / (wing.damping.value * omega)), 2.0)
        spread = float(np.sqrt(np.sum(weight * (instantaneous_hz[index] - mean) ** 2) / np.sum(weight) / alone))
        work = -force[index] * speed[index] / np.sqrt(np.mean(speed[index] ** 2))
        rows.append([float(np.median(amplitude[index])), mean, spread, np.mean(work), np.std(work) / np.sqrt(alone)])
    return Backbone(*np.array(rows).T)


def strengths(
    model: FlightModel, expectation: Expectation, values: Floats, terms: Sequence[EffectTerm]
) -> dict[str, float]:
    """Standard deviations of each view's statistic from the mean of simulated recordings of the same model.

    ``values`` (p,) and ``terms`` are the fit's own, of which ``expectation`` is what it makes of the recording.
    """
    rng = np.random.default_rng(_SEED)
    count = len(model.belief.nuisances)
    drawn: list[dict[str, float]] = []
    for _ in range(_DRAWS):
        up = np.ascontiguousarray(model.draw(expectation, rng).T)
        simulated = dataclasses.replace(model.observations, up_mps2=up, fine_mps2=None, toe=None, inputs={})
        twin = FlightModel(model.belief, simulated, model.top_hz, model.recording)
        drawn.append(_statistics(twin, twin.expect(values[:count], terms)))
    real = _statistics(model, expectation)
    table = {name: np.array([statistics[name] for statistics in drawn]) for name in real}
    return {name: float((real[name] - table[name].mean()) / max(table[name].std(), 1e-300)) for name in real}


def _statistics(model: FlightModel, expectation: Expectation) -> dict[str, float]:
    """One number for each view, which grows with its lack of fit; logarithms, whose scatter is nearer to normal."""
    spine, force = backbone(model, expectation), force_map(model, expectation).force
    statistics = {
        AUTOCORRELATION: float(np.max(np.abs(autocorrelation(model, expectation).values))),
        BACKBONE: float(np.std(spine.frequency_hz)),
        WORK: float(np.mean(spine.work**2)),
        FORCE: float(np.nanmean(force**2)),
    }
    white = expectation.white_residual
    if len(white) > 1:
        segments = np.array_split(white[0] * white[1].conj(), _PARTS)
        statistics[SIDES] = max(abs(complex(np.sum(segment))) / float(np.sqrt(len(segment))) for segment in segments)
    return {name: float(np.log(max(value, 1e-300))) for name, value in statistics.items()}


def _force(model: FlightModel, expectation: Expectation) -> Floats:
    """Residual force on the symmetric mode in units of its own rms."""
    score = model.force_score(expectation)[0]
    return np.asarray(score / max(float(np.std(score)), 1e-300))
