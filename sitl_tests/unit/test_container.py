"""The Dockerfile: what it copies is there, its versions and labels are right, its command is one that is taken.

Held to the words of Docker's reference and of BlueOS's documentation of extensions; no image is built here.
"""

from __future__ import annotations

import fnmatch
import json
import os
import re
import shlex
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest

from companion.cli.main import build_parser
from tools.bench.size import pins

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "Dockerfile").read_text(encoding="utf-8")
INSTRUCTION_NAMES = {"FROM", "RUN", "WORKDIR", "COPY", "ENV", "VOLUME", "EXPOSE", "HEALTHCHECK", "ENTRYPOINT", "LABEL"}


def instructions(text: str) -> list[tuple[str, str]]:
    """Name and rest of each instruction: comment lines out, continued lines joined (Docker's reference, *Format*)."""
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    joined = re.sub(r"\\\n", "", "\n".join(lines))
    return [(name, rest.strip()) for name, _, rest in (line.partition(" ") for line in joined.splitlines() if line)]


INSTRUCTIONS = instructions(TEXT)


def labels() -> dict[str, str]:
    pairs = [word for name, rest in INSTRUCTIONS if name == "LABEL" for word in shlex.split(rest)]
    return dict(pair.split("=", 1) for pair in pairs)


def environment() -> dict[str, str]:
    pairs = [word for name, rest in INSTRUCTIONS if name == "ENV" for word in shlex.split(rest)]
    return dict(pair.split("=", 1) for pair in pairs)


def is_sent(name: str) -> bool:
    """Whether .dockerignore lets a top-level name into the build; the last line that fits decides."""
    sent = True
    for line in (ROOT / ".dockerignore").read_text().splitlines():
        if line and not line.startswith("#") and fnmatch.fnmatch(name, line.removeprefix("!")):
            sent = line.startswith("!")
    return sent


def test_every_line_begins_with_an_instruction() -> None:
    assert {name for name, _ in INSTRUCTIONS} == INSTRUCTION_NAMES
    assert INSTRUCTIONS[0][0] == "FROM"


def test_what_is_copied_is_in_the_repository_and_sent_to_the_build() -> None:
    copied = [
        words for name, rest in INSTRUCTIONS if name == "COPY" and not (words := rest.split())[0].startswith("--")
    ]
    sources = [source for words in copied for source in words[:-1]]
    assert {"pyproject.toml", "setup.py", "companion", "config", "requirements.lock"} <= set(sources)
    for source in sources:
        assert (ROOT / source).exists(), source
        assert is_sent(source), source
    assert not is_sent(".git")
    assert not is_sent("shared")


def test_both_stages_are_of_the_same_python_and_of_every_processor() -> None:
    bases = [rest.split()[0] for name, rest in INSTRUCTIONS if name == "FROM"]
    assert len(set(bases)) == 1
    assert "@sha256" not in bases[0], "a digest is that of one processor's image"
    assert "--platform" not in TEXT.partition("FROM")[2]


def test_the_constraints_are_all_pins_of_the_lock(tmp_path: Path) -> None:
    """The image's own command, run on the lock; the bench reads the same pins by other means."""
    (command,) = [re.search(r"sed -n '.*?' requirements.lock", rest) for name, rest in INSTRUCTIONS if "sed" in rest]
    assert command is not None
    done = subprocess.run(shlex.split(command[0]), cwd=ROOT, capture_output=True, text=True, check=True)
    assert [line.strip() for line in done.stdout.splitlines()] == pins(ROOT / "requirements.lock")


def test_the_version_and_the_extras_are_the_package_s() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert labels()["version"] == project["version"]
    (extras,) = re.findall(r'"\.\[([a-z,]+)\]"', TEXT)
    assert set(extras.split(",")) <= project["optional-dependencies"].keys()


@pytest.mark.parametrize(
    ("name", "kind"), [("permissions", dict), ("authors", list), ("company", dict), ("links", dict), ("tags", list)]
)
def test_blueos_reads_the_labels_as_json(name: str, kind: type[Any]) -> None:
    assert isinstance(json.loads(labels()[name]), kind)


def test_blueos_gives_it_the_machine_s_network_devices_and_a_folder_that_stays() -> None:
    host = json.loads(labels()["permissions"])["HostConfig"]
    assert host["NetworkMode"] == "host"
    assert "PortBindings" not in host, "a port of the machine's own network is not bound to another"
    binds = dict(bind.split(":") for bind in host["Binds"])
    (volume,) = [rest for name, rest in INSTRUCTIONS if name == "VOLUME"]
    assert volume in binds.values()
    assert environment()["XDG_STATE_HOME"] == volume, "what it learns and its token outlive the container"


@pytest.mark.parametrize(
    ("changed", "shown"),
    [
        ({}, {"connect": ["udpin:127.0.0.1:14551"], "airframe": "/data/wing.toml", "cameras": None}),
        (
            {"SPANWISE_CAMERAS": "--cameras oak:CAM_B,CAM_C", "SPANWISE_AIRFRAME": "/data/my wing.toml"},
            {"cameras": "oak:CAM_B,CAM_C", "airframe": "/data/my wing.toml"},
        ),
    ],
)
def test_it_starts_a_command_that_the_program_takes(
    tmp_path: Path, changed: dict[str, str], shown: dict[str, object]
) -> None:
    (entry,) = [json.loads(rest) for name, rest in INSTRUCTIONS if name == "ENTRYPOINT"]
    program = tmp_path / "spanwise"
    program.write_text('#!/bin/sh\nfor word in "$@"; do echo "$word"; done\n')
    program.chmod(0o755)
    variables = {**environment(), **changed, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run([*entry, "--set", "RNG_MAX=150"], env=variables, capture_output=True, text=True, check=True)
    words = done.stdout.splitlines()
    assert words[0] == "run"
    assert words[-2:] == ["--set", "RNG_MAX=150"], "what is given to the container comes last"
    parsed = vars(build_parser("run").parse_args(words))
    assert {name: parsed[name] for name in shown} == shown
    assert parsed["live"] == "0.0.0.0:8765"


def test_its_health_is_asked_where_the_live_view_answers() -> None:
    (check,) = [rest for name, rest in INSTRUCTIONS if name == "HEALTHCHECK"]
    words = json.loads(check.partition("CMD")[2])
    (exposed,) = [rest.removesuffix("/tcp") for name, rest in INSTRUCTIONS if name == "EXPOSE"]
    assert f"http://127.0.0.1:{exposed}/register_service" in words[2]
    compile(words[2], "HEALTHCHECK", "exec")
