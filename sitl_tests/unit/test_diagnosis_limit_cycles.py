"""Self-excited vibration: a hardening oscillator with an onset, integrated here, and what the diagnosis says of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.special import ellipk

from companion.cli.main import main
from companion.diagnosis.limit_cycles.decays import force_curve
from companion.diagnosis.limit_cycles.json_report import as_json
from companion.diagnosis.limit_cycles.labels import doubtful_labels
from companion.diagnosis.limit_cycles.recordings import FlutterDiagnosis, diagnose_vibration
from companion.diagnosis.limit_cycles.small_damping import damping_over_airspeed
from companion.diagnosis.limit_cycles.tracks import RawVibration, VibrationTrack, track
from companion.errors import RecordingError
from companion.records import Floats

RATE_HZ, SECONDS = 250.0, 30.0
BAND_HZ = (1.5, 4.5)
REST_HZ, ONSET_MPS = 2.4, 17.0
CUBIC = 15.0  # 1/s^2 per squared unit
NEGATIVE, LIMITING = 0.08, 40.0  # damping per m/s above the onset, 1/s, and per squared unit


def motion(speeds: Floats, start: Floats, cubic: float = CUBIC, limiting: float = LIMITING) -> Floats:
    """Runge and Kutta, all recordings at once, (n, recordings)."""
    omega2 = (2.0 * np.pi * REST_HZ) ** 2

    def rate(state: Floats) -> Floats:
        q, v = state
        damper = (limiting * q**2 - NEGATIVE * (speeds - ONSET_MPS)) * v
        return np.stack([v, -omega2 * q - cubic * omega2 * q**3 - damper])

    state, shown, step = np.stack([start, 0.0 * start]), [], 1.0 / RATE_HZ
    for _ in range(int(SECONDS * RATE_HZ)):
        shown.append(state[0])
        k1 = rate(state)
        k2 = rate(state + 0.5 * step * k1)
        k3 = rate(state + 0.5 * step * k2)
        state = state + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rate(state + step * k3))
    return np.array(shown)


def tracks_of(
    speeds: Floats, start: Floats, seed: int, says: Floats | None = None, **law: float
) -> list[VibrationTrack]:
    rng = np.random.default_rng(seed)
    t_s = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    q = motion(speeds, start, **law)
    q = q + rng.normal(0.0, 3e-4, q.shape)
    labels = speeds if says is None else says
    return [
        track(RawVibration(f"run{k}", t_s, {"heave": q[:, k] + 3.5}, float(label)), BAND_HZ)
        for k, label in enumerate(labels)
    ]


def amplitude_of(speed_mps: Floats) -> Floats:
    """First-order averaging: the mean work of q^2 q' is A^2/4."""
    return np.sqrt(4.0 * NEGATIVE * (speed_mps - ONSET_MPS) / LIMITING)


def judged(tracks: list[VibrationTrack]) -> FlutterDiagnosis:
    return diagnose_vibration(tracks, 5, lambda _what, _ratio: None)


CYCLING = np.array([18.0, 18.5, 19.0, 19.5, 20.0, 21.0, 22.0])
GROWING = np.array([15.5, 16.0, 16.5, 17.5, 18.2])


@pytest.fixture(scope="module")
def rig() -> FlutterDiagnosis:
    tracks = tracks_of(CYCLING, amplitude_of(CYCLING), 1)
    return judged([*tracks, *tracks_of(GROWING, np.full(len(GROWING), 0.03), 2)])


def test_a_hardening_wing_s_limit_cycle_is_named(rig: FlutterDiagnosis) -> None:
    named = [cause["name"] for cause in as_json(rig)["causes"]]
    assert "cubic-stiffness" in named
    assert "limit-cycle" in named
    cycles = [row for row in rig.rows if row.cycle]
    assert len(cycles) >= len(CYCLING)
    for row in cycles:
        a = amplitude_of(np.array(row.airspeed_mps))
        assert row.amplitude[0] == pytest.approx(a, rel=0.03)
        e = CUBIC * a**2  # Duffing's oscillator in closed form
        exact_hz = REST_HZ * np.pi * np.sqrt(1.0 + e) / (2.0 * ellipk(0.5 * e / (1.0 + e)))
        assert row.frequency_hz == pytest.approx(exact_hz, rel=0.01)  # a third of the amplitude's 3 %


def test_an_airspeed_that_was_held_out_is_foretold(rig: FlutterDiagnosis) -> None:
    assert len(rig.held_out) >= len(CYCLING)
    for entry in rig.held_out:
        measured, predicted = entry.frequency_hz
        assert predicted == pytest.approx(measured, rel=0.01)
        assert entry.amplitude["heave"][1] == pytest.approx(entry.amplitude["heave"][0], rel=0.1)


def test_growth_and_decay_at_small_amplitude_tell_the_onset() -> None:
    diagnosis = judged(tracks_of(GROWING, np.full(len(GROWING), 0.03), 3))
    assert diagnosis.onset is not None
    assert abs(diagnosis.onset.airspeed_mps - ONSET_MPS) < 3.0 * diagnosis.onset.sigma_mps + 0.05
    assert diagnosis.onset.sigma_mps < 0.5


def test_the_airspeed_of_a_damping_ratio_is_as_good_as_its_sigma() -> None:
    rng, speeds = np.random.default_rng(31), np.repeat([14.0, 15.0, 16.0, 18.0], 6)
    a, off = rng.uniform(0.05, 0.3, 24), []
    for _ in range(400):
        errors = 1e-4 / a * rng.standard_normal(24)
        fitted = damping_over_airspeed(speeds, a, 0.004 * (17.0 - speeds) + 0.1 * a**2 + errors)
        at_mps, sigma_mps = fitted.airspeed_mps(0.004)
        off.append((at_mps - 16.0) / sigma_mps)
    assert np.std(off) == pytest.approx(1.0, abs=0.15)
    assert abs(np.mean(off)) < 0.2


@pytest.mark.slow
def test_a_wrong_airspeed_is_told_from_the_cycle_itself() -> None:
    says = CYCLING.copy()
    says[3] *= 10.0
    diagnosis = judged(tracks_of(CYCLING, amplitude_of(CYCLING), 4, says))
    (doubt,) = diagnosis.doubts
    assert doubt.name == "run3"
    assert doubt.implied_mps == pytest.approx(CYCLING[3], abs=0.3)
    assert judged(tracks_of(CYCLING, amplitude_of(CYCLING), 5)).doubts == ()


def settled(speeds: Floats, says: Floats, noise: float, seed: int) -> list[VibrationTrack]:
    """Cycles of A^2 = V^2 - 24.3^2, wrong by a ratio ``noise``."""
    a = np.sqrt(speeds**2 - 24.3**2) * (1.0 + noise * np.random.default_rng(seed).standard_normal(len(speeds)))
    ones = np.ones(4)
    return [
        VibrationTrack(f"run{k}", float(label), ones, ones, 0.0 * ones, {"heave": a[k] * ones}, ones > 0.0)
        for k, label in enumerate(says)
    ]


@pytest.mark.parametrize("count", [5, 6, 7, 8, 12])
def test_right_labels_of_few_cycles_stay(count: int) -> None:
    """Without noise, and with 2 %: of five to eight cycles one or the other was thrown out in up to 70 %."""
    speeds = np.linspace(25.0, 33.0, count)
    assert doubtful_labels(settled(speeds, speeds, 0.0, 0)) == ()
    for seed in range(10):
        assert doubtful_labels(settled(speeds, speeds, 0.02, seed)) == ()


def test_labels_of_still_air_are_not_doubted() -> None:
    """An airspeed sensor that is not connected reads 0 in every recording."""
    speeds = np.linspace(25.0, 33.0, 8)
    assert doubtful_labels(settled(speeds, 0.0 * speeds, 0.02, 0)) == ()


@pytest.mark.parametrize("which", [2, 4])
def test_a_wrong_label_alone_goes(which: int) -> None:
    speeds = np.linspace(25.0, 33.0, 8)
    says = speeds.copy()
    says[which] *= 1.25
    for seed in range(10):
        (doubt,) = doubtful_labels(settled(speeds, says, 0.02, seed))
        assert doubt.recording == which
        assert abs(doubt.implied_mps - speeds[which]) < 6.0 * doubt.sigma_mps


@pytest.mark.slow
@pytest.mark.parametrize(("which", "says"), [(0, 155.0), (1, 18.4), (3, 12.0)])
def test_a_wrong_airspeed_is_told_from_growth_and_decay(which: int, says: float) -> None:
    """Hammer tests below and above the onset, none of which settles on a limit cycle."""
    speeds = np.array([15.0, 15.5, 16.0, 16.5, 17.3])
    labels = speeds.copy()
    labels[which] = says
    start = np.full(len(speeds), 0.02)
    cycles = tracks_of(CYCLING[3:], amplitude_of(CYCLING[3:]), 10)
    judgement = judged([*tracks_of(speeds, start, 8, labels), *cycles])
    (doubt,) = judgement.doubts
    assert doubt.name == f"run{which}"
    assert abs(doubt.implied_mps - speeds[which]) < 3.0 * doubt.sigma_mps + 0.2
    assert judgement.onset is not None
    assert abs(judgement.onset.airspeed_mps - ONSET_MPS) < 3.0 * judgement.onset.sigma_mps + 0.1
    assert judged([*tracks_of(speeds, start, 9), *cycles]).doubts == ()


def test_a_decay_into_the_noise_leaves_nothing_over() -> None:
    """The error of a frequency goes with the inverse of the amplitude, down to the noise floor."""
    rng = np.random.default_rng(12)
    a = np.geomspace(1.0, 0.002, 60)
    tracks = [
        VibrationTrack(
            f"run{k}",
            None,
            np.arange(60.0),
            2.4 + 1e-4 / np.minimum(a, 0.3) * rng.standard_normal(60),
            -0.1 + 1e-3 / np.minimum(a, 0.3) * rng.standard_normal(60),
            {"heave": a},
            a > 2.0,
        )
        for k in range(4)
    ]
    plain = as_json(judged(tracks))
    assert plain["verdict"] == "adequate"
    assert not plain["notes"]


@pytest.mark.parametrize("says", [12.0, 0.0])
@pytest.mark.parametrize("count", [2, 4])
def test_a_spring_is_explained_at_one_airspeed(count: int, says: float) -> None:
    """Recordings are held out there, or windows of few: of one airspeed nothing was."""
    speeds = np.full(count, 12.0)
    tracks = tracks_of(speeds, np.linspace(0.2, 0.1, count), 13, np.full(count, says), limiting=0.0)
    plain = as_json(judged(tracks))
    assert "cubic-stiffness" in [cause["name"] for cause in plain["causes"]]
    assert plain["verdict"] == "explained", plain["reason"]


def test_a_linear_wing_that_decays_gets_no_name() -> None:
    speeds = np.array([12.0, 13.0, 14.0, 15.0, 16.0])
    diagnosis = judged(tracks_of(speeds, np.full(5, 0.1), 6, cubic=0.0, limiting=0.0))
    named = {cause["name"] for cause in as_json(diagnosis)["causes"]}
    assert named <= {"airspeed-dependence"}  # its damping does follow the airspeed
    assert not any(row.cycle for row in diagnosis.rows)


def test_a_decay_gives_the_spring_s_curve() -> None:
    (decay,) = tracks_of(np.array([12.0]), np.array([0.2]), 7, limiting=0.0)
    curve = force_curve(decay, "heave")
    assert curve is not None
    assert curve.omega_radps == pytest.approx(2.0 * np.pi * REST_HZ, rel=0.01)
    q = 0.15
    force = (2.0 * np.pi * REST_HZ) ** 2 * (q + CUBIC * q**3)
    assert np.interp(q, curve.deflection, curve.force) == pytest.approx(force, rel=0.05)


def test_two_amplitudes_give_no_spring() -> None:
    """Three coefficients ended in a traceback."""
    level = np.repeat([1.0, 0.5], 3)
    t_s, calm = np.arange(6.0), np.zeros(6, dtype=np.bool_)
    assert (
        force_curve(VibrationTrack("run", None, t_s, np.full(6, 3.0), -0.1 * calm, {"heave": level}, calm), "heave")
        is None
    )


def hopf(speeds: Floats, seed: int) -> list[VibrationTrack]:
    """Cycles of A^2 = V - 24 and a frequency that goes with A^2, wrong by 0.1 and 0.02 %."""
    rng, ones = np.random.default_rng(seed), np.ones(4)
    a = np.sqrt(speeds - 24.0) * (1.0 + 1e-3 * rng.standard_normal(len(speeds)))
    f_hz = 2.4 * np.sqrt(1.0 + 0.02 * a**2) * (1.0 + 2e-4 * rng.standard_normal(len(speeds)))
    return [
        VibrationTrack(f"run{k}", float(v), ones, f_hz[k] * ones, 0.0 * ones, {"heave": a[k] * ones}, ones > 0.0)
        for k, v in enumerate(speeds)
    ]


def test_a_cycle_close_to_the_onset_is_foretold() -> None:
    """A^2 is linear there. A cubic of logarithms missed it by 15 %."""
    speeds = np.array([24.5, 25.0, 26.0, 27.0, 28.0, 29.5, 31.0, 33.0])
    diagnosis = judged(hopf(speeds, 0))
    assert len(diagnosis.held_out) == len(speeds)
    for entry in diagnosis.held_out:
        measured, predicted = entry.amplitude["heave"]
        assert predicted == pytest.approx(measured, rel=0.02)


@pytest.mark.parametrize("seed", [1, 2])
def test_few_cycles_get_few_degrees(seed: int) -> None:
    """With a cubic through five cycles there was one to judge it by, and no cycle was named."""
    plain = as_json(judged(hopf(np.linspace(25.0, 33.0, 5), seed)))
    assert "limit-cycle" in {cause["name"] for cause in plain["causes"]}
    assert len(plain["held_out_speeds"]) == 5
    for entry in plain["held_out_speeds"]:
        assert abs(entry["amplitude"]["heave"]["relative_error"]) < 0.1


def test_a_cycle_below_the_onset_makes_it_subcritical(rig: FlutterDiagnosis) -> None:
    below = np.array([14.0, 14.5, 15.0, 15.5])
    ones = np.ones(4)
    cycles = [
        VibrationTrack(f"below{k}", v, ones, 2.5 * ones, 0.0 * ones, {"heave": a * ones}, ones > 0.0)
        for k, (v, a) in enumerate(zip(below.tolist(), [0.30, 0.31, 0.32, 0.33], strict=True))
    ]
    onset = as_json(judged([*tracks_of(GROWING, np.full(len(GROWING), 0.03), 3), *cycles]))["onset"]
    assert onset["cycles_from_mps"] == below[0]
    assert "subcritical" in onset["says"]
    assert as_json(rig)["onset"]["cycles_from_mps"] is None


@pytest.mark.parametrize("step", [0.0, 0.02])
def test_a_clipped_response_is_refused_and_coarse_steps_are_not(step: float) -> None:
    """A clipped cycle was named a wrong airspeed."""
    t_s = np.arange(3000) / RATE_HZ
    swing = np.sin(15.0 * t_s) + 1e-3 * np.random.default_rng(4).standard_normal(len(t_s))
    shown = np.round(swing / step) * step if step else swing
    assert track(RawVibration("whole", t_s, {"heave": shown}, None), BAND_HZ).steady.any()
    with pytest.raises(RecordingError, match="cut: heave piles up at its largest or smallest value"):
        track(RawVibration("cut", t_s, {"heave": np.clip(shown, -2.0, 0.8)}, None), BAND_HZ)


@pytest.mark.parametrize("step", [1e-3, 1e-2])
def test_a_pull_that_is_held_before_it_is_let_go_is_not_clipped(step: float) -> None:
    t_s = np.arange(3000) / RATE_HZ
    since = np.maximum(t_s - 2.0, 0.0)
    swing = np.exp(-0.3 * since) * np.cos(15.0 * since) + 1e-4 * np.random.default_rng(7).standard_normal(len(t_s))
    followed = track(RawVibration("pulled", t_s, {"heave": np.round(swing / step) * step}, None), BAND_HZ)
    assert np.median(followed.frequency_hz) == pytest.approx(15.0 / (2.0 * np.pi), rel=0.01)


def test_a_sine_without_noise_is_not_clipped() -> None:
    t_s = np.arange(3000) / RATE_HZ
    followed = track(RawVibration("sine", t_s, {"heave": np.sin(2.0 * np.pi * 2.5 * t_s)}, None), BAND_HZ)
    assert followed.steady.any()


def test_a_cycle_above_the_band_is_told() -> None:
    """Its rest at the edge of the band gave an onset that was 47 % too high."""
    t_s = np.arange(3000) / RATE_HZ
    with pytest.raises(RecordingError, match=r"limit cycle, at 5\.4\d Hz, lies above band_hz"):
        track(RawVibration("fast", t_s, {"heave": np.sin(34.2 * t_s) + 0.1 * np.sin(15.0 * t_s)}, None), BAND_HZ)


def test_a_decay_below_a_stronger_mode_is_followed() -> None:
    t_s = np.arange(3000) / RATE_HZ
    decays = np.exp(-0.3 * t_s) * (np.sin(15.0 * t_s) + 3.0 * np.sin(60.0 * t_s))
    followed = track(RawVibration("two", t_s, {"heave": decays}, None), BAND_HZ)
    assert np.median(followed.frequency_hz) == pytest.approx(15.0 / (2.0 * np.pi), rel=0.01)


def test_blows_during_a_linear_decay_are_no_law() -> None:
    """Windows beside a blow had its jump in their averages: cubic stiffness and quadratic damping were named."""
    t_s, tracks = np.arange(3500) / RATE_HZ, []
    for k, (blows, zeta) in enumerate((([0.7, 5.2, 9.8], 0.01), ([0.9, 4.7, 9.1], 0.01))):
        omega, swing = 2.0 * np.pi * 3.0, np.zeros(len(t_s))
        for j, at in enumerate(blows):
            since = np.maximum(t_s - at, 0.0)
            swing += (1.0 + 0.3 * (j - 1)) * np.exp(-zeta * omega * since) * np.sin(omega * since)
        swing += 1e-3 * np.random.default_rng(k).standard_normal(len(t_s))
        tracks.append(track(RawVibration(f"run{k}", t_s, {"heave": swing}, None), BAND_HZ))
    plain = as_json(judged(tracks))
    assert plain["verdict"] == "adequate", plain["reason"]
    assert np.median([value for entry in plain["decays"] for value in entry["damping"]]) == pytest.approx(
        0.01, rel=0.05
    )


@pytest.mark.parametrize("amplitudes", [(1.0,) * 2, (1.0, 0.5), (1.0,) * 9])
def test_constant_cycles_without_noise_are_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], amplitudes: tuple[float, ...]
) -> None:
    """Equal to the last digit they ended in a traceback."""
    t_s = np.arange(3000) / RATE_HZ
    (tmp_path / "rig.toml").write_text(
        'test = "limit-cycle"\nfiles = "*.csv"\nband_hz = [1.5, 4.5]\n[columns]\n'
        't = { channel = "t_s", unit = "s" }\nheave = { channel = "response_heave" }\n'
    )
    for k, amplitude in enumerate(amplitudes):
        table = np.stack([t_s, amplitude * np.sin(15.0 * t_s + k)], 1)  # no copies: those are refused
        np.savetxt(tmp_path / f"run{k}.csv", table, "%.15g", ",", header="t,heave", comments="")
    assert main(["diagnose", str(tmp_path), "--mapping", str(tmp_path / "rig.toml")]) == 0
    out = capsys.readouterr().out
    assert "verdict: unexplained (nearest: limit-cycle)" in out
    assert f"amplitudes stay constant in {len(amplitudes)} recordings, at 2.387 Hz" in out
    assert "record: the growth from rest up to it" in out


def test_a_recording_at_rest_and_a_dead_leader_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng, t_s = np.random.default_rng(5), np.arange(3000) / RATE_HZ
    decay = np.exp(-0.3 * t_s) * np.sin(15.0 * t_s)
    (tmp_path / "rig.toml").write_text(
        'test = "limit-cycle"\nfiles = "*.csv"\nband_hz = [1.5, 4.5]\n[columns]\n'
        't = { channel = "t_s", unit = "s" }\nheave = { channel = "response_heave" }\n'
    )
    for name, level in (("a.csv", 1.0), ("b.csv", 0.7), ("rest.csv", 0.0)):
        table = np.stack([t_s, level * decay + 1e-3 * rng.standard_normal(len(t_s))], 1)
        np.savetxt(tmp_path / name, table, "%.9g", ",", header="t,heave", comments="")
    assert main(["diagnose", str(tmp_path), "--mapping", str(tmp_path / "rig.toml")]) == 0
    assert "note: rest.csv: heave rises nowhere above its noise" in capsys.readouterr().out
    assert main(["diagnose", str(tmp_path / "rest.csv"), "--mapping", str(tmp_path / "rig.toml")]) == 1
    assert "in heave, the leading response" in capsys.readouterr().err


def test_two_windows_are_followed() -> None:
    """The fewest that are not refused as too short; they ended in a traceback."""
    t_s = np.arange(1000) / RATE_HZ
    swing = np.sin(2.0 * np.pi * 2.5 * t_s) + 1e-3 * np.random.default_rng(6).standard_normal(len(t_s))
    followed = track(RawVibration("brief", t_s, {"heave": swing}, None), BAND_HZ)
    assert followed.frequency_hz == pytest.approx([2.5, 2.5], rel=0.02)


def test_a_band_narrower_than_a_short_recording_tells_apart_is_refused() -> None:
    t_s = np.arange(5) / RATE_HZ
    with pytest.raises(RecordingError, match=r"brief: too short to tell a frequency from 1\.5 to 1\.6 Hz"):
        track(RawVibration("brief", t_s, {"heave": np.sin(15.0 * t_s)}, None), (1.5, 1.6))


def test_too_short_a_recording_says_so() -> None:
    t_s = np.arange(200) / RATE_HZ
    with pytest.raises(RecordingError, match="shorter than"):
        track(RawVibration("short", t_s, {"heave": np.sin(15.0 * t_s)}, None), BAND_HZ)


def test_a_blow_is_left_out_wherever_it_falls_between_windows() -> None:
    """In one place of forty the three points of its window lay on a line, and were a damping ratio of -0.5."""
    t_s, zeta = np.arange(0.0, 30.0, 1.0 / 200.0), 0.01
    pole = 2.0 * np.pi * 5.0 * (1j - zeta)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(t_s))
    for k in range(40):
        since_s = t_s - (12.0 + 0.01 * k)
        rings = 0.05 * np.exp(pole * t_s) + np.where(since_s >= 0.0, np.exp(pole * np.maximum(since_s, 0.0)), 0.0)
        followed = track(RawVibration("struck", t_s, {"heave": rings.real + noise}, 10.0), (2.0, 10.0))
        assert followed.growth_radps.max() < -0.5 * zeta * abs(pole)
