"""Every bench can be started by ``python -m tools.bench``."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path

import pytest

from tools.bench import epipolar, publish_results
from tools.bench.__main__ import main, names


@pytest.mark.parametrize("name", names())
def test_every_bench_takes_options(name: str) -> None:
    entry = importlib.import_module(f"tools.bench.{name}").main
    assert inspect.signature(entry).bind([]).args == ([],)


def test_help_is_one_line_for_every_bench(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line]
    assert [words[0] for words in lines][-len(names()) :] == names()
    assert all(len(words) > 1 for words in lines)


def test_an_unknown_bench_is_refused_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["nonsense"]) == 2
    assert "nonsense" in capsys.readouterr().err


def test_the_results_page_is_what_the_print_outs_give() -> None:
    assert publish_results.PAGE.read_text(encoding="utf-8") == publish_results.page(), (
        "python -m tools.bench --publish writes it"
    )


def test_a_published_bench_leaves_its_print_out_with_its_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(publish_results, "FOLDER", tmp_path / "results")
    monkeypatch.setattr(publish_results, "PAGE", tmp_path / "RESULTS.md")

    def bench(options: list[str]) -> int:
        print("speed", *options)
        return 1

    printout, code = publish_results.capture("some", ["--quick"], bench)
    publish_results.write([printout])
    assert code == 1
    assert capsys.readouterr().out == "speed --quick\n", "the print-out is shown as it comes"
    text = (tmp_path / "RESULTS.md").read_text()
    assert "python -m tools.bench some --quick" in text
    assert "```\nspeed --quick\n```" in text
    assert "a target is missed" in text


def test_a_bench_without_its_data_publishes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(publish_results, "FOLDER", tmp_path / "results")
    monkeypatch.setattr(publish_results, "PAGE", tmp_path / "RESULTS.md")
    monkeypatch.setattr(epipolar, "_DATA", tmp_path)
    assert main(["--publish", "epipolar"]) == 1
    assert "SPANWISE_DATA" in capsys.readouterr().err
    assert not publish_results.PAGE.exists(), "what was not measured has met no target"
