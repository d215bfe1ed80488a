"""Peers of the worlds' campaign: other ways with a bending wing, on the same records.

Each gives the relative toe of every shot and shares nothing with the estimator: extrinsics from the matches of each
pair alone (self-calibration by epipolar geometry, as stereo cameras' dynamic calibration does), a tilt filter of both
tips without a wing model, and band-pass with zero crossings of the vertical acceleration (the paper's way). Clocks are
aligned by the stamps' delays, a line for each node, which is good to a tenth of a millisecond here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.signal import butter, sosfiltfilt

from companion.core.stereo.geometry import Rig
from companion.core.stereo.rotation import exp_rotation
from companion.params.airframe import Airframe
from companion.records import Floats, ImuBatch, MatchSet, Record, Side, Station
from companion.sim.flight.offline import HOST_EPOCH_NS
from companion.units import GRAVITY_MPS2

IMAGES, TILT, BAND_PASS = "pair alone", "tilt filter", "band-pass"
PEERS = (IMAGES, TILT, BAND_PASS)
_STEP_S = 0.001
_TILT_LOWPASS_HZ = 40.0
_TILT_S = 30.0  # least error above 0.5 Hz of 0.3, 1, 3, 10 and 30 s, in each of six flights (measured)
_WIRE_S = 0.0007  # half a sample, work and wire: the least delay of a stamp (derived)
_HUBER = 2.0
_ITERATIONS = 6
_TIPS = (Station.LEFT, Station.RIGHT)


def peer_toes(
    airframe: Airframe, records: list[Record], shots: list[list[float]], matches: Mapping[int, MatchSet]
) -> dict[str, Floats]:
    """Toe (n,) of each peer at the shots, rows of (pair id, seconds of boot time); NaN where it has none."""
    t_s = np.array([shot[1] for shot in shots])
    grid_s, tips = tips_on_grid(records)
    estimates = {IMAGES: np.array([pair_alone(airframe, matches[int(shot[0])]) for shot in shots])}
    estimates[TILT] = estimates[BAND_PASS] = np.full(len(t_s), np.nan)
    if airframe.looks_down:  # a pair that looks ahead is rolled, not yawed, by bending
        estimates[BAND_PASS] = np.interp(t_s, grid_s, band_pass(airframe, tips))
        if set("ypr") <= set(airframe.left.sends):
            mean_rate = 0.5 * (tips[0][:, 3] + tips[1][:, 3])
            estimates[TILT] = np.interp(t_s, grid_s, tilt_filter(tips))
            estimates[TILT] += np.interp(t_s, grid_s, mean_rate) * _between_exposures_s(shots, matches)
    return estimates


def _between_exposures_s(shots: list[list[float]], matches: Mapping[int, MatchSet]) -> Floats:
    """How much later the left camera exposes than the right one (n,): the aircraft rolls on meanwhile."""
    mid_ns = np.array([matches[int(shot[0])].mid_exposure_ns for shot in shots], dtype=np.int64)
    return np.asarray((mid_ns[:, Side.LEFT] - mid_ns[:, Side.RIGHT]) * 1e-9)


def pair_alone(airframe: Airframe, matches: MatchSet) -> float:
    """Yaw of the right camera that makes this pair's rays most nearly coplanar with the baseline, Huber-weighted."""
    rig = Rig.from_airframe(airframe)
    x = rig.right.rest.position_body_m - rig.left.rest.position_body_m
    x = x / np.linalg.norm(x)
    z = rig.left.rest.camera_from_body[2] + rig.right.rest.camera_from_body[2]
    z = z - (z @ x) * x
    z /= np.linalg.norm(z)
    frame = np.stack([x, np.cross(z, x), z])
    left = rig.left.rays(rig.left.rest, matches.left_px) @ frame.T
    right = rig.right.rays(rig.right.rest, matches.right_px) @ frame.T
    turn = np.zeros(3)
    if len(left) < 12:
        return math.nan
    for _ in range(_ITERATIONS):
        rays = right @ exp_rotation(turn).T
        xr, yr, y = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2], left[:, 1] / left[:, 2]
        columns = np.stack([-(1.0 + yr**2), xr * yr, xr], axis=1)
        residual = y - yr
        scale = 1.4826 * np.median(np.abs(residual)) + 1e-9
        weight = np.minimum(1.0, _HUBER * scale / np.maximum(np.abs(residual), 1e-12))
        turn = turn + np.linalg.lstsq(columns * weight[:, None], residual * weight, rcond=None)[0]
    return float(turn[1])


def tilt_filter(tips: tuple[Floats, Floats]) -> Floats:
    """Relative toe from both tips' roll rates, levelled by their lateral accelerations: two states, no wing.

    ``toe' = p_left - p_right - bias``; the lateral axes differ by ``g_z toe + 2 y (p^2 + r^2)``.
    """
    sections = butter(2, _TILT_LOWPASS_HZ, fs=1.0 / _STEP_S, output="sos")
    left, right = (np.asarray(sosfiltfilt(sections, tip, axis=0)) for tip in tips)
    rate = left[:, 3] - right[:, 3]
    mean_rate = 0.5 * (left[:, 3:] + right[:, 3:])
    lateral = left[:, 1] - right[:, 1] - 2.0 * (mean_rate[:, 0] ** 2 + mean_rate[:, 2] ** 2)
    down = 0.5 * (left[:, 2] + right[:, 2])
    tilt = lateral / np.where(down < -0.3 * GRAVITY_MPS2, down, -GRAVITY_MPS2)
    out = np.empty(len(rate))
    toe, bias, before = float(tilt[0]), 0.0, float(rate[0])
    slow, slower = _STEP_S / _TILT_S, (_STEP_S / _TILT_S) ** 2 / 4.0
    for k, (rate_radps, tilt_rad) in enumerate(zip(rate.tolist(), tilt.tolist(), strict=True)):
        toe += _STEP_S * (0.5 * (before + rate_radps) - bias)
        error = tilt_rad - toe
        toe += slow * error
        bias -= slower / _STEP_S * error
        out[k], before = toe, rate_radps
    return out


def band_pass(airframe: Airframe, tips: tuple[Floats, Floats]) -> Floats:
    """Relative toe as -a / omega^2 of the band-passed vertical accelerations, omega from their zero crossings."""
    wing = airframe.wing.symmetric
    believed_hz = wing.frequency_hz.value
    sections = butter(2, (0.6 * believed_hz, 1.6 * believed_hz), "bandpass", fs=1.0 / _STEP_S, output="sos")
    up = np.stack([sosfiltfilt(sections, -tip[:, 2]) for tip in tips], axis=1)
    mean = up.mean(axis=1)
    crossings = np.flatnonzero((mean[:-1] < 0.0) & (mean[1:] >= 0.0))
    frequency_hz = believed_hz
    if len(crossings) > 2:
        frequency_hz = (len(crossings) - 1) / float((crossings[-1] - crossings[0]) * _STEP_S)
    return np.asarray(-up.sum(axis=1) / (2.0 * math.pi * frequency_hz) ** 2 * wing.slope_factor_radpm.value)


def tips_on_grid(records: list[Record]) -> tuple[Floats, tuple[Floats, Floats]]:
    """One grid (n,) of boot time, and samples (n, 6) of both tips on it."""
    streams = []
    for station in _TIPS:
        batches = [record for record in records if isinstance(record, ImuBatch) and record.station is station]
        stamps_s = 1e-9 * np.concatenate([batch.t_ns for batch in batches])
        newest_s = 1e-9 * np.array([batch.t_ns[-1] for batch in batches])
        delay_s = 1e-9 * np.array([batch.received_host_ns - HOST_EPOCH_NS - batch.t_ns[-1] for batch in batches])
        line = np.polynomial.Polynomial.fit(newest_s, delay_s, 1)
        least_s = float(np.percentile(delay_s - line(newest_s), 5)) - _WIRE_S
        streams.append((stamps_s + line(stamps_s) + least_s, np.concatenate([batch.values for batch in batches])))
    first = max(times[0] for times, _ in streams)
    last = min(times[-1] for times, _ in streams)
    grid = np.arange(first, last, _STEP_S)
    left, right = (
        np.stack([np.interp(grid, times, values[:, axis]) for axis in range(6)], axis=1) for times, values in streams
    )
    return grid, (left, right)
