"""Every bench can be started by ``python -m tools.bench``."""

from __future__ import annotations

import importlib
import inspect

import pytest

from tools.bench.__main__ import main, names


@pytest.mark.parametrize("name", names())
def test_every_bench_takes_options(name: str) -> None:
    entry = importlib.import_module(f"tools.bench.{name}").main
    assert inspect.signature(entry).bind([]).args == ([],)


def test_an_unknown_bench_is_refused_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["nonsense"]) == 2
    assert "nonsense" in capsys.readouterr().err
