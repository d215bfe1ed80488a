"""``spanwise new-airframe``: any plausible answers become a file that the service starts on."""

from __future__ import annotations

import dataclasses
import json
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.cli.main import main
from companion.core.pipeline import start
from companion.core.stereo.geometry import Rig
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
ANSWERS = {"--semispan-m": "1.0", "--frequency-hz": "5.0", "--mass-kg": "4.0", "--focal-px": "800"}


def command(out: Path, changes: dict[str, str] | None = None, *flags: str) -> list[str]:
    words = [f"{option}={value}" for option, value in {**ANSWERS, **(changes or {})}.items()]
    return ["new-airframe", f"--out={out}", *words, *flags]


def made(tmp_path: Path, changes: dict[str, str] | None = None, *flags: str) -> Airframe:
    out = tmp_path / "mine.toml"
    assert main(command(out, changes, *flags)) == 0
    return load_airframe(str(out))


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Somebody at a terminal who answers these lines, one after the other; what was asked stands in the second list."""
    answers: list[str] = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: answers.pop(0))
    yield answers
    assert answers == [], "every answer was asked for"


def test_the_file_says_what_was_measured(tmp_path: Path) -> None:
    airframe = made(tmp_path, {"--image": "1280x800", "--looks": "forward", "--station-y-m": "0.9"})
    assert airframe.name == "mine"
    assert airframe.wing.semispan_m == 1.0
    assert airframe.wing.symmetric.frequency_hz.value == 5.0
    assert airframe.orientation == 0
    assert airframe.left_camera is not None
    assert (airframe.left_camera.width_px, airframe.left_camera.height_px) == (1280, 800)
    assert airframe.left_camera.focal_px.value == 800.0
    assert airframe.left_camera.axes == load_airframe("forward-2m").left_camera.axes  # type: ignore[union-attr]
    assert [station.position_m[1] for station in (airframe.left, airframe.right)] == [-0.9, 0.9]


@pytest.mark.parametrize(
    ("looks", "words", "axis_body"),
    [("forward", "x > 0 looks up", (np.cos(0.1), 0.0, -np.sin(0.1))),
     ("down", "x > 0 looks ahead of straight down", (np.sin(0.1), 0.0, np.cos(0.1)))],
)  # fmt: skip
def test_the_file_says_which_way_a_camera_turns(
    tmp_path: Path, looks: str, words: str, axis_body: tuple[float, float, float]
) -> None:
    """Body axes: x forward, z down."""
    airframe = made(tmp_path, {"--looks": looks})
    assert (tmp_path / "mine.toml").read_text().count(words) == 2
    turned = dataclasses.replace(airframe.left_camera, rotation_rad=(0.1, 0.0, 0.0))  # type: ignore[type-var]
    rig = Rig.from_airframe(dataclasses.replace(airframe, left_camera=turned))
    assert rig.left.rest.camera_from_body[2] == pytest.approx(axis_body)


def test_a_pair_that_looks_ahead_is_not_sent_over_the_ground_for_its_trim_bend(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Bend rolls it; its toe is that of two mountings of 10 mrad: 3 % of Z are Z^2/B sqrt(2) 0.01 at 3.8 m."""
    assert main(command(tmp_path / "mine.toml", {"--looks": "forward", "--station-y-m": "0.9"})) == 0
    said = capsys.readouterr().out
    assert "calibrate_target" in said
    assert "--ground" not in (tmp_path / "mine.toml").read_text()
    assert "the trim bend" not in said
    assert f"some {0.03 * 1.8 / (math.sqrt(2.0) * 0.01):.1f} m is the farthest trusted without matched features" in said


def test_the_bend_is_that_of_a_beam_by_its_differential_equation(tmp_path: Path) -> None:
    """EI w'''' = load, clamped and free: the tip of a wing that carries a fuselage of its own mass, at 5 Hz.

    The stiffness comes from the first root of cos x cosh x = -1; neither number is the draft's.
    """
    root = 1.8751040687
    per_mass = (2.0 * math.pi * 5.0) ** 2 / root**4  # EI / (mass per length x length^4)
    own_weight_m = 9.80665 / 8.0 / per_mass
    wing = made(tmp_path, {"--wing-mass-kg": "2.0", "--station-y-m": "1.0"}).wing
    assert wing.bend_per_g_m.value == pytest.approx(own_weight_m, rel=1e-3)
    assert wing.trim_bend_m.value == pytest.approx(2.0 * own_weight_m, rel=1e-3), "it hung when it was calibrated"
    straight = made(tmp_path, {"--wing-mass-kg": "1.0", "--station-y-m": "1.0"}, "--no-hanging", "--force").wing
    assert straight.trim_bend_m.value == straight.bend_per_g_m.value == pytest.approx(3.0 * own_weight_m, rel=1e-3)
    assert wing.symmetric.slope_factor_radpm.value == pytest.approx(1.3765, rel=0.01), "tip slope of that mode"


@pytest.mark.parametrize("station", [0.3, 0.6, 0.8])
def test_a_node_inboard_of_the_tip_has_the_slope_and_the_bends_of_its_station(station: float, tmp_path: Path) -> None:
    """Mode shape cosh - cos - s (sinh - sin); static shape: the moment of an even load, integrated twice."""
    root = 1.8751040687
    x = root * station
    s = (math.cosh(root) + math.cos(root)) / (math.sinh(root) + math.sin(root))
    slope = root * (math.sinh(x) + math.sin(x) - s * (math.cosh(x) - math.cos(x)))
    shape = math.cosh(x) - math.cos(x) - s * (math.sinh(x) - math.sin(x))
    span = np.linspace(0.0, 1.0, 10001)
    static = np.cumsum(np.cumsum(0.5 * (1.0 - span) ** 2))
    tip_ratio = float(np.interp(station, span, static) / static[-1])
    tip = made(tmp_path, {"--station-y-m": "1.0"}).wing
    airframe = made(tmp_path, {"--station-y-m": str(station)}, "--force")
    for mode in (airframe.wing.symmetric, airframe.wing.antisymmetric):
        assert mode.slope_factor_radpm.value == pytest.approx(slope / shape, rel=1e-3)
    for name in ("bend_per_g_m", "trim_bend_m"):
        assert getattr(airframe.wing, name).value == pytest.approx(tip_ratio * getattr(tip, name).value, rel=2e-3)
    gust_m = airframe.wing.gust.deflection_rms_m.value
    assert gust_m == pytest.approx(tip_ratio * tip.gust.deflection_rms_m.value, rel=2e-3)
    for camera, node in zip(airframe.camera_pair, (airframe.left, airframe.right), strict=True):
        assert camera.position_m[1] == node.position_m[1], "at the node, whose slope and deflection are its own"
        assert camera.slope_gain == camera.lift_gain == 1.0


def test_what_the_supplied_airframes_believe_lies_within_two_sigma_of_the_draft(tmp_path: Path) -> None:
    draft, supplied = made(tmp_path, None, "--no-hanging").wing, load_airframe("nadir-2m").wing
    pairs = [
        (draft.trim_bend_m, supplied.trim_bend_m),
        (draft.bend_per_g_m, supplied.bend_per_g_m),
        (draft.symmetric.slope_factor_radpm, supplied.symmetric.slope_factor_radpm),
        (draft.antisymmetric.frequency_hz, supplied.antisymmetric.frequency_hz),
        (draft.symmetric.damping, supplied.symmetric.damping),
    ]
    for guess, belief in pairs:
        assert abs(guess.value - belief.value) <= 2.0 * guess.sigma
        assert guess.sigma >= belief.sigma, "nobody who measured nothing knows it better"


numbers = st.fixed_dictionaries(
    {
        "--semispan-m": st.floats(0.4, 10.0),
        "--frequency-hz": st.floats(2.0, 20.0),
        "--mass-kg": st.floats(0.5, 200.0),
        "--focal-px": st.floats(200.0, 4000.0),
        "--imu-rate-hz": st.floats(60.0, 1000.0),  # two samples a period of the antisymmetric mode, 26 Hz at most
        "--node-rate-hz": st.floats(200.0, 2000.0),
        "--accel-filter-hz": st.sampled_from([0.0, 20.0, 80.0]),
        "--looks": st.sampled_from(["down", "forward", "none"]),
        "--image": st.sampled_from(["640x480", "1280x800", "1920X1200"]),
        "--tip-axes": st.sampled_from(["xyzpqr", "z"]),
        "--name": st.text(st.characters(exclude_categories=("Cs", "Cc")), min_size=1, max_size=12).filter(
            lambda text: not set(text) & set('"\\')
        ),
    }
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(numbers, st.floats(0.2, 0.8), st.booleans())
def test_any_plausible_answers_give_a_file_that_loads_and_that_the_service_starts_on(
    answers: dict[str, object], wing_share: float, hanging: bool
) -> None:
    answers = {**answers, "--wing-mass-kg": wing_share * float(str(answers["--mass-kg"]))}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "mine.toml"
        flags = ["--hanging" if hanging else "--no-hanging"]
        bend_m = 9.81 / (2.0 * math.pi * float(str(answers["--frequency-hz"]))) ** 2 * 1.55 * (1.0 / wing_share)
        code = main(command(out, {key: str(value) for key, value in answers.items()}, *flags))
        if bend_m > 0.25 * float(str(answers["--semispan-m"])):
            return  # a wing that would fold up may be refused
        assert code == 0
        airframe = load_airframe(str(out))
        assert airframe.name == answers["--name"]
        assert airframe.wing.symmetric.frequency_hz.value == pytest.approx(
            float(str(answers["--frequency-hz"])), rel=1e-3
        )
        start(airframe, Settings(), None)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"--semispan-m": "1000"}, "semispan_m = 1000 m is outside 0.05 to 50 m"),
        ({"--frequency-hz": "5000"}, "frequency_hz = 5000 Hz is outside 0.2 to 500 Hz"),
        ({"--mass-kg": "-2"}, "mass_kg = -2 kg is outside"),
        ({"--mass-kg": "nan"}, "mass_kg = nan kg is outside"),
        ({"--mass-kg": "heavy"}, "mass_kg: 'heavy' is not a number (kg)"),
        ({"--focal-px": "8"}, "focal_px = 8 px is outside 10 to 1e+06 px"),
        ({"--image": "800"}, "image = '800': give width x height"),
        ({"--wing-mass-kg": "5"}, "wing_mass_kg = 5 kg of mass_kg = 4 kg"),
        ({"--station-y-m": "1.4"}, "station_y_m = 1.4 m is beyond semispan_m = 1 m"),
        ({"--frequency-sigma-hz": "4"}, "frequency_sigma_hz = 4 Hz is more than half"),
        ({"--frequency-hz": "0.5"}, "more than 30 % of semispan_m"),
        ({"--name": 'a"b'}, "no quotes"),
        ({"--name": "a\udcff"}, "bytes that are not UTF-8"),
    ],
)
def test_what_no_aircraft_is_is_refused_with_key_value_and_range(
    changes: dict[str, str], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command(tmp_path / "mine.toml", changes)) == 1
    said = capsys.readouterr()
    assert named in said.err
    assert len(said.err.splitlines()) == 1
    assert not (tmp_path / "mine.toml").exists()


def test_without_a_terminal_what_is_missing_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new-airframe", f"--out={tmp_path / 'mine.toml'}", "--semispan-m=1"]) == 1
    assert "give --frequency-hz" in capsys.readouterr().err


def test_a_file_that_is_there_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "mine.toml"
    out.write_text("precious")
    assert main(command(out)) == 1
    assert "is there already" in capsys.readouterr().err
    assert out.read_text() == "precious"
    assert main(command(out, None, "--force")) == 0


def test_a_folder_that_is_not_there_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command(tmp_path / "none" / "mine.toml")) == 1
    assert f"no folder {tmp_path / 'none'}" in capsys.readouterr().err


def test_a_folder_that_is_not_there_is_told_before_anything_is_asked(
    terminal: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert terminal == []
    assert main(["new-airframe", f"--out={tmp_path / 'none' / 'mine.toml'}"]) == 1
    assert "no folder" in capsys.readouterr().err


def test_a_file_named_by_bytes_that_are_no_text_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "w\udcff.toml"
    assert main(command(out)) == 1
    assert "bytes that are not UTF-8" in capsys.readouterr().err
    assert not out.exists()
    assert main(command(out, {"--name": "wing"})) == 0


def test_an_image_size_that_is_none_is_asked_again(
    terminal: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ended the command, and a dozen answers were lost."""
    terminal += ["", *[""] * 7, "big", "640x400", "", ""]
    out = tmp_path / "mine.toml"
    words = [word for word in command(out) if not word.startswith("--image")]
    assert main(words) == 0
    assert "image = 'big': give width x height" in capsys.readouterr().err
    assert load_airframe(str(out)).camera_pair[0].width_px == 640


def test_at_a_terminal_it_asks_and_asks_again(
    terminal: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal += ["sideways", "forward"]  # where the cameras look, the first not understood
    terminal += ["1500", "1.5"]  # semispan in millimetres, then in metres
    terminal += ["4.2", "", "", "6", "", "", "900", "", "", ""]  # frequency ... node rate; empty takes what is offered
    terminal += ["", "z", "straight"]
    out = tmp_path / "mine.toml"
    assert main(["new-airframe", f"--out={out}"]) == 0
    said = capsys.readouterr()
    assert "semispan_m = 1500 m is outside" in said.err
    airframe = load_airframe(str(out))
    assert (airframe.wing.semispan_m, airframe.orientation, airframe.left.sends) == (1.5, 0, "z")
    assert airframe.wing.antisymmetric.frequency_hz.value == pytest.approx(1.28 * 4.2, rel=1e-3)
    assert f"spanwise doctor --connect LINK --airframe {out}" in said.out
    assert f"spanwise setup wing --connect LINK --airframe {out}" in said.out


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({}, marks=pytest.mark.long),
        pytest.param({"--station-y-m": "0.6"}, marks=pytest.mark.long),
        {"--frequency-hz": "9", "--semispan-m": "0.8", "--tip-axes": "z"},
    ],
)
def test_the_tracker_follows_a_wing_drawn_from_the_draft(
    changes: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The truth is drawn from the draft's own wide priors; 25 s of it give the frequency within its sigma."""
    out, tables = tmp_path / "mine.toml", tmp_path / "flight"
    assert main(command(out, changes)) == 0
    assert main(["simulate", f"--airframe={out}", "--seed=3", "--duration=25", f"--out={tables}"]) == 0
    truth_hz = float(capsys.readouterr().out.partition("seed 3: ")[2].split()[0])
    assert main(["replay", str(tables), f"--airframe={out}", "--json"]) == 0
    wing = json.loads(capsys.readouterr().out)["wing"]
    assert wing["symmetric"] is not None, "it tracks"
    mode = wing["symmetric"]
    assert abs(mode["frequency_hz"] - truth_hz) <= 4.0 * mode["frequency_sigma_hz"]
    assert mode["frequency_sigma_hz"] < 0.05 * truth_hz
