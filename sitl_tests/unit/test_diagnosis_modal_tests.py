"""Runs of a vibration test: modes from synthetic responses, and whether the runs can tell why a frequency changed."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from companion.diagnosis.modal_tests.frequency_changes import disagreement
from companion.diagnosis.modal_tests.json_report import as_json
from companion.diagnosis.modal_tests.recordings import diagnose_modal_test
from companion.diagnosis.modal_tests.vibration import (
    ModeOfRun,
    ModeOverRuns,
    VibrationRun,
    mode_of,
    modes_of_runs,
    responses,
)
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.errors import RecordingError
from companion.evaluation.pages import measured_pages
from companion.records import Floats
from companion.reporting.blocks import Table

F_HZ: Floats = np.arange(5.0, 20.0, 1.0 / 60.0)
NOISE = 0.05
MOVED_HZ = [9.2, 9.3, 9.4, 9.2, 9.4, 9.3]
POSITIONS_M = [0.0, 1.0, 2.0, 0.0, 2.0, 1.0]


def run_of(seed: int, natural_hz: float, zeta: float = 0.008, **constants: float) -> VibrationRun:
    """Two points on a wing with a mode at ``natural_hz`` and one that stays at 15 Hz."""
    rng = np.random.default_rng(seed)
    response = np.zeros((2, F_HZ.size), dtype=np.complex128)
    for f_n, shape in ((natural_hz, (0.05, 0.03)), (15.0, (0.04, -0.02))):
        flexibility = -(F_HZ**2) / (f_n**2 - F_HZ**2 + 2j * zeta * f_n * F_HZ)
        response += np.array(shape)[:, None] * flexibility
    response += NOISE / np.sqrt(2.0) * (rng.normal(size=response.shape) + 1j * rng.normal(size=response.shape))
    return VibrationRun(str(seed), F_HZ, response, constants)


def test_modes_come_back_with_honest_sigmas() -> None:
    modes = [mode_of(run_of(seed, 9.2), 9.3) for seed in range(25)]
    off = np.array([(mode.frequency_hz - 9.2) / mode.frequency_sigma_hz for mode in modes])
    assert 0.7 < off.std() < 1.4
    assert abs(off.mean()) < 0.6
    assert np.mean([mode.damping for mode in modes]) == pytest.approx(0.008, rel=0.1)


def test_responses_of_a_whole_record_are_the_ratio_of_its_transforms() -> None:
    rng = np.random.default_rng(1)
    force = rng.standard_normal(4000)
    late = np.roll(force, 3)
    f_hz, response = responses(force, np.stack([2.0 * force, late], 1), 200.0, (5.0, 50.0))
    np.testing.assert_allclose(response[0], 2.0, atol=1e-9)
    np.testing.assert_allclose(response[1], np.exp(-2j * np.pi * f_hz * 3 / 200.0), atol=1e-9)


def swept(seconds: float, seed: int) -> VibrationRun:
    """One accelerometer at 200 Hz with modes at 6 and 11 Hz, under a sweep that has no force at its ends."""
    count = int(200.0 * seconds)
    rng, t_s, f_hz = np.random.default_rng(seed), np.arange(count) / 200.0, np.fft.rfftfreq(count, 1.0 / 200.0)
    force = np.sin(2.0 * np.pi * (t_s + 14.5 / seconds * t_s**2)) * np.hanning(count)
    flexibility = sum(-(f_hz**2) / (f_n**2 - f_hz**2 + 0.04j * f_n * f_hz) for f_n in (6.0, 11.0))
    answer = np.fft.irfft(flexibility * np.fft.rfft(force), count) + 0.05 * rng.standard_normal(count)
    return VibrationRun(str(seed), *responses(force, answer[:, None], 200.0, (2.0, 28.0)))


def test_a_record_too_short_for_a_fit_is_refused_with_the_lines_that_are_needed() -> None:
    for seconds in (3.0, 4.0):
        with pytest.raises(RecordingError, match=r"record longer: \d lines .* peak at .* Hz, 5 are needed"):
            modes_of_runs([swept(seconds, seed) for seed in range(3)])
    with pytest.raises(RecordingError, match="6 lines of the spectrum lie in band_hz, 7 are needed"):
        modes_of_runs([VibrationRun("a", F_HZ[:6], np.ones((1, 6), dtype=np.complex128))])


def test_a_peak_where_there_was_no_force_is_no_mode() -> None:
    modes, notes = modes_of_runs([swept(60.0, 100 + k) for k in range(4)])
    assert [mode.near_hz for mode in modes] == pytest.approx([6.0, 11.0], abs=0.01)
    assert any("is no mode" in note for note in notes)


def judge(frequencies: list[float], positions: list[float]) -> tuple[DiagnosisVerdict, dict[str, object]]:
    runs = [run_of(k + 1, f, position_m=x) for k, (f, x) in enumerate(zip(frequencies, positions, strict=True))]
    diagnosis = diagnose_modal_test(modes_of_runs(runs)[0], [run.constants for run in runs], lambda _what, _ratio: None)
    return diagnosis.outcome.verdict, as_json(diagnosis, [run.name for run in runs], None)


def test_equal_runs_are_adequate() -> None:
    verdict, plain = judge([9.2] * 6, [0.0, 1.0, 2.0, 0.0, 1.0, 2.0])
    assert verdict is DiagnosisVerdict.ADEQUATE
    assert plain["causes"] == []


@pytest.mark.parametrize(
    ("frequencies_hz", "sigma_hz", "reason"),
    [
        ([9.2, 9.4, 9.3], 0.2, "the frequencies differ between 3 runs by 2.2 % at most, no more than by chance"),
        ([9.2, 9.201, 9.2], 1e-5, "every frequency is the same in all 3 runs, to 0.2 %"),
    ],
)
def test_frequencies_that_differ_by_chance_are_not_called_the_same(
    frequencies_hz: list[float], sigma_hz: float, reason: str
) -> None:
    """Runs whose frequencies were 2 % apart, with sigmas as large, were 'the same to 0.2 %'."""
    mode = ModeOverRuns(("1", "2", "3"), tuple(ModeOfRun(f_hz, sigma_hz, 0.01, 0.001, 0.1) for f_hz in frequencies_hz))
    diagnosis = diagnose_modal_test([mode], [{}, {}, {}], lambda _what, _ratio: None)
    assert as_json(diagnosis, ["1", "2", "3"], None)["reason"] == reason


def test_a_single_run_is_not_identifiable() -> None:
    verdict, plain = judge([9.2], [0.0])
    assert verdict is DiagnosisVerdict.NOT_IDENTIFIABLE
    assert plain["reason"] == "one run has nothing to be compared with"
    assert plain["advice"] == ["measure further runs, and write down what differs between them"]


def test_a_change_that_goes_hand_in_hand_with_run_order_has_no_identifiable_cause() -> None:
    verdict, plain = judge([9.2, 9.2, 9.2, 9.3, 9.4, 9.5], [0.0, 1.0, 2.0, -1.0, -2.0, -3.0])
    assert verdict is DiagnosisVerdict.NOT_IDENTIFIABLE
    assert plain["causes"] == []
    assert plain["confounded"] == ["run_order", "position_m"]
    reason = str(plain["reason"])
    assert "changed between runs 3 and 6 (9.20 -> 9.50 Hz)" in reason
    assert "not identifiable: run order and position are confounded" in reason
    assert any("measure once more with the position of run 1 after run 6" in line for line in plain["advice"])  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("frequencies", "positions"),
    [([9.2, 9.2, 9.2, 9.0], [0.0, 1.0, 0.0, 2.0]), ([9.2] * 4 + [9.0] * 3, [0.0, 1.0, 0.0, 1.0, 2.0, 2.1, 2.2])],
)
def test_positions_that_came_back_before_the_change_do_not_tell_its_cause(
    frequencies: list[float], positions: list[float]
) -> None:
    verdict, plain = judge(frequencies, positions)
    assert verdict is DiagnosisVerdict.NOT_IDENTIFIABLE
    assert plain["causes"] == []
    assert "for no position was measured again after the change" in str(plain["reason"])


def test_the_same_change_is_explained_where_positions_came_back_with_their_frequency() -> None:
    verdict, plain = judge(MOVED_HZ, POSITIONS_M)
    assert verdict is DiagnosisVerdict.EXPLAINED
    (cause,) = plain["causes"]  # type: ignore[misc]
    assert (cause["name"], cause["channel"]) == ("covariate-frequency", "position_m")
    # a run is foretold by the other one of its position: to the noise of both, where 0.1 Hz lay between positions
    assert cause["gain"]["before"] > 0.05
    assert cause["gain"]["after"] < 0.005


def test_a_mode_that_stays_has_the_inverse_variance_mean_of_its_runs_as_frequency() -> None:
    modes, _ = modes_of_runs([run_of(k, 9.2, position_m=0.0) for k in range(4)])
    fitted = diagnose_modal_test(modes, [{"position_m": 0.0}] * 4, lambda _what, _ratio: None).outcome.final
    mode = modes[0]
    weight = mode.sigma_hz**-2
    value, sigma = fitted.value(fitted.keys[0])
    assert value == pytest.approx(np.average(mode.frequency_hz, weights=weight), abs=1e-6)
    assert sigma == pytest.approx(weight.sum() ** -0.5, rel=1e-3)


def test_responses_without_a_peak_are_refused_with_what_to_check() -> None:
    with pytest.raises(RecordingError, match="no mode stands out of the responses: check 'band_hz'"):
        diagnose_modal_test([], [], lambda _what, _ratio: None)


def test_where_positions_came_back_and_the_frequency_did_not_nothing_is_named() -> None:
    verdict, plain = judge([9.2, 9.2, 9.2, 9.3, 9.4, 9.5], [0.0, 1.0, 2.0, 0.0, 1.0, 2.0])
    assert verdict is DiagnosisVerdict.UNEXPLAINED
    assert plain["causes"] == []


def test_a_second_mode_that_does_not_follow_the_channel_is_left_over() -> None:
    runs = [run_of(k, f, position_m=x) for k, (f, x) in enumerate(zip(MOVED_HZ, POSITIONS_M, strict=True), 1)]
    modes, _ = modes_of_runs(runs)
    drifting = ModeOverRuns(modes[1].runs, tuple(
        dataclasses.replace(mode, frequency_hz=mode.frequency_hz + 0.05 * k) for k, mode in enumerate(modes[1].of_runs)
    ))  # fmt: skip
    diagnosis = diagnose_modal_test([modes[0], drifting], [run.constants for run in runs], lambda _what, _ratio: None)
    assert diagnosis.outcome.verdict is DiagnosisVerdict.UNEXPLAINED
    plain = as_json(diagnosis, ["a"], None)
    assert "position goes with it, but: left over: one frequency near 15" in plain["reason"]
    (note,) = plain["notes"]
    assert "the last that agrees with all before it, to run 6, which is furthest from these" in note
    heads = [block.heads for block in measured_pages._modes(plain) if isinstance(block, Table)]
    assert "change between these two runs" in heads[0], "lowest and highest are other runs than those of the note"


@pytest.mark.parametrize("count", [2, 5, 10])
def test_disagreement_is_a_standard_normal_where_all_agree(count: int) -> None:
    rng = np.random.default_rng(count)
    sigma = rng.uniform(0.5, 2.0, count)
    z = np.array([disagreement(sigma * rng.standard_normal(count), sigma) for _ in range(1000)])
    assert abs(z.mean()) < 0.15
    assert z.std() == pytest.approx(1.0, abs=0.1)


def test_what_was_not_noted_of_every_run_explains_nothing_and_stops_nothing() -> None:
    runs = [
        run_of(k + 1, f, **({} if k == 2 else {"position_m": x}))
        for k, (f, x) in enumerate(zip(MOVED_HZ, POSITIONS_M, strict=True))
    ]
    diagnosis = diagnose_modal_test(modes_of_runs(runs)[0], [run.constants for run in runs], lambda _what, _ratio: None)
    assert diagnosis.outcome.verdict is DiagnosisVerdict.UNEXPLAINED


def test_runs_of_equal_frequency_have_a_number_for_json() -> None:
    """It was minus infinity, which JSON has not."""
    assert math.isfinite(disagreement(np.full(3, 9.2), np.full(3, 0.01)))
