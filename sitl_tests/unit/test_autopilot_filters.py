"""The vehicle's own filters are undone over the band of the modes, and follow its parameters when they change."""

from __future__ import annotations

import dataclasses
import math
import struct
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode.decoder import Decoder
from companion.adapters.mavlink.vehicle.periodic_requests import NEEDED_PARAMETERS
from companion.core.autopilot_filters import NAMES, VehicleFilters
from companion.core.pipeline import PipelineState, start, step
from companion.core.tracking.streams import SampleBuffer
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import AutopilotParameter, Axis, ClockName, Floats, ImuBatch, Notice, RawChunk, Station
from sitl_tests.native.averaging import averages_of

RATE_HZ, BACKEND_HZ = 1000.0 / 3.0, 2000.0
CELL_NS = 4_000_000


def lowpassed(samples: Floats, cutoff_hz: float) -> Floats:
    """ArduPilot's 2nd-order low-pass at the backend's rate, written here from its transfer function."""
    k = math.tan(math.pi * cutoff_hz / BACKEND_HZ)
    norm = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
    return recursion(
        samples,
        (k * k * norm, 2 * k * k * norm, k * k * norm),
        (2 * (k * k - 1) * norm, (1 - math.sqrt(2) * k + k * k) * norm),
    )


def notched(samples: Floats, centre_hz: float, width_hz: float, attenuation_db: float) -> Floats:
    """ArduPilot's notch: a bilinear one of Q and depth as its documentation has them."""
    octaves = 2 * math.log2(centre_hz / (centre_hz - width_hz / 2))
    quality, depth = math.sqrt(2**octaves) / (2**octaves - 1), 10 ** (-attenuation_db / 20)
    omega = 2 * math.pi * centre_hz / BACKEND_HZ
    alpha = math.sin(omega) / (2 * quality)
    b = np.array([1 + alpha * depth, -2 * math.cos(omega), 1 - alpha * depth]) / (1 + alpha)
    return recursion(samples, tuple(b.tolist()), (-2 * math.cos(omega) / (1 + alpha), (1 - alpha) / (1 + alpha)))


def recursion(x: Floats, b: tuple[float, ...], a: tuple[float, float]) -> Floats:
    y = np.zeros_like(x)
    for i in range(len(x)):
        past = sum(b[j] * x[i - j] for j in range(3) if i >= j)
        y[i] = past - sum(a[j - 1] * y[i - j] for j in (1, 2) if i >= j)
    return y


def sent(frequency_hz: float, filtered: Any, seconds: float = 4.0) -> tuple[np.ndarray, Floats]:
    """Stamps and one channel of a unit sine, as the autopilot filters, samples and stamps it."""
    t_s = np.arange(round(seconds * BACKEND_HZ)) / BACKEND_HZ
    every = round(BACKEND_HZ / RATE_HZ)
    return np.round(t_s[::every] * 1e9).astype(np.int64), filtered(np.sin(2 * np.pi * frequency_hz * t_s))[::every]


def phasor(t_s: Floats, y: Floats, frequency_hz: float) -> complex:
    """Least squares amplitude and phase against sin(w t)."""
    w = 2 * np.pi * frequency_hz
    sine, cosine = np.linalg.lstsq(np.stack([np.sin(w * t_s), np.cos(w * t_s)], 1), y, rcond=None)[0]
    return complex(sine, cosine)


def batch(t_ns: np.ndarray, accel: Floats | float = 0.0, gyro: Floats | float = 0.0) -> ImuBatch:
    values = np.zeros((len(t_ns), 6))
    values[:, 2], values[:, 3] = accel, gyro
    return ImuBatch(Station.ROOT, ClockName.BOOT, t_ns, values, Axis.ALL, int(t_ns[-1]))


def set_parameter(state: PipelineState, name: str, value: float) -> list[Any]:
    return step(state, AutopilotParameter(name, value, 1))[1]


@pytest.mark.parametrize("cutoff_hz", [20.0, 45.0, 100.0])
@pytest.mark.parametrize("frequency_hz", [3.0, 7.0, 15.0])
def test_the_low_pass_is_undone_in_gain_and_phase_over_the_band(frequency_hz: float, cutoff_hz: float) -> None:
    state = start(load_airframe("nadir-2m"), Settings())
    set_parameter(state, "INS_ACCEL_FILTER", 30.0)
    set_parameter(state, "INS_ACCEL_FILTER", cutoff_hz)  # a live change
    set_parameter(state, "INS_GYRO_FILTER", cutoff_hz)
    t_ns, y = sent(frequency_hz, lambda x: lowpassed(x, cutoff_hz))
    stream = SampleBuffer(state.airframe.root)
    stream.add(batch(t_ns, y, y), -1)
    edges = 1_000_000_000 + CELL_NS * np.arange(501, dtype=np.int64)
    middle_s = (edges[:-1] + CELL_NS // 2) * 1e-9
    mean = averages_of(stream, edges).mean
    truth = np.sinc(frequency_hz * CELL_NS * 1e-9)  # what averaging over a cell leaves
    for column in (2, 3):
        response = phasor(middle_s, mean[:, column], frequency_hz) / truth
        as_sent = phasor(t_ns * 1e-9, y, frequency_hz)
        assert abs(response) == pytest.approx(1.0, abs=0.02)
        assert abs(np.angle(response, deg=True)) < 0.6
        assert abs(np.angle(as_sent, deg=True)) > 5 * abs(np.angle(response, deg=True))


@pytest.mark.parametrize("harmonics", [1, 3])
@pytest.mark.parametrize("frequency_hz", [3.0, 7.0, 15.0])
def test_notches_are_taken_out_of_the_rates_over_the_band(frequency_hz: float, harmonics: int) -> None:
    filters = VehicleFilters()
    for what, value in (("ENABLE", 1), ("FREQ", 80), ("BW", 40), ("ATT", 40), ("HMNCS", harmonics)):
        filters.take(f"INS_HNTCH_{what}", value)

    def filtered(x: Floats) -> Floats:
        for n in range(1, 1 + harmonics.bit_length()):
            x = notched(x, 80.0 * n, 40.0 * n, 40.0)
        return x

    t_ns, y = sent(frequency_hz, filtered)
    parts = np.array_split(np.arange(len(t_ns)), 97)
    out = np.concatenate([filters.undone(batch(t_ns[chunk], 1.0, y[chunk])).values for chunk in parts])
    late = t_ns > 1_000_000_000
    before, after = (phasor(t_ns[late] * 1e-9, x[late], frequency_hz) for x in (y, out[:, 3]))
    assert abs(np.angle(after)) < 0.1 * abs(np.angle(before))
    assert abs(after) == pytest.approx(1.0, abs=0.03)
    np.testing.assert_array_equal(out[:, 2], 1.0)


def test_only_what_the_autopilot_sends_is_touched() -> None:
    filters = VehicleFilters()
    filters.take("INS_HNTCH_ENABLE", 1)
    filters.take("INS_HNTCH_FREQ", 80)
    filters.take("INS_HNTCH_BW", 40)
    filters.take("INS_ACCEL_FILTER", 33.0)
    node = dataclasses.replace(batch(np.arange(5) * 1_000_000, 0.0, 1.0), clock=ClockName.NODE_LEFT)
    assert filters.undone(node) is node
    nadir, plane = filters.applied(load_airframe("nadir-2m")), filters.applied(load_airframe("sitl-plane"))
    assert (nadir.root.lowpass_accel_hz, nadir.left.lowpass_accel_hz) == (
        33.0,
        load_airframe("nadir-2m").left.lowpass_accel_hz,
    )
    assert {plane.root.lowpass_accel_hz, plane.left.lowpass_accel_hz, plane.right.lowpass_accel_hz} == {33.0}


def test_a_gap_or_a_restart_gives_no_false_slope() -> None:
    filters = VehicleFilters(gyro_delay_s=0.001)
    for t0_s, rate in ((10.0, 0.0), (13.0, 5.0), (1.0, -5.0)):
        t_ns = np.round((t0_s + np.arange(4) * 0.003) * 1e9).astype(np.int64)
        np.testing.assert_array_equal(filters.undone(batch(t_ns, 0.0, rate)).values[:, 3], rate)


def test_px4_stamps_the_end_of_its_mean_and_filters_nothing_that_it_sends() -> None:
    state = start(load_airframe("nadir-2m"), Settings())
    before = state.airframe
    assert set_parameter(state, "IMU_ACCEL_CUTOFF", 30.0) == []
    assert state.airframe is before
    notices = set_parameter(state, "IMU_INTEG_RATE", 200.0)
    assert all(isinstance(notice, Notice) for notice in notices)
    assert "-2.50 ms" in notices[-1].text
    assert (before.root.lowpass_accel_hz, state.airframe.root.lowpass_accel_hz) == (20.0, 0.0), "it has no such filter"
    assert state.airframe.left == before.left, "a node's filter is its own"
    moved = state.filters.undone(batch(np.array([10_000_000]), 1.0))
    assert moved.t_ns.tolist() == [7_500_000]


def test_the_vehicle_is_asked_for_all_that_matters() -> None:
    assert set(NAMES) <= set(NEEDED_PARAMETERS)


@pytest.mark.parametrize(
    ("autopilot", "encoded"),
    [
        (mavlink.MAV_AUTOPILOT_PX4, struct.unpack("<f", struct.pack("<i", 200))[0]),
        (mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 200.0),
    ],
)
def test_whole_numbers_are_read_as_each_autopilot_writes_them(autopilot: int, encoded: float) -> None:
    packer = mavlink.MAVLink(None, 1, 1)
    kind = mavlink.MAV_PARAM_TYPE_INT32
    data = mavlink.MAVLink_heartbeat_message(1, autopilot, 0, 0, 4, 3).pack(packer)
    data += mavlink.MAVLink_param_value_message(b"IMU_INTEG_RATE", encoded, kind, 9, 1).pack(packer)
    records = Decoder(load_airframe("nadir-2m"), 191).decode_chunk(RawChunk(0, 5, data))
    assert [record.value for record in records if isinstance(record, AutopilotParameter)] == [200.0]


def test_what_a_px4_told_is_forgotten_with_it_when_an_ardupilot_takes_its_place() -> None:
    filters, believed = VehicleFilters(), load_airframe("nadir-2m")
    filters.take("IMU_INTEG_RATE", 200.0)
    assert filters.applied(believed).root.rate_hz == 200.0
    filters.take("INS_ACCEL_FILTER", 30.0)
    root = filters.applied(filters.applied(believed)).root
    assert (root.rate_hz, root.lowpass_accel_hz) == (believed.root.rate_hz, 30.0)
    assert root.lowpass_gyro_hz == believed.root.lowpass_gyro_hz
    assert filters.stamp_shift_ns == 0
