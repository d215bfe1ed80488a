"""Where the autopilot fires the cameras, the loop hands it each shot at once; otherwise a shot is nobody's business."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import pytest

from companion.adapters.triggers.mavlink import MavlinkTrigger
from companion.cli import run
from companion.core.pipeline import start
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Record, Shot, Tick, TriggerPlan
from companion.service.inertial import InertialLoop

SHOT = Shot(plan_id=7, planned_host_ns=1_000_000_000, fired_host_ns=1_000_020_000)


class Quiet:
    """Autopilot, clock, shots and recorder at once; it keeps the order of what happens."""

    def __init__(self) -> None:
        self.happened: list[tuple[str, Any]] = []

    def poll(self, timeout_s: float = 0.0) -> Iterator[Record]:
        return iter(())

    def publish(self, record: Record) -> None:
        self.happened.append(("published", record))

    def write(self, record: Record) -> None:
        self.happened.append(("recorded", record))

    def now_ns(self) -> int:
        return 1_000_030_000

    def sleep_until(self, target_host_ns: int) -> None:
        pass

    def close(self) -> None:
        pass


class OneShot:
    """The trigger process's end, with one shot."""

    def send(self, plan: TriggerPlan) -> None:
        pass

    def poll(self) -> list[Shot]:
        return [SHOT]

    def warnings(self) -> list[str]:
        return []


def turn_once(*, fires_by_link: bool) -> list[tuple[str, Any]]:
    quiet = Quiet()
    state = start(load_airframe("nadir-2m"), Settings())
    loop = InertialLoop(state, quiet, quiet, OneShot(), list, bool, quiet, fires_by_link=fires_by_link)
    loop.run_once()
    return [entry for entry in quiet.happened if not isinstance(entry[1], Tick)]


def test_a_shot_that_the_autopilot_fires_is_sent_before_it_is_recorded() -> None:
    assert turn_once(fires_by_link=True)[:2] == [("published", SHOT), ("recorded", SHOT)]


def test_a_shot_that_a_line_has_fired_is_not_sent_again() -> None:
    happened = turn_once(fires_by_link=False)
    assert ("recorded", SHOT) in happened
    assert ("published", SHOT) not in happened


@pytest.mark.parametrize(("trigger_options", "factory"), [([], None), (["--trigger", "mavlink"], MavlinkTrigger)])
def test_run_fires_through_the_autopilot_only_when_it_is_told_to(
    trigger_options: list[str], factory: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    configs: list[Any] = []
    monkeypatch.setattr(run.signal, "signal", lambda *_: None)  # pytest keeps its own Ctrl-C
    monkeypatch.setattr(run, "Service", lambda config: config)
    monkeypatch.setattr(run, "run_service", lambda config, *rest, **more: configs.append(config))
    parser = argparse.ArgumentParser()
    run.add_arguments(parser)
    common = ["--connect", "udpin:127.0.0.1:1", "--airframe", "nadir-2m", "--parameters", str(tmp_path / "kept")]
    assert run.execute(parser.parse_args([*common, *trigger_options])) == 0
    assert configs[0].trigger is factory
