"""The table of the blind trials: intervals, counts, and a plan that seals before it flies."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.core.wing.effects import catalogue
from companion.evaluation.fleet.runner import write_part
from tools import trials
from tools.trial_judge import judge, swings
from tools.trial_plan import Trial, acceptance
from tools.trial_results import results, wilson
from tools.trial_tasks import Batch, JudgementTask, parts
from tools.trial_truths.cases import Hidden, Tables, hide
from tools.trial_truths.strengths import SIGMA, sigma_of


@pytest.mark.parametrize(("counted", "total"), [(0, 300), (14, 16), (9, 10)])
def test_wilsons_interval_is_where_the_share_is_two_sigma_off(counted: int, total: int) -> None:
    """Its ends p solve |p - k/n| = 1.96 sqrt(p (1 - p) / n)."""
    for end in wilson(counted, total):
        if 0.0 < end < 1.0:
            off = abs(end - counted / total)
            assert off == pytest.approx(1.959964 * np.sqrt(end * (1.0 - end) / total), rel=1e-6)


def test_hidden_effects_are_as_strong_as_asked_in_loud_and_in_quiet_flights() -> None:
    rng = np.random.default_rng(1)
    for name in SIGMA:
        for snr_db in (10.0, 20.0):
            assert hide([name], (8.0, 8.0), rng, snr_db).strength(name, snr_db) == pytest.approx(8.0)
    assert sigma_of("cubic-stiffness", 20.0, 2.0) == pytest.approx(sigma_of("cubic-stiffness") / 4.0)


def test_an_effect_that_no_trial_hides_is_refused_by_name(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as left:
        trials.main(["--only", "frequency-shift", "soft-spring", "--out", str(tmp_path / "out")])
    assert left.value.code == 2
    said = capsys.readouterr().err
    assert "--only soft-spring: first hides only accel-bias, " in said
    assert not (tmp_path / "out").exists()


def test_close_modes_differ_in_strength_though_none_can_be_as_strong_as_others() -> None:
    rng = np.random.default_rng(2)
    labels = [hide(["close-mode"], (8.0, 14.0), rng) for _ in range(40)]
    below = [label for label in labels if label.extra["close-mode.ratio"] < 0.0]
    assert 8 < len(below) < 32
    for side in (below, [label for label in labels if label not in below]):
        strengths = [label.strength("close-mode", 20.0) for label in side]
        assert min(strengths) >= 8.0 - 1e-9
        assert len({label.effects["close-mode"] for label in side}) == len(side)
    assert np.ptp([label.strength("close-mode", 20.0) for label in below]) > 0.5


def test_what_noise_hides_is_hidden_larger_in_noise() -> None:
    for name in ("camera-asymmetry", "quantisation"):
        quiet, loud = (
            hide([name], (8.0, 8.0), np.random.default_rng(3), snr_db).effects[name] for snr_db in (20.0, 10.0)
        )
        assert abs(loud) > 2.0 * abs(quiet)


def test_what_follows_a_channel_is_judged_by_the_rms_that_it_has_in_the_recording() -> None:
    """A wave of unit rms whose peak alone falls into the minute has less: so has what it moves per rms."""
    t_s = np.linspace(-0.5, 0.5, 1001)
    wave = np.sqrt(2.0) * np.cos(t_s)
    nothing = np.zeros(0)
    tables = Tables(t_s, nothing, nothing, nothing, nothing, wave, 17.0 + 2.0 * wave)
    units = swings(tables)
    for name, channel in (("airspeed-dependence", "airspeed_mps"), ("covariate-frequency", "roller_v")):
        term: Any = SimpleNamespace(effect=catalogue()[name](), channel=channel)
        per_rms = 0.04 * float(np.std(wave))
        cause = SimpleNamespace(term=term, group=(), z=9.0, values=(per_rms,), sigmas=(0.004,))
        diagnosis: Any = SimpleNamespace(
            causes=(cause,), nearest="", nearest_causes=(), verdict="explained", reason="", gain=None, after=()
        )
        label = Hidden({name: 0.04})
        assert judge(label, diagnosis, 1.0, 20.0, units)["inside_95"]
        assert not judge(label, diagnosis, 1.0)["inside_95"]


def test_the_acceptance_plan_holds_what_is_promised() -> None:
    trials = [trial for batch in acceptance(1) for trial in batch]
    assert sum(trial.kind == "nothing" for trial in trials) >= 300
    assert {trial.snr_db for trial in trials if trial.kind == "single"} == {10.0, 20.0, 30.0}
    assert {name for trial in trials if trial.kind == "single" for name in trial.label.effects} >= set(SIGMA)
    assert len({trial.label.seal for trial in trials}) == len(trials)
    assert sum(trial.kind == "pair" for trial in trials) >= 20


def test_a_wrong_name_is_counted_and_listed() -> None:
    def row(**changes: object) -> dict[str, object]:
        plain: dict[str, object] = {
            "kind": "single", "hidden": {"tone": 1.0}, "left_out": False, "snr_db": 20.0, "verdict": "explained",
            "right": True, "exact": True, "inside_95": None, "gain": 10.0, "oracle_gain": 10.0, "cpu_s": 2.0,
            "groups": [["tone"]], "nearest": "", "nearest_causes": [], "worst_checks": [], "commit": "abc",
        }  # fmt: skip
        return {**plain, **changes}

    wrong = row(right=False, exact=False, groups=[["hysteresis"]], gain=8.0)
    left_out = row(left_out=True, verdict="unexplained", right=False, exact=False, groups=[], gain=None)
    tables = results([row(), wrong, left_out])
    assert "| single, 20 dB | wrong name | 1/2: 50 %" in tables
    assert "| left out, 20 dB | unexplained | 1/1: 100 %" in tables
    assert "| gain as a share of the oracle's | worst | 80 % of 2 |" in tables
    assert tables.count("hysteresis") == 1


def test_a_judgement_s_name_tells_its_place_and_seal_and_nothing_of_what_is_hidden(tmp_path: Path) -> None:
    trials = tuple(acceptance(1)[0])
    tasks = [JudgementTask(Batch(trials, 1, 0, 60.0), place, out, tmp_path, "") for place in range(60)
             for out in trials[place].judged]  # fmt: skip
    assert len({task.result_file for task in tasks}) == len(tasks)
    for task in tasks:
        assert task.trial.label.seal[:12] in task.name
        assert not any(effect in task.name for effect in task.trial.label.effects)


def test_parts_come_in_the_order_of_their_plan_without_those_that_failed(tmp_path: Path) -> None:
    trials = (Trial("single", Hidden({})),) * 3
    for number, place, row in [(1, 0, {"n": 2}), (0, 1, {"n": 1}), (0, 0, {"n": 0}), (0, 2, {"failed": "no memory"})]:
        write_part(JudgementTask(Batch(trials, 5, number, 60.0), place, False, tmp_path, ""), row)
    assert [row["n"] for row in parts(tmp_path)] == [0, 1, 2]
