"""An effect that is declared badly is named, with its file and what to mend, wherever the catalogue is asked."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from companion.cli.main import main
from companion.core.wing import effects
from companion.core.wing.effect import sensed
from companion.core.wing.effects import catalogue
from companion.errors import ConfigError
from companion.records import Floats, Station

MODULE = f"{effects.__name__}.of_a_test"
NAMED = 'name: ClassVar[str] = "of-a-test"'
GROUPED = "group: ClassVar[Group] = Group.SENSING"
SIZED = 'size: float = parameter("", 0.1, "its size")'
Writer = Callable[..., None]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Writer]:
    """Writer of one more file of the catalogue: an effect with these lines."""
    head = "from dataclasses import dataclass\nfrom typing import ClassVar\n"
    head += "from companion.core.wing.effect import Effect, Group, parameter\n"
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])

    def written(*lines: str, decorator: str = "@dataclass(frozen=True, slots=True)\n") -> None:
        body = "".join(f"    {line}\n" for line in lines or ["pass"])
        (tmp_path / "of_a_test.py").write_text(f"{head}\n\n{decorator}class Tried(Effect):\n{body}")
        catalogue.cache_clear()

    yield written
    sys.modules.pop(MODULE, None)
    if hasattr(effects, "of_a_test"):
        delattr(effects, "of_a_test")
    catalogue.cache_clear()


def test_an_effect_with_name_group_and_parameter_is_in_the_catalogue(write: Writer) -> None:
    write(NAMED, GROUPED, SIZED)
    assert catalogue()["of-a-test"].parameters()[0].sigma == 0.1


@pytest.mark.parametrize(
    ("lines", "wrong"),
    [
        ((GROUPED, SIZED), "has no name"),
        ((NAMED, SIZED), "has no group"),
        ((NAMED, GROUPED, "size: float = 0.0"), r"declare 'size' with parameter\(unit, sigma, doc\)"),
        ((NAMED, GROUPED), "has no parameter"),
        ((NAMED.replace("of-a-test", "accel-scale"), GROUPED, SIZED), "AccelScale .* is named 'accel-scale' already"),
    ],
    ids=["name", "group", "undeclared", "no parameter", "taken"],
)
def test_what_an_effect_does_not_declare_is_said_with_class_and_file(
    write: Writer, lines: tuple[str, ...], wrong: str
) -> None:
    write(*lines)
    with pytest.raises(ConfigError, match=wrong) as raised:
        catalogue()
    assert "effect Tried in of_a_test.py" in str(raised.value)


def test_a_forgotten_decorator_is_said(write: Writer) -> None:
    write(NAMED, GROUPED, SIZED, decorator="")
    with pytest.raises(ConfigError, match="it needs @dataclass"):
        catalogue()


@pytest.mark.parametrize("command", ["diagnose", "simulate"])
def test_a_command_ends_with_the_sentence(write: Writer, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    write(NAMED, SIZED)
    assert main([command, "--help"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"spanwise {command}: effect Tried in of_a_test.py has no group")


def test_sensor_values_of_another_shape_name_the_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = catalogue()["accel-scale"]

    def vertical_only(_self: object, _station: Station, _t_s: Floats, values: Floats) -> Floats:
        return values[:, 2]

    monkeypatch.setattr(kind, "sense", vertical_only)
    with pytest.raises(ConfigError, match=r"effect 'accel-scale': its sense\(\) makes \(5,\) of samples \(5, 6\)"):
        sensed((kind(),), Station.LEFT, np.arange(5) / 1000.0, np.zeros((5, 6)))
