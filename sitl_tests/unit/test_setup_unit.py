"""The systemd unit: systemd's own tools find nothing wrong, and it starts what the defaults say."""

from __future__ import annotations

import configparser
import re
import shlex
import shutil
import string
import subprocess
from pathlib import Path

import pytest

from companion.adapters.triggers import realtime
from companion.cli.main import build_parser, main
from sitl_tests.unit.setup_boards import BOARDS, fake_board

UNIT, DEFAULTS = "etc/systemd/system/spanwise.service", "etc/default/spanwise"
MOST_EXPOSURE = 2.5
"""Of 10, as systemd-analyze security counts; its "OK" ends at 5. What is left: devices, network, real-time priority."""


def set_up(root: Path, kind: str = "plain", *options: str) -> Path:
    root.mkdir()
    fake_board(root, kind)
    assert main(["setup", "--root", str(root), "--yes", *options]) == 0
    return root


def analysed(*words: str) -> subprocess.CompletedProcess[str]:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed here")
    return subprocess.run(["systemd-analyze", *words], capture_output=True, text=True, timeout=60)


def started(root: Path) -> list[str]:
    """The command line of the unit, filled in as systemd does: ``$NAME`` is split, ``${NAME}`` is not."""
    lines = [line for line in (root / DEFAULTS).read_text().splitlines() if line and not line.startswith("#")]
    values = dict(line.split("=", 1) for line in lines)
    values = {name: value.strip('"') for name, value in values.items()}
    (command,) = re.findall(r"^ExecStart=(.*)$", (root / UNIT).read_text(), re.MULTILINE)
    words: list[str] = []
    for word in command.split():
        filled = string.Template(word).substitute(values)
        words += [filled] if word.startswith("${") else filled.split()
    return words


@pytest.mark.parametrize("kind", BOARDS)
def test_systemd_verifies_the_unit(tmp_path: Path, kind: str) -> None:
    root = set_up(tmp_path / "root", kind)
    here = tmp_path / "spanwise.service"  # the program is looked for on this machine
    here.write_text((root / UNIT).read_text().replace("/opt/spanwise/bin/spanwise", "/bin/true"))
    done = analysed("verify", "--man=no", str(here))
    said = [line for line in done.stderr.splitlines() if "spanwise" in line]
    assert said == []
    assert done.returncode == 0, done.stderr


def test_a_unit_that_systemd_does_not_understand_is_noticed(tmp_path: Path) -> None:
    spoilt = tmp_path / "spanwise.service"
    spoilt.write_text((set_up(tmp_path / "root") / UNIT).read_text().replace("WatchdogSec=20", "WatchdogSec=soon"))
    assert "Failed to parse sec value, ignoring: soon" in analysed("verify", "--man=no", str(spoilt)).stderr


def test_the_unit_is_hardened(tmp_path: Path) -> None:
    root = set_up(tmp_path / "root")
    shutil.copy(root / UNIT, tmp_path / "spanwise.service")
    done = analysed("security", "--offline=true", "--no-pager", str(tmp_path / "spanwise.service"))
    if "unrecognized option" in done.stderr:
        pytest.skip("this systemd-analyze cannot look at a file (--offline, since 250)")
    (exposure,) = re.findall(r"Overall exposure level for spanwise.service: ([\d.]+)", done.stdout)
    assert float(exposure) <= MOST_EXPOSURE


def test_the_watchdog_may_be_fed_and_the_trigger_may_be_punctual(tmp_path: Path) -> None:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read_string((set_up(tmp_path / "root") / UNIT).read_text())
    service = unit["Service"]
    assert service["Type"] == "notify"
    assert service["NotifyAccess"] == "all", "it is a child that feeds the watchdog"
    assert int(service["WatchdogSec"]) > 0
    assert int(service["LimitRTPRIO"]) == realtime._PRIORITY
    assert service["LimitMEMLOCK"] == "infinity"
    assert "CAP_SYS_NICE" in service["AmbientCapabilities"]
    assert "CAP_SYS_NICE" in service["CapabilityBoundingSet"]
    for folder in ("StateDirectory", "CacheDirectory", "ConfigurationDirectory"):
        assert service[folder] == "spanwise"


@pytest.mark.parametrize(
    ("options", "shown"),
    [
        ((), {"airframe": "/etc/spanwise/wing.toml", "cameras": None, "trigger": "none"}),
        (
            ("--airframe", "nadir-2m", "--cameras", "oak:CAM_B,CAM_C", "--trigger", "serial:/dev/spanwise-trigger"),
            {"airframe": "nadir-2m", "cameras": "oak:CAM_B,CAM_C", "trigger": "serial:/dev/spanwise-trigger"},
        ),
        (("--link", "tcp:10.0.0.2:5760"), {"connect": ["tcp:10.0.0.2:5760"]}),
    ],
)
def test_what_it_starts_is_a_command_that_the_program_takes(
    tmp_path: Path, options: tuple[str, ...], shown: dict[str, object]
) -> None:
    words = started(set_up(tmp_path / "root", "pi5", *options))
    assert words[:3] == ["/opt/spanwise/bin/spanwise", "run", "--plain"]
    parsed = vars(build_parser("run").parse_args(words[1:]))
    assert {name: parsed[name] for name in shown} == shown


@pytest.mark.parametrize("kind", BOARDS)
def test_the_defaults_are_a_file_that_a_shell_reads_too(tmp_path: Path, kind: str) -> None:
    for line in (set_up(tmp_path / "root", kind) / DEFAULTS).read_text().splitlines():
        assert not line or line.startswith("#") or len(shlex.split(line)) == 1
        assert len(line) <= 130
