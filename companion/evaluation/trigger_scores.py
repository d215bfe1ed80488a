"""Trigger accuracy of a flight: time from each shot to the nearest peak, and motion blur, beside limit and chance.

Peaks of deflection are those of the dominating mode, as in the paper: extremes of the modal coordinate that has moved
fastest in the last seconds, band-passed about its frequency; of two about equally fast ones the extremes of both. Peaks
of toe are extremes whose prominence is at least the toe's rms above 0.5 Hz, so that a short halt between two peaks is
not counted. The limit is a trigger that knows the wing's true state when the plan is made, but no later gust: it
predicts a free decay from that state. Blur is that by the wing and the body's roll together: the still instant of a
camera is that of both.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.signal import butter, find_peaks, lfilter, sosfiltfilt

from companion.evaluation.metrics import FAST_HZ, SETTLED_S, rms, spread
from companion.records import Bools, Floats, Ints, MatchSet, TriggerPlan
from companion.sim.flight.flight import Flight
from companion.sim.flight.truth import MODAL, STEP_NS

_BAND = (0.5, 1.6)  # of the mode's frequency: its resonance, without trim and second mode (choice)
_MEMORY_S, _CLEARLY_FASTER = 4.0, 1.5  # of mean squares of rates: the mode that dominates (convention: core/trigger)
_FIRST_MODES = 2  # columns: the symmetric and the antisymmetric one (by definition)
_ROLL_BY_SLOPE = np.array([1.0, -1.0])  # a left tip that bends up rolls to the right, a right one to the left (derived)
_RANDOM_INSTANTS = 2000  # their mean is known to 2 % (choice)
_AHEAD_STEPS = 400  # of the truth, 1 ms: the longest time from plan to exposure (choice)
_SAME_SHOT_NS = 20_000_000  # shots are 33 ms apart at least, TRG_RATE 30 Hz (derived)
_RANDOM_SEED = 0xC4A  # convention: keeps these instants apart from the flight's own draws


def true_peaks_s(flight: Flight) -> dict[str, Floats]:
    """Instants (n,) (s of boot time) of the true peaks of ``deflection`` and ``toe``."""
    truth, rate_hz, step_s = flight.truth, 1e9 / STEP_NS, STEP_NS * 1e-9
    dominates, peaks = dominating(flight), []
    for column in range(dominates.shape[1]):
        frequency_hz = float(flight.model.omega_radps[column]) / (2.0 * np.pi)
        modal = flight.model.present(truth.knots[:, MODAL])[:, column]
        band = butter(2, np.array(_BAND) * frequency_hz, "bandpass", fs=rate_hz, output="sos")
        extremes_s = _extremes_s(np.asarray(sosfiltfilt(band, modal)), step_s)
        peaks.append(extremes_s[dominates[np.rint(extremes_s / step_s).astype(np.int64), column]])
    toe = truth.knots[:, MODAL] @ truth.shape.slope_radpm.sum(axis=0)
    fast = np.asarray(sosfiltfilt(butter(2, FAST_HZ, "highpass", fs=rate_hz, output="sos"), toe))
    stands_out = [find_peaks(sign * fast, prominence=rms(fast))[0] for sign in (1.0, -1.0)]
    return {"deflection": np.sort(np.concatenate(peaks)), "toe": np.sort(np.concatenate(stands_out)) * step_s}


def dominating(flight: Flight) -> Bools:
    """Which first modes (n, 2) dominate at each of the truth's knots: the other did not move clearly faster lately.

    Of two that move about equally fast a trigger may follow either, so both count, for limit and chance as well.
    """
    rates = flight.model.present(flight.truth.derivatives[:, MODAL])[:, :_FIRST_MODES]
    weight = STEP_NS * 1e-9 / _MEMORY_S
    squares = lfilter([weight], [1.0, weight - 1.0], rates**2, axis=0)
    fast: Bools = _CLEARLY_FASTER * squares >= squares.max(axis=1, keepdims=True)
    return fast


class AimedShot(NamedTuple):
    """Mid-exposure of an aimed shot, and the instant at which its plan was last revised, s of boot time."""

    exposed_s: float
    planned_s: float


def trigger_scores(flight: Flight, aimed: Sequence[AimedShot]) -> dict[str, Any]:
    """Errors against both kinds of peaks (ms) and blur by wing and roll (px): at the plans, at the limit, at random."""
    free = _FreeVibration(flight)
    random_s = _random_instants_s(flight)
    fired_s = np.array([shot_s for shot_s, _ in aimed])
    scores: dict[str, Any] = {"shots": len(aimed)}
    for name, true_s in true_peaks_s(flight).items():
        limit_s = np.array([free.peak_s(planned_s, shot_s, name) for shot_s, planned_s in aimed])
        scores[f"{name}_peak_ms"] = {
            way: spread(_nearest_s(instants, true_s), 1e3)
            for way, instants in (("at_plan", fired_s), ("limit", limit_s), ("at_random", random_s))
        }
    stillest_s = np.array([free.stillest_s(planned_s, shot_s) for shot_s, planned_s in aimed])
    blur = {way: _blur_px(flight, instants) for way, instants in
            (("at_plan", fired_s), ("limit", stillest_s), ("at_random", random_s))}  # fmt: skip
    scores["blur_px"] = {way: spread(values) for way, values in blur.items()}
    rms_px = {way: float(np.sqrt(np.mean(values**2))) if len(values) else np.nan for way, values in blur.items()}
    scores["share_of_gain"] = (rms_px["at_random"] - rms_px["at_plan"]) / (rms_px["at_random"] - rms_px["limit"])
    return scores


def _random_instants_s(flight: Flight) -> Floats:
    """Instants (n,) over the settled part of the flight; over all of it where it ends before that."""
    last_s = flight.duration_s - 1.0
    begin_s, end_s = (SETTLED_S, last_s) if last_s > SETTLED_S else (0.0, flight.duration_s)
    rng = np.random.default_rng([flight.seed, _RANDOM_SEED])
    return np.asarray(rng.uniform(begin_s, end_s, _RANDOM_INSTANTS))


def aimed_shots(plans: Iterable[TriggerPlan], matches: Iterable[MatchSet], start_host_ns: int) -> list[AimedShot]:
    """Pairs of images that plans, each as last revised, aimed at; the others are left out.

    ``start_host_ns`` is the host time of boot time 0.
    """
    plans = sorted(plans, key=lambda plan: plan.exposure_host_ns)
    exposures: Ints = np.array([plan.exposure_host_ns for plan in plans], dtype=np.int64)
    shots: list[AimedShot] = []
    if not plans:
        return shots
    for entry in matches:
        t_ns = int(entry.mid_exposure_ns.mean())
        nearest = int(np.argmin(np.abs(exposures - t_ns)))
        if abs(int(exposures[nearest]) - t_ns) < _SAME_SHOT_NS:
            planned_ns = plans[nearest].planned_host_ns - start_host_ns
            shots.append(AimedShot((t_ns - start_host_ns) * 1e-9, planned_ns * 1e-9))
    return shots


class _FreeVibration:
    """Free decay from the true state of an instant: modal motion on a grid of the truth's steps."""

    def __init__(self, flight: Flight) -> None:
        self._flight = flight
        step = np.asarray(expm(flight.model.state_space().a * STEP_NS * 1e-9))
        powers = [np.eye(len(step))]
        for _ in range(_AHEAD_STEPS):
            powers.append(step @ powers[-1])
        self._powers = np.array(powers)
        self._dominates = dominating(flight)
        shape = flight.truth.shape.slope_radpm
        self._slopes = flight.model.present(shape)

    def _rates(self, planned_s: float) -> Floats:
        """Modal rates (steps + 1, n)."""
        model, truth = self._flight.model, self._flight.truth.at(round(planned_s * 1e9))
        bent_m = model.present(truth.q_m) - model.q_static(truth.load_factor)
        start = np.concatenate([bent_m, model.present(truth.qdot_mps)])
        return np.asarray((self._powers @ start)[:, model.count :])

    def _columns(self, planned_s: float) -> Ints:
        return np.flatnonzero(self._dominates[round(planned_s * 1e9 / STEP_NS)])

    def peak_s(self, planned_s: float, shot_s: float, kind: str) -> float:
        """The predicted peak that is nearest to the shot."""
        rates = self._rates(planned_s)
        moving = (
            rates[:, self._columns(planned_s)] if kind == "deflection" else rates @ self._slopes.sum(axis=0)[:, None]
        )
        at, column = np.nonzero(moving[:-1] * moving[1:] < 0)
        if not len(at):
            return shot_s
        before, after = moving[at, column], moving[at + 1, column]
        instants = planned_s + (at + before / (before - after)) * STEP_NS * 1e-9
        return float(instants[np.argmin(np.abs(instants - shot_s))])

    def stillest_s(self, planned_s: float, shot_s: float) -> float:
        """The instant of least predicted blur within half a period of the shot; the body rolls on as it does."""
        roll_radps = self._flight.truth.at(round(planned_s * 1e9)).body_rate_radps[0]
        worst = np.abs(roll_radps + self._rates(planned_s) @ self._slopes.T * _ROLL_BY_SLOPE).max(axis=1)
        instants = planned_s + np.arange(len(worst)) * STEP_NS * 1e-9
        half_s = np.pi / float(self._flight.model.omega_radps[self._columns(planned_s)[0]])
        near = np.abs(instants - shot_s) <= 0.5 * half_s
        return float(instants[near][np.argmin(worst[near])]) if near.any() else shot_s


def _extremes_s(values: Floats, step_s: float) -> Floats:
    slope = np.diff(values)
    turns = np.flatnonzero(slope[:-1] * slope[1:] < 0)
    return np.asarray((turns + 0.5 + slope[turns] / (slope[turns] - slope[turns + 1])) * step_s)


def _nearest_s(instants_s: Floats, peaks_s: Floats) -> Floats:
    """Signed time from the nearest peak, (n,); nothing without peaks."""
    if not len(instants_s) or not len(peaks_s):
        return np.zeros(0)
    after = np.clip(np.searchsorted(peaks_s, instants_s), 1, len(peaks_s) - 1)
    early, late = instants_s - peaks_s[after - 1], instants_s - peaks_s[after]
    return np.where(np.abs(early) < np.abs(late), early, late)


def _blur_px(flight: Flight, instants_s: Floats) -> Floats:
    """Image motion over the exposure by the wing and the body's roll, the worse of both cameras, (n,)."""
    cameras = [camera for camera in (flight.real.actual.left_camera, flight.real.actual.right_camera) if camera]
    if not len(instants_s) or not cameras:
        return np.zeros(0)
    motion = flight.truth.series(np.rint(instants_s * 1e9).astype(np.int64))
    rates = np.abs(motion.body_rate_radps[:, :1] + motion.slope_rate_radps * _ROLL_BY_SLOPE)
    per_rate = np.array([camera.focal_px.value * camera.exposure_s for camera in cameras])
    return np.asarray((rates * per_rate).max(axis=1))
