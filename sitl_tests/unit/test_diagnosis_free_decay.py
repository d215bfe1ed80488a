"""A structure that decays after impulses: the filter against closed forms, causes hidden by another integrator."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from companion.diagnosis.free_decay import kalman
from companion.diagnosis.free_decay.adequacy import Whitened, judged
from companion.diagnosis.free_decay.json_report import as_json
from companion.diagnosis.free_decay.kalman import Modes, run
from companion.diagnosis.free_decay.laws import Law, laws_for
from companion.diagnosis.free_decay.likelihood import filter_all
from companion.diagnosis.free_decay.model import FreeDecayModel, key_of
from companion.diagnosis.free_decay.record import FreeDecay, RawFreeDecay, prepare
from companion.diagnosis.free_decay.recordings import FreeDecays, diagnose
from companion.diagnosis.free_decay.views import backbone
from companion.errors import RecordingError
from companion.params.airframe import Uncertain
from companion.records import Floats
from sitl_tests.reference.kernels.decay import filter_batch

RATE_HZ = 1500.0
BAND_HZ = (4.0, 14.0)
BELIEF = (Uncertain(9.0, 2.0), Uncertain(0.02, 0.02))


def rung(seed: int, frequency_hz: Floats, zeta: float, channel: Floats, second_hz: float = 0.0) -> RawFreeDecay:
    """A mode of any frequency over time, knocked by bursts of noise; exact steps of 1/1500 s."""
    rng = np.random.default_rng(seed)
    count = len(frequency_hz)
    load = np.zeros(count)
    for at in rng.choice(np.arange(200, count - 2000), 9, replace=False):
        load[at : at + 30] += rng.normal(0.0, 40.0, 30)
    up = _swing(2.0 * np.pi * frequency_hz, zeta, load) + load
    if second_hz:
        up += 0.5 * _swing(np.full(count, 2.0 * np.pi * second_hz), zeta, load)
    t_s = np.arange(count) / RATE_HZ
    return RawFreeDecay(f"run{seed}", t_s, up + rng.normal(0.0, 0.02, count), {"stand_m": channel})


def _swing(omega: Floats, zeta: float, load: Floats) -> Floats:
    """Acceleration without load by a velocity Verlet integrator with substeps, which shares nothing with the filter."""
    q, v, step = 0.0, 0.0, 1.0 / (4.0 * RATE_HZ)
    acceleration = np.empty(len(load))
    for k in range(len(load)):
        for _ in range(4):
            v += 0.5 * step * (load[k] - omega[k] ** 2 * q - 2.0 * zeta * omega[k] * v)
            q += step * v
            v += 0.5 * step * (load[k] - omega[k] ** 2 * q - 2.0 * zeta * omega[k] * v)
        acceleration[k] = -(omega[k] ** 2) * q - 2.0 * zeta * omega[k] * v
    return acceleration


def steps_of(seed: int, seconds: float) -> Floats:
    """A channel that stands still at random places."""
    rng = np.random.default_rng(seed)
    places = np.repeat(rng.uniform(0.1, 0.5, int(seconds)), int(RATE_HZ))
    return np.convolve(np.pad(places, 150, mode="edge"), np.ones(301) / 301, mode="valid")


@pytest.mark.parametrize("zeta", [0.002, 0.05, 0.3])
def test_a_step_of_the_filter_is_the_exact_one(zeta: float) -> None:
    omega, step_s = np.array([[[55.0], [71.0]]]), 1.0 / 40.0
    modes = Modes(omega, np.full_like(omega, zeta), np.full_like(omega, 3.0), np.ones((1, 2)), np.ones(1), np.ones(1))
    steps = kalman.matrices(modes, step_s)
    for t, w in enumerate(omega[0, :, 0]):
        flow = np.array([[0.0, 63.0], [-(w**2) / 63.0, -2.0 * zeta * w]])  # the reference is the mean
        np.testing.assert_allclose(steps.transition[t, 0, :2, :2], expm(flow * step_s), atol=1e-12)
        # Van Loan: the spread of white load from one matrix exponential
        both = np.zeros((4, 4))
        both[:2, :2], both[2:, 2:], both[1, 3] = -flow, flow.T, 3.0
        exponential = expm(both * step_s)
        spread = exponential[2:, 2:].T @ exponential[:2, 2:]
        np.testing.assert_allclose(steps.process_noise[t, 0, :2, :2], spread, rtol=1e-9)
        # a sample is the mean acceleration of its step: (v after - v before) / step
        np.testing.assert_allclose(steps.H[t, 0, :2], (expm(flow * step_s) - np.eye(2))[1] / step_s, atol=1e-9)
        np.testing.assert_allclose(steps.cross_covariance[t, 0, :2], spread[:, 1] / step_s, rtol=1e-9)
        assert steps.variance[t, 0] == pytest.approx(spread[1, 1] / step_s**2 + 1.0)


@pytest.mark.slow
def test_the_compiled_sweep_and_numpy_s_give_the_same() -> None:
    rng = np.random.default_rng(3)
    modes = Modes(
        rng.uniform(40.0, 90.0, (4, 60, 2)),
        np.full((4, 60, 2), 0.02),
        rng.uniform(0.1, 1.0, (4, 60, 2)),
        np.ones((4, 60)),
        np.full(4, 2.0),
        np.full(4, 0.1),
    )
    steps = kalman.matrices(modes, 0.025)
    y = rng.standard_normal((60, 4))
    compiled, expected = ((np.empty((60, 4)), np.empty((60, 4)), np.empty((60, 4, 5))) for _ in range(2))
    kalman._filter(kalman._pack_steps(steps), y, *compiled)
    filter_batch(steps, y, *expected)
    for swept, other in zip(compiled, expected, strict=True):
        np.testing.assert_allclose(swept, other, rtol=1e-7, atol=1e-9)


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(st.floats(20.0, 100.0), st.floats(0.005, 0.2), st.integers(0, 1000))
def test_innovations_of_the_filter_s_own_data_are_white_and_of_unit_size(omega: float, zeta: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    steps = 2000
    shape = (1, steps, 1)
    noise = np.full((1, steps), 0.5)
    modes = Modes(np.full(shape, omega), np.full(shape, zeta), np.full(shape, 2.0), noise, np.ones(1), np.full(1, 0.3))
    step = kalman.matrices(modes, 0.02)
    root = np.linalg.cholesky(step.process_noise[0, 0])
    x, y = np.array([0.5, -0.5, 3.0]), np.empty((1, steps))
    for t in range(steps):
        after = step.transition[t, 0] @ x + root @ rng.standard_normal(3)
        y[0, t] = (after[1] - x[1]) / 0.02 + x[2] + rng.normal(0.0, np.sqrt(0.5))
        x = after
    filtered = run(modes, y, 0.02)
    white = filtered.innovation[0, 50:] / np.sqrt(filtered.variance[0, 50:])
    z = judged(Whitened(white, np.ones(white.size, dtype=np.bool_)), rng)
    assert max(abs(value) for value in z.values()) < 5.5, z


def test_the_filter_follows_a_decay_from_its_third_sample_on() -> None:
    omega, step_s, count = 56.5, 1.0 / 42.0, 40
    flow = expm(np.array([[0.0, 1.0], [-(omega**2), -2.0 * 0.01 * omega]]) * step_s)
    states = [np.array([0.002, -0.05])]
    for _ in range(count):
        states.append(flow @ states[-1])
    y = np.diff([state[1] for state in states])[None, :] / step_s + 0.7
    shape = (1, count, 1)
    noise = np.full((1, count), 1e-8)
    modes = Modes(
        np.full(shape, omega), np.full(shape, 0.01), np.full(shape, 1e-12), noise, np.full(1, 50.0), np.zeros(1)
    )
    filtered = run(modes, y, step_s)
    assert np.max(np.abs(filtered.innovation[0, 3:])) < 1e-3 * np.max(np.abs(y))


def test_what_vibrates_is_no_cause_and_gaps_are_cut_out() -> None:
    count = int(6 * RATE_HZ)
    t_s = np.arange(count) / RATE_HZ
    up = np.sin(2.0 * np.pi * 9.0 * t_s)
    raw = RawFreeDecay("one", t_s, up, {"gauge_v": 0.1 * up + 0.01 * t_s, "stand_m": t_s})
    (decay,), scales = prepare([raw], BAND_HZ)
    assert list(scales) == ["stand_m"]
    assert any("gauge_v vibrates" in note for note in decay.notes)
    assert decay.rate_hz == pytest.approx(3.0 * BAND_HZ[1], rel=0.01)
    np.testing.assert_allclose(decay.up_mps2[20:-20], np.sin(2.0 * np.pi * 9.0 * decay.t_s[20:-20]), atol=0.02)
    late = np.concatenate([t_s[:4000], t_s[4000:] + 0.5])
    (cut,), _ = prepare([RawFreeDecay("two", late, up, {})], BAND_HZ)
    assert cut.t_s[-1] == pytest.approx((count - 4000) / RATE_HZ, abs=0.25)
    with pytest.raises(
        RecordingError, match="sampled at 100 Hz; to see impulses above a band up to 14 Hz it takes 140"
    ):
        prepare([RawFreeDecay("slow", np.arange(600) / 100.0, np.zeros(600), {})], BAND_HZ)


def test_a_recording_too_short_for_a_low_band_is_refused() -> None:
    """Nothing of 2.5 s at up to 2 Hz was left between the ends that are dropped, and ten samples of 4 s."""
    band_hz = (0.6, 2.0)

    def rung_for(seconds: float) -> RawFreeDecay:
        t_s = np.arange(int(500 * seconds)) / 500.0
        return RawFreeDecay("low", t_s, np.exp(-0.2 * t_s) * np.cos(2.0 * np.pi * 1.2 * t_s), {})

    with pytest.raises(RecordingError, match=r"low: .* is 2\.5 s; for a band up to 2 Hz 7\.7 s are needed"):
        prepare([rung_for(2.5)], band_hz)
    (decay,), _ = prepare([rung_for(7.7)], band_hz)
    assert len(decay.t_s) >= 10 * decay.rate_hz / band_hz[1]


def test_a_law_says_whether_it_follows_the_amplitude() -> None:
    """Whatever its parameter is called."""
    t_s = np.linspace(0.0, 9.0, 50)
    record = FreeDecay("run", 5.0, t_s, t_s, t_s, t_s, {"stand_m": t_s}, np.exp(-t_s))
    larger = dataclasses.replace(record, amplitude=2.0 * record.amplitude)
    laws = [entry for entry in laws_for(["stand_m"]) if isinstance(entry, Law)]
    for law in laws:
        follows = not np.array_equal(law.basis(record), law.basis(larger))
        assert dataclasses.replace(law, parameter="size").by_amplitude == follows
    assert {law.by_amplitude for law in laws} == {False, True}


def test_a_recording_is_followed_beside_a_longer_one_as_it_is_alone() -> None:
    """The frequency follows a channel; the deflection's reference was a mean frequency beyond the recording's end."""
    rng = np.random.default_rng(22)

    def recorded(count: int) -> FreeDecay:
        still, ramp = np.zeros(count), np.linspace(-1.0, 1.0, count)
        t_s = np.arange(count) / 42.0
        return FreeDecay("run", 42.0, t_s, rng.standard_normal(count), still, still, {"stand_m": ramp}, still)

    short, long = recorded(100), recorded(300)
    law = next(law for law in laws_for(["stand_m"]) if law.effect == "covariate-frequency")
    states = []
    for recordings in ([short], [short, long]):
        model = FreeDecayModel(recordings, *BELIEF, [law])
        values = model.centres
        values[model.index(key_of(law))] = 0.2
        states.append(filter_all(model, [values[None, :]] * len(recordings))[0].state)
    np.testing.assert_allclose(states[1], states[0], rtol=1e-9, atol=1e-12)


def test_windows_tell_frequency_and_damping_of_a_decay() -> None:
    t_s = np.arange(400) / 40.0
    decay = np.exp(-0.01 * 2.0 * np.pi * 9.0 * t_s) * np.cos(2.0 * np.pi * 9.0 * t_s)
    track = backbone(
        FreeDecay("decay", 40.0, t_s, decay, np.where(t_s < 0.1, 1.0, 0.0), np.zeros(400), {}, np.abs(decay))
    )
    early = track.t_s < 3.0
    np.testing.assert_allclose(track.frequency_hz[early], 9.0, atol=0.05)
    np.testing.assert_allclose(np.median(track.damping[early]), 0.01, rtol=0.1)


def test_windows_of_a_slow_structure_hold_a_period_and_a_half() -> None:
    """Windows of 0.3 s had no sample at 1.5 Hz, and the page of such a decay ended in a traceback."""
    t_s = np.arange(600) / 1.5
    decay = np.exp(-0.01 * 2.0 * np.pi * 0.3 * t_s) * np.cos(2.0 * np.pi * 0.3 * t_s)
    still = np.zeros(600)
    track = backbone(FreeDecay("slow", 1.5, t_s, decay, np.where(t_s < 3.0, 1.0, 0.0), still, {}, np.abs(decay)))
    assert track.length_s == pytest.approx(5.0, rel=0.01)
    np.testing.assert_allclose(np.median(track.frequency_hz), 0.3, rtol=0.1)


def diagnosed(raws: list[RawFreeDecay], most: int = 3) -> dict[str, object]:
    recordings, scales = prepare(raws, BAND_HZ)
    return as_json(diagnose(recordings, *BELIEF, BAND_HZ, most), scales, None)


@pytest.mark.long
def test_a_frequency_that_follows_a_channel_far_is_named_and_a_drift_is_not() -> None:
    raws = []
    for seed in (1, 2):
        channel = steps_of(seed, 14.0)
        raws.append(rung(seed, 9.0 * (1.0 + 0.7 * (channel - 0.3)), 0.01, channel))
    plain = diagnosed(raws)
    cause = plain["causes"][0]  # type: ignore[index]
    assert (cause["name"], cause["channel"]) == ("covariate-frequency", "stand_m")
    rms = cause["parameters"]["channel_rms"]["value"]
    mean = cause["parameters"]["channel_mean"]["value"]
    at_mean = 9.0 * (1.0 + 0.7 * (mean - 0.3))
    low, high = cause["parameters"]["ratio_per_rms"]["interval"]
    assert low - 0.002 < 9.0 * 0.7 * rms / at_mean < high + 0.002
    assert cause["gain"]["share_of_square_gone"] > 0.8
    assert "frequency-drift" not in [entry["name"] for entry in plain["causes"]]  # type: ignore[union-attr]


def test_the_amplitude_is_that_of_the_deflection_from_the_first_sample_on() -> None:
    omega, zeta, count = 2.0 * np.pi * 9.0, 0.02, 120
    t_s = (np.arange(count) + 0.5) / 42.0
    mode = np.exp((-zeta + 1j * np.sqrt(1.0 - zeta**2)) * omega * t_s)
    rng = np.random.default_rng(21)
    up = (-(omega**2) * 0.002 * mode).real + rng.normal(0.0, 1e-3, count)
    still = np.zeros(count)
    decays = FreeDecays([FreeDecay("one", 42.0, t_s, up, still, still, {}, np.ones(count))], *BELIEF, BAND_HZ)
    (record,) = decays.null().state.recordings
    np.testing.assert_allclose(record.amplitude * record.rms_m, 0.002 * np.abs(mode), rtol=0.02)


@pytest.mark.long
def test_a_drift_is_named_where_the_channel_has_nothing_to_do_with_it() -> None:
    raws = []
    for seed in (3, 4):
        t_s = np.arange(int(14 * RATE_HZ)) / RATE_HZ
        raws.append(rung(seed, 9.0 * (1.0 + 0.6 * (t_s - 7.0) / 60.0), 0.01, steps_of(seed, 14.0)))
    plain = diagnosed(raws, 2)
    cause = plain["causes"][0]  # type: ignore[index]
    assert cause["name"] == "frequency-drift"
    assert cause["parameters"]["ratio_per_min"]["value"] == pytest.approx(0.6, abs=0.03)


@pytest.mark.long
def test_a_close_second_mode_is_named_with_its_frequency() -> None:
    raws = []
    for seed in (5, 6):
        channel = steps_of(seed, 14.0)
        raws.append(rung(seed, np.full(len(channel), 9.0), 0.008, channel, second_hz=9.8))
    plain = diagnosed(raws, 2)
    cause = plain["causes"][0]  # type: ignore[index]
    assert cause["name"] == "close-mode"
    shown = sorted(plain["modes"]["in_the_last_decay"][0]["frequency_hz"])  # type: ignore[index]
    np.testing.assert_allclose(shown, [9.0, 9.8], atol=0.05)


@pytest.mark.long
@pytest.mark.parametrize("seed", [11, 13, 15])
def test_nothing_is_named_where_nothing_is_hidden(seed: int) -> None:
    raws = []
    for k in (seed, seed + 1):
        channel = steps_of(k, 14.0)
        raws.append(rung(k, np.full(len(channel), 8.3), 0.012, channel))
    plain = diagnosed(raws, 2)
    assert plain["causes"] == []
