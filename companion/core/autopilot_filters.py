"""Inverse of the autopilot's own filters (notches, low-pass, integration), from its parameters.

ArduPilot sends samples that have gone through the harmonic notches (gyro) and then a 2nd-order Butterworth low-pass
(INS_ACCEL_FILTER, INS_GYRO_FILTER). The tracker undoes the low-pass exactly, over the whole band, while it averages.
A notch far above the wing's modes,

    H(s) = (s^2 + A^2 (w/Q) s + w^2) / (s^2 + (w/Q) s + w^2),  A = 10^(-attenuation/40 dB)

(ArduPilot libraries/Filter/NotchFilter.cpp), is undone by ``1/H = 1 + (1 - A^2) s/(Q w) + O((s/w)^3)``, which is good
to a percent up to a tenth of its frequency.

PX4 sends the mean over its integration interval (IMU_INTEG_RATE), stamped with the interval's end: the stamp is taken
back to its middle. IMU_ACCEL_CUTOFF and IMU_GYRO_CUTOFF act behind the topic from which HIGHRES_IMU and SCALED_IMU are
sent (src/modules/mavlink/streams/HIGHRES_IMU.hpp reads vehicle_imu), so there is nothing of theirs to undo, and nothing
of a low-pass that the airframe file believes in.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from companion.params.airframe import Airframe, Sensor
from companion.params.vehicle import implausible
from companion.records import Axis, ClockName, Floats, ImuBatch, Ints, Station

_PX4S = "IMU_INTEG_RATE"  # all others are ArduPilot's
NAMES = (
    "INS_ACCEL_FILTER",
    "INS_GYRO_FILTER",
    *(f"INS_{notch}_{what}" for notch in ("HNTCH", "HNTC2") for what in ("ENABLE", "FREQ", "BW", "ATT", "HMNCS")),
    _PX4S,
)
"""The parameters that matter here; no vehicle has all of them."""
_LOWPASS = {"INS_ACCEL_FILTER": "lowpass_accel_hz", "INS_GYRO_FILTER": "lowpass_gyro_hz"}
_HARMONICS = 16  # bits of ArduPilot's INS_HNTCH_HMNCS
_STATIONS = ("root", "left", "right")


@dataclass(slots=True)
class VehicleFilters:
    """Parameters as far as the vehicle has told them, and the last sample of each station for the notches' inverse.

    A value outside the range of :data:`companion.params.vehicle.VEHICLE_PARAMETERS` is not taken: what was told before
    it, or else the airframe file's belief, goes on.
    """

    values: dict[str, float] = field(default_factory=dict)
    gyro_delay_s: float = 0.0
    stamp_shift_ns: int = 0
    _refused: set[str] = field(default_factory=set)
    _last: dict[Station, tuple[int, Floats]] = field(default_factory=dict)
    _believed: dict[str, Sensor] = field(default_factory=dict)  # before any vehicle told anything
    _of_another: bool = False  # what is applied is another vehicle's

    def take(self, name: str, value: float) -> bool:
        """Take note of a parameter; whether it is one that matters, plausible and new."""
        if name not in NAMES or self.values.get(name) == value or implausible(name, value) is not None:
            return False
        self._forget_other_firmware(name)
        self.values[name] = value
        self.gyro_delay_s = sum(self._notch_delay_s(notch) for notch in ("HNTCH", "HNTC2"))
        rate_hz = self.values.get(_PX4S, 0.0)
        self.stamp_shift_ns = -round(0.5e9 / rate_hz) if rate_hz > 0 else 0
        return True

    def _forget_other_firmware(self, name: str) -> None:
        """Forget what an autopilot of the other kind told, in whose place this one is."""
        if any((earlier == _PX4S) != (name == _PX4S) for earlier in self.values):
            self.values.clear()
            self._last.clear()
            self._of_another = True

    def note_refusal(self, name: str, why: str | None) -> bool:
        """Take note of why a value is not believed (None: it is); whether that is news since its last good value."""
        if why is None:
            self._refused.discard(name)
            return False
        fresh = name not in self._refused
        self._refused.add(name)
        return fresh

    def applied(self, airframe: Airframe) -> Airframe:
        """The airframe with the vehicle's low-passes for every sensor that its autopilot sends.

        PX4 has none before what it sends, and sends no faster than it integrates.
        """
        low: dict[str, Any] = {_LOWPASS[name]: value for name, value in self.values.items() if name in _LOWPASS}
        most_hz = self.values.get(_PX4S, 0.0)
        if most_hz > 0:
            low = dict.fromkeys(_LOWPASS.values(), 0.0)
        sensors: dict[str, Any] = {}
        for name in _STATIONS:
            sensor: Sensor = getattr(airframe, name)
            believed = self._believed.setdefault(name, sensor)
            if self._of_another:
                sensor = believed
            if sensor.source.clock is ClockName.BOOT:
                rate_hz = min(sensor.rate_hz, most_hz) if most_hz > 0 else sensor.rate_hz
                sensors[name] = dataclasses.replace(sensor, rate_hz=rate_hz, **low)
        self._of_another = False
        return dataclasses.replace(airframe, **sensors)

    def undone(self, batch: ImuBatch) -> ImuBatch:
        """The batch with the notches taken out of its rates, and its stamps in the middle of what they stand for."""
        if batch.clock is not ClockName.BOOT or not (self.gyro_delay_s or self.stamp_shift_ns):
            return batch
        values = batch.values
        if self.gyro_delay_s and batch.axes & Axis.GYRO:
            values = self._ahead(batch.station, batch.t_ns, values)
        return dataclasses.replace(batch, t_ns=batch.t_ns + self.stamp_shift_ns, values=values)

    def _ahead(self, station: Station, t_ns: Ints, values: Floats) -> Floats:
        """``u = y + delay y'`` on the rates, by backward differences that go over the border of batches."""
        before_ns, before = self._last.get(station, (int(t_ns[0]), values[0, 3:]))
        self._last[station] = int(t_ns[-1]), values[-1, 3:].copy()
        steps_s = np.diff(t_ns, prepend=before_ns) * 1e-9
        change = np.diff(values[:, 3:], axis=0, prepend=before[np.newaxis])
        # after a gap, or where a clock restarted, there is no slope to be had
        near = (steps_s > 0) & (steps_s < 0.1)
        slope = np.where(near[:, np.newaxis], change / np.where(near, steps_s, 1.0)[:, np.newaxis], 0.0)
        out = values.copy()
        out[:, 3:] += self.gyro_delay_s * slope
        return out

    def _notch_delay_s(self, notch: str) -> float:
        """``(1 - A^2)/(Q w)``, summed over the harmonics that are switched on."""
        enabled, centre_hz, width_hz, attenuation_db, harmonics = (
            self.values.get(f"INS_{notch}_{what}", default)
            for what, default in (("ENABLE", 0.0), ("FREQ", 0.0), ("BW", 0.0), ("ATT", 40.0), ("HMNCS", 3.0))
        )
        if not enabled or width_hz <= 0 or centre_hz <= 0.5 * width_hz:
            return 0.0
        octaves = 2.0 * math.log2(centre_hz / (centre_hz - 0.5 * width_hz))
        ratio = math.pow(2.0, octaves)
        quality = math.sqrt(ratio) / (ratio - 1.0)
        depth = 1.0 - math.pow(10.0, -attenuation_db / 20.0)
        chosen = [n + 1 for n in range(_HARMONICS) if int(harmonics) >> n & 1]
        return sum(depth / (quality * 2.0 * math.pi * n * centre_hz) for n in chosen)
