"""The estimation on a real ArduPlane flight, against the raw 1 kHz accelerometers of its onboard log.

The data lie in ``$SPANWISE_DATA`` or in ``shared`` beside the repository; README.md there tells what was injected.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.recordings.logs.dataflash import DataflashLog
from companion.adapters.recordings.recording_factory import open_recording
from companion.cli.main import main
from companion.core.tracking.tone import ToneEstimate
from companion.evaluation.replay import drive, foreign_inputs
from companion.evaluation.station_tones import StationAnalysis
from companion.params.files import load_airframe
from companion.records import Firing, ImuBatch, ModeState, Record, Station, TriggerPlan, Validity
from sitl_tests.replay.raw_accelerometer import raw_accelerometer

DATA = Path(os.environ.get("SPANWISE_DATA", Path(__file__).resolve().parents[3] / "shared"))
RECORDINGS = DATA / "recordings"
WINDOW_S = 4.0
INJECTED_MPS2 = {Station.LEFT: 4.0, Station.RIGHT: 3.6}
QUIET = ("ground.tlog", "flight_clean.tlog")
NOTHING_FOUND = 3
LEARNED_NS = 30_000_000_000  # take-off and the first turn are over
CLEAR_M = 0.0006  # 1.3 m/s^2 at 7.3 Hz, a third of what is injected

pytestmark = [
    pytest.mark.skipif(not RECORDINGS.is_dir(), reason=f"no recorded flights in {RECORDINGS}"),
    pytest.mark.slow,
]


def records(name: str) -> Iterator[Record]:
    return open_recording(RECORDINGS / name, load_airframe("sitl-plane")).records()


def analysed(name: str) -> StationAnalysis:
    stations = StationAnalysis(load_airframe("sitl-plane"))
    for record in records(name):
        if isinstance(record, ImuBatch):
            stations.add(record)
    return stations


@pytest.fixture(scope="module")
def flight() -> StationAnalysis:
    return analysed("flight.tlog")


@pytest.fixture(scope="module")
def onboard() -> DataflashLog:
    return DataflashLog(RECORDINGS / "flight.BIN")


@pytest.mark.parametrize("tip", INJECTED_MPS2)
def test_the_injected_tone_of_each_tip_is_found(flight: StationAnalysis, tip: Station) -> None:
    tone = flight.result()[tip.name.lower()]["tone"]
    assert tone is not None
    assert tone["frequency_hz"] == pytest.approx(7.30, abs=0.02)
    assert tone["amplitude_mps2"] == pytest.approx(INJECTED_MPS2[tip], rel=0.03)


@pytest.mark.parametrize("tip", INJECTED_MPS2)
def test_the_phase_is_that_of_the_raw_accelerometer(
    flight: StationAnalysis, onboard: DataflashLog, tip: Station
) -> None:
    """The filter of 20 Hz turns 7.3 Hz by 31 degrees, and cut stamps by another 1.3: both must be undone."""
    raw_ns, raw = raw_accelerometer(onboard, int(tip))
    off_deg = [
        abs(np.degrees(wrapped(tone.phase_rad - raw_phase(raw_ns, raw[:, 2], tone)))) for tone in flight.tones[tip]
    ]
    assert len(off_deg) > 80
    assert np.median(off_deg) < 1.5
    assert np.percentile(off_deg, 95) < 3.0


@pytest.mark.parametrize("tip", INJECTED_MPS2)
def test_the_amplitude_is_that_of_the_raw_accelerometer(
    flight: StationAnalysis, onboard: DataflashLog, tip: Station
) -> None:
    raw_ns, raw = raw_accelerometer(onboard, int(tip))
    ratios = [tone.amplitude_mps2 / raw_sine(raw_ns, raw[:, 2], tone)[0] for tone in flight.tones[tip]]
    assert np.median(ratios) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("name", ["flight.tlog", "flight.BIN"])
def test_two_logs_of_one_flight_agree_on_the_wing(name: str) -> None:
    """One is filtered and sent at 333 Hz, the other raw at 1 kHz; the sines are at 7.296 to 7.314 Hz in both."""
    recording = open_recording(RECORDINGS / name, load_airframe("sitl-plane"))
    outputs = drive(foreign_inputs(recording.records()), recording.airframe, recording.settings, recording.hub)
    states = [output for output in outputs if isinstance(output, ModeState)]
    states = [state for state in states if state.t_host_ns - states[0].t_host_ns > LEARNED_NS]
    assert sum(state.validity is Validity.TRACKING for state in states) > 0.95 * len(states)
    off_sigmas = []
    for state in states:
        modes = [mode for mode in (state.symmetric, state.antisymmetric) if mode.rms_m > CLEAR_M]
        assert modes, "one of both swings at any time"
        for mode in modes:
            off_sigmas.append(abs(mode.frequency_hz - 7.305) / max(0.05 / 3.0, mode.frequency_sigma_hz))
            assert mode.frequency_sigma_hz < 0.08
            # a sine that is switched strikes the gates: the filter then knows less, but more than the swing itself
            assert mode.amplitude_sigma_m < math.sqrt(2.0) * mode.rms_m
    assert np.mean(np.array(off_sigmas) < 3.0) > 0.99, "as of a Gaussian, though a fit counts as often as it is used"
    assert max(off_sigmas) < 4.0, "the fit behind a switch of the sines too"
    sigmas_m = [mode.amplitude_sigma_m for state in states for mode in (state.symmetric, state.antisymmetric)]
    assert np.median(sigmas_m) < 0.5 * CLEAR_M


@pytest.mark.parametrize("name", QUIET)
def test_where_no_mode_is_none_is_named(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """On the ground and in still air: no frequency, no phase, no mode tracked, and the exit code says so."""
    code = main(["replay", str(RECORDINGS / name), "--airframe", "sitl-plane", "--json"])
    result = json.loads(capsys.readouterr().out)
    assert code == NOTHING_FOUND
    assert [entry["tone"] for entry in result["stations"].values()] == [None, None, None]
    assert all("no steady tone" in entry["text"] for entry in result["stations"].values())
    assert result["wing"]["symmetric"] is None
    assert result["wing"]["antisymmetric"] is None
    assert "tracking" not in result["wing"]["validity"]
    assert result["ranges"]["trusted"] == 0


@pytest.mark.parametrize("name", QUIET)
def test_no_station_of_a_quiet_recording_has_a_tone(name: str) -> None:
    result = analysed(name).result()
    assert len(result) == 3
    assert [entry["tone"] for entry in result.values()] == [None, None, None]
    assert all(entry["windows"] > 20 for entry in result.values())


def test_without_a_mode_no_shot_waits_for_a_peak() -> None:
    """With cameras on that wing the planner is asked; it may use the timer, but never a peak that is not there."""
    plane, eyes = load_airframe("sitl-plane"), load_airframe("nadir-2m")
    plane = dataclasses.replace(plane, left_camera=eyes.left_camera, right_camera=eyes.right_camera)
    recording = open_recording(RECORDINGS / "flight_clean.tlog", plane)
    outputs = drive(foreign_inputs(recording.records()), plane, recording.settings, recording.hub)
    plans = [output for output in outputs if isinstance(output, TriggerPlan)]
    assert plans
    assert all(plan.firing is not Firing.PEAK for plan in plans)


def wrapped(angle_rad: float) -> float:
    return float(np.angle(np.exp(1j * angle_rad)))


def raw_phase(t_ns: np.ndarray, z: np.ndarray, tone: ToneEstimate) -> float:
    return raw_sine(t_ns, z, tone)[1]


def raw_sine(t_ns: np.ndarray, z: np.ndarray, tone: ToneEstimate) -> tuple[float, float]:
    """Amplitude and phase at the tone's instant of its frequency in the raw samples of the same window."""
    first, last = np.searchsorted(t_ns, tone.t_ns + np.array([-1, 1]) * round(WINDOW_S * 0.5e9))
    t_s = (t_ns[first:last] - tone.t_ns) * 1e-9
    assert len(t_s) > 700 * WINDOW_S
    angle = 2 * np.pi * tone.frequency_hz * t_s
    basis = np.column_stack([np.cos(angle), np.sin(angle), np.ones_like(t_s), t_s])
    cosine, sine, *_ = np.linalg.lstsq(basis, z[first:last], rcond=None)[0]
    return float(np.hypot(cosine, sine)), float(np.arctan2(-sine, cosine))
