"""A flight as a laboratory would record it: ``accel.csv`` and ``range.csv`` (config/README.md).

One recorder samples everything at one rate, so there is one clock, ``t_s``, which is boot time; sensor errors, noise
and low-pass are those of the flight.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np

from companion.core.stereo.geometry import Rig
from companion.core.stereo.rotation import log_rotation, relative_rotation
from companion.core.wing.effect import viewed
from companion.core.wing.effects import apply_to_airframe, make_effects
from companion.errors import ConfigError
from companion.params.airframe import Airframe
from companion.records import AXIS_LETTERS, Floats, Ints, Side, Station
from companion.sim.flight.flight import Flight
from companion.sim.flight.sensors import BACKEND_HZ, RealSensor
from companion.sim.flight.truth import TruthSeries
from companion.units import Orientation

_UNITS = ("mps2", "mps2", "mps2", "radps", "radps", "radps")
_MATCH_SIGMA_PX = 0.3  # chosen: the noise that a diagnosis believes of a match (diagnosis/model/belief.py)
_RANGE_RATE_HZ = 10.0  # chosen: a stereo pair's usual rate
_TARGET_AHEAD_M = 30.0  # chosen: a wall at a distance where bend and noise both show


def write_csv(flight: Flight, folder: Path) -> list[Path]:
    """Write the tables and give their paths; the folder is made. Ranges are written where the aircraft has cameras.

    Ranges of an earlier flight do not stay beside this one's accelerations.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = [_write_accel(flight, folder / "accel.csv")]
    ranges = folder / "range.csv"
    ranges.unlink(missing_ok=True)
    if flight.airframe.left_camera is not None:
        written.append(_write_ranges(flight, ranges))
    return written


def toe_rad(belief: Rig, real: Rig, truth: TruthSeries, row: int) -> float:
    """Relative rotation of the real, bent pair against the calibrated one, about the image's vertical; > 0 diverges."""
    poses = [
        real.pose(side, truth.slope_rad[row, side], truth.lift_m[row, side], truth.twist_rad[row, side])
        for side in Side
    ]
    bent = relative_rotation(poses[1].camera_from_body, poses[0].camera_from_body)
    rest = relative_rotation(belief.right.rest.camera_from_body, belief.left.rest.camera_from_body)
    # a right camera turned by +phi about its y (down) looks further right, and its coordinates turn by -phi
    return float(-log_rotation(bent @ rest.T)[1])


def _write_accel(flight: Flight, path: Path) -> Path:
    period_ns = round(1e9 / BACKEND_HZ)
    times = period_ns * np.arange(2, int(flight.duration_s * BACKEND_HZ) - 2, dtype=np.int64)
    names, blocks = ["t_s"], []
    for station in Station:
        sensor = flight.real.actual.sensor(station)
        real = RealSensor(flight.truth, flight.model, station, sensor, flight.real.errors[station])
        raw = real.sample(times, period_ns, flight.generator(f"table {station}"))
        keep = sensor.axes.columns
        names += [f"{station.name.lower()}_{AXIS_LETTERS[column]}_{_UNITS[column]}" for column in keep]
        blocks.append(real.recorded(real.finish(raw, BACKEND_HZ), times)[:, keep])
    return _write(path, names, times, np.hstack(blocks), "%.6f")


def _write_ranges(flight: Flight, path: Path) -> Path:
    """Give ranges as the rigid extrinsics make them of a disparity with matching noise."""
    step = round(1e9 / _RANGE_RATE_HZ)
    rng = flight.generator("ranges")
    times = np.arange(step, int(flight.duration_s * 1e9), step, dtype=np.int64) + rng.integers(0, step // 2)
    times = times[times < flight.duration_s * 1e9]
    cameras = apply_to_airframe(flight.real.actual)  # turned, moved and focused as hidden effects have them
    left, believed = cameras.camera_pair[0], flight.airframe.camera_pair[0]
    real, belief = Rig.from_airframe(cameras), Rig.from_airframe(flight.airframe)
    late_s = np.mean([viewed(flight.model.effects, side, 0.0).exposure_delay_s for side in Side])
    exposed = times + round(1e9 * late_s)
    if times.size and not (exposed[0] >= 0 and exposed[-1] <= flight.truth.end_ns):
        raise ConfigError(f"an exposure delay of {late_s:g} s: the exposures lie outside the flight")
    truth = flight.truth.series(exposed)
    truth = dataclasses.replace(truth, slope_rad=_slopes_seen(flight, cameras, truth))
    reference = reference_m(truth, flight.airframe.orientation)
    toe = np.array([toe_rad(belief, real, truth, row) for row in range(len(times))])
    disparity = left.focal_px.value * (real.baseline_m / reference + toe)
    disparity += _MATCH_SIGMA_PX * rng.standard_normal(len(times))
    rigid = believed.focal_px.value * belief.baseline_m / disparity
    table = np.stack([rigid, reference, disparity], 1)
    return _write(path, ["t_s", "range_m", "reference_m", "disparity_px"], times, table, "%.5f")


def _slopes_seen(flight: Flight, cameras: Airframe, truth: TruthSeries) -> Floats:
    """Slopes (n, 2) that the images show: through a mount that lags or rings, a slow shutter, a wandering trigger."""
    effects = make_effects(cameras.effects)
    views = [dataclasses.replace(viewed(effects, side, 0.0), slope_gain=1.0) for side in Side]
    if all(len(view.follows(np.zeros(2))) == 1 for view in views):
        return truth.slope_rad
    period_ns = round(1e9 / BACKEND_HZ)
    grid_ns = period_ns * np.arange(2, int(flight.duration_s * BACKEND_HZ) - 2, dtype=np.int64)
    slope_rad = flight.truth.series(grid_ns).slope_rad
    omega: Floats = np.asarray(2.0 * np.pi * np.fft.rfftfreq(len(grid_ns), 1.0 / BACKEND_HZ), dtype=np.float64)
    rng, seen_rad = flight.generator("exposures"), np.empty_like(truth.slope_rad)
    together = rng.standard_normal(len(seen_rad))
    for side, view in zip(Side, views, strict=True):
        steady = dataclasses.replace(view, jitter_s=0.0).follows(omega)
        passed = np.fft.irfft(steady * np.fft.rfft(slope_rad[:, side]), len(grid_ns))
        alone = rng.standard_normal(len(seen_rad))
        wander = math.sqrt(view.jitter_shared) * together + math.sqrt(1.0 - view.jitter_shared) * alone
        seen_rad[:, side] = np.interp(truth.t_boot_ns + 1e9 * view.jitter_s * wander, grid_ns, passed)
    return seen_rad


def reference_m(truth: TruthSeries, orientation: int) -> Floats:
    """True distance (n,) along the cameras' axis: to the ground for a pair that looks down, else to a wall ahead."""
    if orientation != Orientation.DOWN:
        return np.full(len(truth.t_boot_ns), _TARGET_AHEAD_M)
    # body z against NED down is the last entry of the rotation
    return np.asarray(-truth.position_ned_m[:, 2] / truth.body_from_ned[:, 2, 2])


def _write(path: Path, names: list[str], times: Ints, values: Floats, form: str) -> Path:
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(names) + "\n")
        row = "%.6f," + ",".join([form] * values.shape[1]) + "\n"
        for t_s, entry in zip((times * 1e-9).tolist(), values.tolist(), strict=True):
            file.write(row % (t_s, *entry))
    return path
