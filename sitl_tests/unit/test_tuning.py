"""Values tried on a recording: what counts as better, and what a replay with another value changes."""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path

import pytest

from companion.cli import tune
from companion.cli.main import main
from companion.errors import RecordingError
from companion.evaluation.tuning import ParameterTrial, TrialOutcome, scatter, try_out, usual_trials, verdict_of
from companion.params.files import load_airframe
from companion.params.settings import Settings, tunables
from companion.records import CorrectedRange, Shot
from companion.sim.flight.flight import build_flight
from sitl_tests.loop.simulated_service import SimulatedService

FLOWN = TrialOutcome(shots=200, skipped=20, ranges=180, trusted=150, sigma_ratio=0.01, scatter_ratio=0.9, delay_s=0.6)
S = 1_000_000_000


def like_flown(**changes: float) -> TrialOutcome:
    return dataclasses.replace(FLOWN, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("tried", "words"),
    [
        (like_flown(trusted=165), "more trusted ranges"),
        (like_flown(sigma_ratio=0.008), "smaller sigma"),
        (like_flown(delay_s=0.4), "earlier ranges"),
        (like_flown(delay_s=0.4, sigma_ratio=0.0101), "earlier ranges"),
    ],
)
def test_a_gain_without_a_loss_is_proposed(tried: TrialOutcome, words: str) -> None:
    assert verdict_of(FLOWN, tried) == (True, words)


@pytest.mark.parametrize(
    ("tried", "words"),
    [
        (FLOWN, "no difference"),
        (like_flown(trusted=152), "no difference"),
        (like_flown(trusted=180, sigma_ratio=0.02), "larger sigma"),
        (like_flown(trusted=0, sigma_ratio=0.0), "no range would be trusted"),
        (like_flown(sigma_ratio=0.005, scatter_ratio=1.8), "scatter more than their sigmas say"),
        (like_flown(delay_s=0.9, sigma_ratio=0.009), "later ranges"),
    ],
)
def test_a_gain_that_costs_something_else_is_not(tried: TrialOutcome, words: str) -> None:
    is_better, why = verdict_of(FLOWN, tried)
    assert not is_better
    assert words in why


def test_the_usual_trials_are_values_that_the_table_takes() -> None:
    for settings in (Settings(), Settings().replace("RNG_TRUST", 0.005), Settings().replace("TRK_LAG", 1.0)):
        trials = usual_trials(settings)
        assert len(trials) > 8
        for trial in trials:
            assert trial.over(settings) != settings


def trusted(t_s: float, range_m: float, sigma_m: float = 0.5) -> CorrectedRange:
    return CorrectedRange(0, 0, round(t_s * S), 25, range_m, sigma_m, 0.0, 0.0, 0.0, 50, True, None)


def test_scatter_is_in_sigmas_of_a_difference_and_leaves_gaps_out() -> None:
    steps = [trusted(0.0, 50.0), trusted(0.1, 50.0 + 0.5 * 2**0.5), trusted(0.2, 50.0)]
    assert scatter(steps) == pytest.approx(1.0)
    assert scatter([trusted(0.0, 50.0), trusted(5.0, 90.0)]) == 0.0


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tuned") / "flight.mcap"
    run = SimulatedService(build_flight(load_airframe("nadir-2m"), 4, 15.0), recording=path)
    run.fly(13.0)
    run.close()
    return path


@functools.cache
def tried(flight: Path, *changes: tuple[str, float]) -> TrialOutcome:
    """Try these changes, once: a replay takes seconds, and several tests look at the same trial."""
    return try_out(flight, ParameterTrial(changes))


@pytest.mark.slow
def test_a_trial_of_nothing_is_the_flight_as_it_was_published(flight: Path) -> None:
    from companion.adapters.recordings.mcap.reader import McapRecording

    records = list(McapRecording(flight).records())
    got = tried(flight)
    assert got.trusted == sum(isinstance(record, CorrectedRange) and record.trusted for record in records)
    shots = sum(isinstance(record, Shot) for record in records)
    assert got.shots == pytest.approx(shots, abs=2)  # the last plan may be open
    assert got.trusted > 5


@pytest.mark.long
def test_a_shorter_lag_gives_earlier_ranges_by_as_much(flight: Path) -> None:
    early, late = tried(flight, ("TRK_LAG", 0.25)).delay_s, tried(flight).delay_s
    assert late - early == pytest.approx(float(Settings().values()["TRK_LAG"]) - 0.25, abs=0.06)


@pytest.mark.long
def test_shots_are_those_of_the_trial_s_own_plans(flight: Path) -> None:
    """Half the rate fires at most half as often, and a larger allowed sigma skips no peak more."""
    flown, half, lenient = tried(flight), tried(flight, ("TRG_RATE", 5.0)), tried(flight, ("TRG_SIGMA", 0.05))
    assert 0.4 * flown.shots < half.shots <= 0.55 * flown.shots
    assert lenient.shots >= flown.shots
    assert lenient.skipped <= flown.skipped


@pytest.mark.slow
def test_a_stricter_limit_of_trust_lets_fewer_ranges_pass(flight: Path) -> None:
    assert tried(flight, ("RNG_TRUST", 0.006)).trusted < tried(flight).trusted


@pytest.mark.long
def test_the_command_prints_the_same_for_one_process_and_for_two(
    flight: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    printed = []
    for workers in ("2", "1"):
        if workers == "1":  # in this process, where the other tests try the same
            monkeypatch.setattr(tune, "try_out", lambda path, trial: tried(path, *trial.changes))
        words = ["tune", str(flight), "--json", "--workers", workers, "--try", "RNG_TRUST=0.06", "--try", "TRG_RATE=5"]
        assert main(words) == 0
        printed.append(json.loads(capsys.readouterr().out))
    assert printed[0] == printed[1]
    assert [row["trial"] for row in printed[0]["trials"][:3]] == ["as flown", "RNG_TRUST 0.06", "TRG_RATE 5"]
    names = {row.name for row in tunables()}
    assert set(printed[0]["proposal"]) <= names


def test_trials_that_are_done_are_proposed_from_after_ctrl_c(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    outcomes = {"": FLOWN, "RNG_TRUST": like_flown(trusted=165), "TRG_BLUR": like_flown(sigma_ratio=0.008)}

    def trial_until_stopped(_: Path, trial: ParameterTrial) -> TrialOutcome:
        name = "".join(name for name, _ in trial.changes)
        if name not in outcomes:
            raise KeyboardInterrupt
        return outcomes[name]

    monkeypatch.setattr(tune, "_settings", lambda _: Settings())
    monkeypatch.setattr(tune, "try_out", trial_until_stopped)
    command = ["tune", str(tmp_path / "flight.mcap"), "--workers", "1"]
    tries = [f"--try={change}" for change in ("RNG_TRUST=0.06", "TRG_BLUR=0.4", "TRG_RATE=5", "TRK_LAG=0.5")]
    assert main([*command, *tries]) == 0
    printed = capsys.readouterr()
    assert "proposed: --set RNG_TRUST=0.06 " in printed.out, "the better one: the two together were not tried"
    assert "stopped: proposing by 2 of 4 trials" in printed.err
    assert "planned" in printed.out.splitlines()[0]
    assert main([*command, *tries[2:]]) == 130


def test_of_values_that_contradict_each_other_the_better_one_is_proposed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    outcomes = {"": FLOWN, "RNG_MIN": like_flown(trusted=165), "RNG_MAX": like_flown(sigma_ratio=0.008)}
    monkeypatch.setattr(tune, "_settings", lambda _: Settings())
    monkeypatch.setattr(tune, "try_out", lambda _, trial: outcomes["".join(name for name, _ in trial.changes)])
    command = ["tune", str(tmp_path / "flight.mcap"), "--workers", "1", "--try=RNG_MIN=25", "--try=RNG_MAX=20"]
    assert main(command) == 0
    assert "proposed: --set RNG_MIN=25 " in capsys.readouterr().out


@pytest.mark.parametrize("words", [["--try", "RNG_TRUST"], ["--try", "RNG_TRUST=much"], ["--try", "RNG_TRUST=9"]])
@pytest.mark.slow
def test_a_value_that_cannot_be_tried_is_refused(words: list[str], flight: Path) -> None:
    assert main(["tune", str(flight), *words]) == 1


def test_a_foreign_log_is_refused_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "accel.csv").write_text("t_ns,x,y,z\n0,0,0,-9.8\n1000000,0,0,-9.8\n")
    with pytest.raises(RecordingError):
        try_out(tmp_path, ParameterTrial(()))


def test_of_a_foreign_log_no_airframe_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "flight.tlog"
    log.write_bytes(bytes(8) + b"\xfd" + bytes(40))
    assert main(["tune", str(log)]) == 1
    said = capsys.readouterr().err
    assert "tune needs a recording of Spanwise (.mcap) with ranges" in said
    assert "--airframe" not in said
