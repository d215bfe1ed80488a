"""The demo's picture from a made-up flight: its figure is written on it, gaps stay gaps, dots carry their sigma."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.evaluation.flight_evaluation import FlightEvaluation
from companion.evaluation.pages import demo_picture as picture

GAP_S = (20.0, 32.0)


def evaluation() -> FlightEvaluation:
    """A minute of shots at 60 m, and none for twelve seconds."""
    rng, t_s = np.random.default_rng(1), np.arange(0.0, 60.0, 0.12)
    t_s = t_s[(t_s < GAP_S[0]) | (t_s > GAP_S[1])]
    true_m, toe = 60.0 + 5.0 * np.sin(t_s / 8.0), 0.04 + 0.01 * np.sin(20.0 * t_s)
    series: dict[str, Any] = {
        "t_s": t_s,
        "true_toe_rad": toe,
        "toe_rad": toe + rng.normal(0.0, 1e-4, len(t_s)),
        "toe_sigma_rad": np.full(len(t_s), 1e-4),
        "corrected.sigma_m": np.full(len(t_s), 0.4),
    }
    for name, error_ratio in (("rigid", 0.4), ("rigid_in_trim", 0.2), ("corrected", 0.005), ("oracle", 0.0)):
        series |= {
            f"{name}.t_s": t_s,
            f"{name}.z_true_m": true_m,
            f"{name}.range_m": true_m * (1.0 - error_ratio * rng.uniform(0.5, 1.0, len(t_s))),
            f"{name}.toe_error_rad": error_ratio * rng.normal(0.0, 0.01, len(t_s)),
        }
    series |= {"blur.at_plan": rng.gamma(2.0, 0.2, len(t_s)), "blur.at_random": rng.gamma(2.0, 0.4, len(t_s))}
    plain = {
        "airframe": "nadir-2m",
        "seed": 1,
        "truth": {"frequency_hz": 5.1, "gust_rms_mm": 4.9},
        "targets": {"share_of_error_removed": {"of_rigid": 0.9872}},
        "range_error_m": {
            way: {"60": {"n": 9, "median": median_m, "p95": 2.0 * median_m}}
            for way, median_m in (("rigid", 18.04), ("rigid_in_trim", 9.0), ("corrected", 0.23), ("oracle", 0.2))
        },
        "shots": {"trusted": 300, "corrected": len(t_s)},
    }
    return FlightEvaluation(plain, series)


@pytest.fixture
def figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    from matplotlib.figure import Figure

    drawn: list[Any] = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *a, **k: (drawn.append(self), save(self, *a, **k))[1])
    picture.draw(evaluation(), tmp_path / "summary.png")
    assert (tmp_path / "summary.png").read_bytes()[:4] == b"\x89PNG"
    return drawn[0]


@pytest.mark.slow
def test_the_figure_that_counts_is_written_on_the_picture(figure: Any) -> None:
    title = figure.get_suptitle()
    for words in ("98.7 % of the toe's error removed", "18.0 m", "0.23 m", "300 of"):
        assert words in title


def test_no_line_is_drawn_across_missing_data(figure: Any) -> None:
    for axis in figure.axes:
        for line in axis.lines:
            x = np.asarray(line.get_xdata(), dtype=float)
            if line.get_linestyle() == "None" or len(x) < 100 or axis.get_xlabel() != "time, s":
                continue
            steps = np.diff(x)
            assert not np.any(steps[np.isfinite(steps)] > 1.0)


def test_no_line_joins_one_obstacle_to_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.figure import Figure

    drawn: list[Any] = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: drawn.append(self))
    ahead = evaluation()
    ahead.series["oracle.z_true_m"] = 80.0 - 15.0 * (ahead.series["t_s"] % 5.0)
    picture.draw(ahead, tmp_path / "summary.png")
    line = next(line for line in drawn[0].axes[0].lines if line.get_label() == "true range")
    steps_m = np.diff(np.asarray(line.get_ydata(), dtype=float))
    assert np.nanmax(np.abs(steps_m)) < 3.0


def test_corrected_ranges_carry_their_sigma_and_every_axis_its_unit(figure: Any) -> None:
    by_title = {axis.get_title(): axis for axis in figure.axes}
    (bars,) = by_title["Range"].containers
    low, high = np.array(bars.lines[2][0].get_segments())[:, :, 1].T
    np.testing.assert_allclose(high - low, 0.8, atol=1e-9)
    for axis in figure.axes:
        assert axis.get_ylabel()
