"""Identification against structures that are known: poles, residues, shapes, ambient response, airframe file."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

from companion.calibration.ambient import AmbientMode, ambient_modes
from companion.calibration.flight_modes import WingMotion, _shared, wing_motion
from companion.calibration.modes import FrequencyResponse, IdentifiedMode, assurance, identify_runs, residues
from companion.calibration.poles import Pole, stable_poles
from companion.calibration.vibration import Point, frequency_response, read_vibration_test
from companion.calibration.wing_modes import airframe_with, bending_modes, stations, symmetry
from companion.cli import identify
from companion.cli.main import main
from companion.errors import ConfigError, SpanwiseError
from companion.params.files import dump_airframe, load_airframe, parse_airframe
from companion.records import Axis, ClockName, ImuBatch, Station

SPANS_M = (0.4, 0.6, 0.8, 1.0, 1.2)
CHORD_M = 0.12
TRUE = ((6.0, 0.02), (8.5, 0.015), (21.0, 0.01))  # symmetric, antisymmetric, a further symmetric one


def _points() -> list[Point]:
    points: list[Point] = []
    for side in (1.0, -1.0):
        for span in SPANS_M:
            for leading in (True, False):
                aft = 0.3 + (0.0 if leading else CHORD_M)
                points.append(Point(len(points) + 1, side * span, aft, leading))
    return points


def _shape(point: Point, kind: int) -> float:
    """Cubic bending on top of what a free wing does rigidly, with twist that grows outward (nose up)."""
    y = abs(point.span_m)
    nose = 0.5 if point.leading else -0.5
    bend = (y**3 - 0.1, y**3 + 0.2 * y, 2.0 * y**3 - 1.5 * y**2)[kind] + nose * CHORD_M * 0.3 * y
    return bend if kind != 1 or point.span_m > 0.0 else -bend


def _runs(noise: float = 0.0, seed: int = 0) -> list[FrequencyResponse]:
    """Two points per run, as roving accelerometers give them; unit modal masses, driven at the first point."""
    random, points = np.random.default_rng(seed), _points()
    frequency = np.arange(3.0, 30.0, 1 / 20)
    omega = 2 * np.pi * frequency
    runs = []
    for first in range(0, len(points), 2):
        response = np.zeros((2, len(frequency)), dtype=complex)
        for kind, (f, zeta) in enumerate(TRUE):
            receptance = 1.0 / ((2 * np.pi * f) ** 2 - omega**2 + 2j * zeta * omega * 2 * np.pi * f)
            drive = _shape(points[0], kind) or 1.0
            for row in range(2):
                response[row] += -(omega**2) * _shape(points[first + row], kind) * drive * receptance
        response += noise * (random.normal(size=response.shape) + 1j * random.normal(size=response.shape))
        runs.append(FrequencyResponse(f"run{first}", np.array([first, first + 1]), frequency, response))
    return runs


@functools.cache
def _clean() -> list[IdentifiedMode]:
    return identify_runs(_runs(), len(_points()))


def test_poles_of_a_noise_free_response_are_exact() -> None:
    run = _runs()[3]
    poles = stable_poles(run.frequency_hz, run.response)
    assert [round(pole.frequency_hz, 4) for pole in poles] == [6.0, 8.5, 21.0]
    assert [pole.damping for pole in poles] == pytest.approx([0.02, 0.015, 0.01], rel=1e-3)


@pytest.mark.slow
def test_modes_of_a_noisy_test_lie_within_their_scatter() -> None:
    modes = identify_runs(_runs(noise=0.01, seed=3), len(_points()))
    assert len(modes) == 3
    for kind, (mode, (f, zeta)) in enumerate(zip(modes, TRUE, strict=True)):
        many = np.sqrt(mode.runs)
        assert abs(mode.frequency_hz - f) < 5 * mode.frequency_sigma_hz / many + 1e-4 * f
        assert abs(mode.damping - zeta) < 5 * mode.damping_sigma / many + 0.01 * zeta
        true = np.array([_shape(point, kind) for point in _points()])
        assert assurance(mode.shape, true) > 0.998
        assert mode.assurance > 0.99


@pytest.mark.slow
def test_shape_sigma_tells_the_scatter_of_the_shape() -> None:
    true = np.array([_shape(point, 0) for point in _points()])
    unit = []
    for seed in range(3):
        mode = identify_runs(_runs(noise=0.03, seed=seed), len(true))[0]
        error = mode.shape - true * (mode.shape @ true) / (true @ true)
        unit.append(np.sqrt(np.mean(error**2) / np.mean(mode.shape_sigma**2)))
    assert 0.5 < np.mean(unit) < 2.0


def test_residues_of_a_sum_of_modes_are_found_with_close_neighbours() -> None:
    omega = 2 * np.pi * np.arange(4.0, 12.0, 0.02)
    poles = [Pole(7.0, 0.01, 1.0), Pole(7.2, 0.012, 1.0)]
    true = np.array([[0.3 - 1.0j, 0.1 + 0.7j]])
    response = sum(
        -(omega**2) * (r / (1j * omega - p.value) + np.conj(r) / (1j * omega - np.conj(p.value)))
        for r, p in zip(true[0], poles, strict=True)
    )
    assert np.allclose(residues(omega / 2 / np.pi, response[np.newaxis], poles), true, rtol=1e-6)


@pytest.mark.slow
def test_symmetric_and_antisymmetric_modes_are_told_apart() -> None:
    points = _points()
    likeness = [symmetry(mode, points) for mode in _clean()]
    assert likeness == pytest.approx([1.0, -1.0, 1.0], abs=1e-3)


@pytest.mark.slow
def test_slope_and_twist_at_the_tip_come_out_of_the_cubic() -> None:
    """Relative to the root, which moves by -0.1: slope 3 y^2 / y^3, twist 0.3 y, y = 1.2; points begin at 0.4 m."""
    points = _points()
    first = bending_modes(_clean(), points)[0]
    assert first.factors.slope_factor_radpm == pytest.approx(3 / 1.2, rel=0.01)
    assert first.factors.twist_factor_radpm == pytest.approx(0.3 / 1.2**2, rel=0.01)


_BEAM_M = np.linspace(0.0, 1.0, 201)


def _clamped_cubic(y: np.ndarray) -> np.ndarray:
    """The shape of a cantilever under a load at its tip."""
    return np.asarray(0.5 * (3.0 * y**2 - y**3))


def _uniform_beam(y: np.ndarray) -> np.ndarray:
    """First mode of a uniform cantilever (Blevins 1979): beta L = 1.875104, sigma = 0.734096."""
    x, ratio = 1.875104069 * y, 0.734095514
    return np.asarray(0.5 * (np.cosh(x) - np.cos(x) - ratio * (np.sinh(x) - np.sin(x))))


@pytest.mark.parametrize("shape", [_clamped_cubic, _uniform_beam])
@pytest.mark.parametrize("innermost_m", [0.05, 0.15, 0.3, 0.4])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_clamped_wing_s_slope_comes_back_wherever_its_points_begin(
    shape: Callable[[np.ndarray], np.ndarray], innermost_m: float, sign: float
) -> None:
    """A free wing: the root heaves and pitches, or rolls. Of the inboard bend nothing is taken for that motion."""
    points = [
        Point(0, side * span, 0.2 * span + (0.0 if leading else 0.2), leading)
        for side in (1.0, -1.0)
        for span in np.linspace(innermost_m, 1.0, 5)
        for leading in (True, False)
    ]
    y, aft_m = np.array([abs(point.span_m) for point in points]), np.array([point.aft_m for point in points])
    halves = np.array([1.0 if point.span_m > 0.0 else sign for point in points])
    moved = halves * (shape(y) + (-0.3 - 0.1 * aft_m if sign > 0.0 else -0.4 * y))
    mode = dataclasses.replace(_clean()[0], shape=moved, shape_sigma=np.zeros_like(moved))
    (first,) = bending_modes([mode], points)
    slope, sigma = first.factors.slope_factor_radpm, float(np.sqrt(first.factors.covariance[1, 1]))
    true = float(np.gradient(shape(_BEAM_M), _BEAM_M, edge_order=2)[-1] / shape(_BEAM_M)[-1])
    assert slope == pytest.approx(true, rel=1e-4 if shape is _clamped_cubic else 0.04)
    assert abs(slope - true) < 2.0 * sigma
    assert 0.02 * slope <= sigma * 1.001 < 0.06 * slope, "never about none"


@pytest.mark.slow
def test_cameras_inside_of_the_sensors_get_their_own_slope_and_deflection() -> None:
    """Relative to the root, y^3 and its slope 3 y^2: sensors at 1.0 m, cameras at 0.8 m."""
    base = load_airframe("nadir-2m")
    left, right = (
        dataclasses.replace(camera, position_m=(0.0, 0.8 * side, 0.0))
        for side, camera in ((-1.0, base.left_camera), (1.0, base.right_camera))
        if camera is not None
    )
    base = dataclasses.replace(base, left_camera=left, right_camera=right)
    made = airframe_with(base, bending_modes(_clean(), _points()))
    assert made.wing.symmetric.slope_factor_radpm.value == pytest.approx(3.0, rel=0.01)
    for camera in (made.left_camera, made.right_camera):
        assert camera is not None
        assert camera.slope_gain == pytest.approx(0.8**2, rel=0.01)
        assert camera.lift_gain == pytest.approx(0.8**3, rel=0.01)
    assert stations(base, bending_modes(_clean(), _points())).notes == (
        "the innermost points lie 0.40 m from the root: the bend inboard of them was not measured and is taken to be a "
        "clamped wing's",
        "points reach 1.20 m, the base airframe's semispan is 1.00 m",
    )


def test_bend_and_gusts_are_brought_to_the_frequency_that_was_found() -> None:
    """Deflection = load / (mass omega^2); under white load its variance goes with omega^-3. A third is not known."""
    base = load_airframe("nadir-2m")
    wing = airframe_with(base, bending_modes(_clean(), _points())).wing
    slower = base.wing.symmetric.frequency_hz.value / wing.symmetric.frequency_hz.value
    assert wing.trim_bend_m.value == pytest.approx(base.wing.trim_bend_m.value * slower**2, rel=1e-3)
    assert wing.bend_per_g_m.value == pytest.approx(base.wing.bend_per_g_m.value * slower**2, rel=1e-3)
    rms_m = base.wing.gust.deflection_rms_m
    assert wing.gust.deflection_rms_m.value == pytest.approx(rms_m.value * slower**1.5, rel=1e-3)
    for belief in (wing.trim_bend_m, wing.bend_per_g_m, wing.gust.deflection_rms_m):
        assert belief.sigma > 0.3 * belief.value


def test_a_line_narrower_than_the_record_resolves_is_no_bending_mode() -> None:
    """At 20 s of record lines are 0.05 Hz apart; 6 Hz at 2 % is 4.8 lines wide, at 0.5 % 1.2."""
    mode = _clean()[0]
    assert mode.bandwidth_lines == pytest.approx(2 * 0.02 * 6.0 / 0.05, rel=0.01)
    narrow = dataclasses.replace(mode, bandwidth_lines=mode.bandwidth_lines / 4.0)
    assert [each.mode for each in bending_modes([mode], _points())] == [mode]
    assert bending_modes([narrow], _points()) == []


def test_what_is_written_reads_back_with_the_modes_in_it() -> None:
    points = _points()
    airframe = airframe_with(load_airframe("nadir-2m"), bending_modes(_clean(), points))
    again = parse_airframe(dump_airframe(airframe), "written")
    assert again == airframe
    assert again.wing.symmetric.frequency_hz.value == pytest.approx(6.0, abs=0.01)
    assert again.wing.antisymmetric.frequency_hz.value == pytest.approx(8.5, abs=0.01)
    with pytest.raises(ConfigError, match="no symmetric"):
        airframe_with(load_airframe("nadir-2m"), [])


def test_too_few_stations_and_an_unmeasured_point_are_told() -> None:
    points, modes = _points(), _clean()
    few = [index for index, point in enumerate(points) if abs(point.span_m) > 0.7]
    fewer = [dataclasses.replace(mode, shape=mode.shape[few]) for mode in modes]
    with pytest.raises(ConfigError, match="leading edge has 3 span stations a side, 5 are needed"):
        bending_modes(fewer, [points[index] for index in few])
    shape = modes[0].shape.copy()
    shape[3] = np.nan
    with pytest.raises(ConfigError, match="no run of the layout measured point 4"):
        bending_modes([dataclasses.replace(modes[0], shape=shape)], points)


@pytest.mark.parametrize("band_hz", [(40.0, 2.0), (120.0, 150.0), (5.0, 5.01), (-1.0, 20.0)])
def test_a_band_that_cannot_be_is_refused(band_hz: tuple[float, float]) -> None:
    still = np.zeros(4000)
    with pytest.raises(ConfigError, match="give the lower frequency first"):
        WingMotion(200.0, still, still).modes(band_hz)


@pytest.mark.parametrize(
    ("band_hz", "rows", "complaint"),
    [
        ([200.0, 280.0], 4000, "up to half of rate_hz"),
        ([30.0, 2.0], 4000, "lower first"),
        ('"x"', 4000, "band_hz must be two frequencies, as"),
        ("[2.0]", 4000, "band_hz must be two frequencies, as"),
        ([2.0, 30.0], 1, "never changes"),
        ([2.0, 30.0], 40, "5 lines of the spectrum lie in band_hz, 16 are needed"),
    ],
)
def test_a_layout_whose_band_shows_nothing_is_refused(
    band_hz: list[float] | str, rows: int, complaint: str, tmp_path: Path
) -> None:
    noise = np.random.default_rng(0).normal(size=(rows, 2))
    with pytest.raises(SpanwiseError, match=complaint):
        read_vibration_test(_layout(tmp_path, band_hz), tmp_path, lambda _path: {"signalIn": noise})


def _layout(tmp_path: Path, band_hz: list[float] | str) -> Path:
    """One run of one accelerometer."""
    layout = tmp_path / "layout.toml"
    layout.write_text(
        f"""rate_hz = 200.0
band_hz = {band_hz}
force = {{ column = 0, newton_per_volt = 1.0 }}
accelerometers = {{ columns = [1], mps2_per_volt = 1.0 }}
points = [{{ number = 1, span_m = 0.5, aft_m = 0.0, edge = "leading" }}]
runs = [{{ file = "run.mat", points = [1] }}]
"""
    )
    (tmp_path / "run.mat").touch()
    return layout


@pytest.mark.parametrize(
    ("wrong", "right", "complaint"),
    [
        ('"Leading"', '"leading"', "edge of point 1 must be leading or trailing, not 'Leading'"),
        (
            "points = [1, 2] }]",
            "points = [1] }]",
            r"the run of run\.mat names 2 points for 1 columns of accelerometers",
        ),
        ("points = [2] }]", "points = [1] }]", r"the run of run\.mat names point 2, which is not among the points"),
        ("runs = []", 'runs = [{ file = "run.mat", points = [1] }]', "runs is empty"),
        (
            'edge = "leading" }, { number = 1, span_m = 0.7, aft_m = 0.0, edge = "leading" }]',
            'edge = "leading" }]',
            "point 1 stands twice in points",
        ),
    ],
)
def test_a_layout_whose_points_and_runs_do_not_fit_is_refused(
    wrong: str, right: str, complaint: str, tmp_path: Path
) -> None:
    layout = _layout(tmp_path, [2.0, 30.0])
    text = layout.read_text()
    assert right in text
    layout.write_text(text.replace(right, wrong))
    noise = np.random.default_rng(0).normal(size=(4000, 2))
    with pytest.raises(ConfigError, match=rf"layout\.toml: a value that cannot be: {complaint}"):
        read_vibration_test(layout, tmp_path, lambda _path: {"signalIn": noise})


def test_a_run_with_a_sample_that_is_no_number_is_refused(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).normal(size=(4000, 2))
    noise[500, 1] = np.nan
    with pytest.raises(SpanwiseError, match="column 1 has samples that are no numbers"):
        read_vibration_test(_layout(tmp_path, [2.0, 30.0]), tmp_path, lambda _path: {"signalIn": noise})


def test_a_run_without_poles_has_no_residues() -> None:
    """No pole comes back where the force is the wrong column."""
    run = _runs()[0]
    assert residues(run.frequency_hz, run.response, []).shape == (2, 0)


def test_a_mode_of_a_single_run_keeps_the_relative_sigmas_of_the_base(tmp_path: Path) -> None:
    runs, points, base = _runs(), _points(), load_airframe("nadir-2m")
    every = np.concatenate([run.response for run in runs])
    modes = identify_runs([FrequencyResponse("all", np.arange(len(points)), runs[0].frequency_hz, every)], len(points))
    assert [mode.runs for mode in modes] == [1, 1, 1]
    made = airframe_with(base, bending_modes(modes, points))
    assert parse_airframe(dump_airframe(made), "written") == made
    for mode, believed in (
        (made.wing.symmetric, base.wing.symmetric),
        (made.wing.antisymmetric, base.wing.antisymmetric),
    ):
        for name in ("frequency_hz", "damping"):
            now, before = getattr(mode, name), getattr(believed, name)
            assert now.sigma / now.value == pytest.approx(before.sigma / before.value, rel=0.01)
    identify._write_numbers([identify._plain(mode) for mode in modes], tmp_path)
    assert json.loads((tmp_path / "modes.json").read_text())[0]["frequency_sigma_hz"] is None


def test_a_sweep_gives_the_response_of_the_filter_it_went_through() -> None:
    rate_hz, n = 500.0, 20000
    t = np.arange(n) / rate_hz
    force = np.sin(2 * np.pi * (2.0 * t + 0.5 * t**2)) * np.hanning(n)
    answer = np.roll(force, 3) * 0.5
    run = frequency_response(force, answer[:, np.newaxis], rate_hz, (5.0, 30.0))
    assert np.allclose(run.response[0], 0.5 * np.exp(-2j * np.pi * run.frequency_hz * 3 / rate_hz), atol=1e-9)


def _gust_driven(seed: int, modes: tuple[tuple[float, float, float], ...], seconds: float) -> np.ndarray:
    """Acceleration of modes under white load: exact discretisation, rate 200 Hz."""
    random, rate_hz = np.random.default_rng(seed), 200.0
    n = round(seconds * rate_hz)
    total = 0.02 * random.standard_normal(n)
    for f, zeta, gain in modes:
        omega = 2 * np.pi * f
        a = np.array([[0.0, 1.0], [-(omega**2), -2 * zeta * omega]])
        step = expm(a / rate_hz)
        held = np.linalg.solve(a, (step - np.eye(2)) @ np.array([0.0, 1.0]))
        state, load = np.zeros(2), random.standard_normal(n)
        for k in range(n):
            total[k] += gain * (a[1] @ state + load[k])
            state = step @ state + held * load[k]
    return total


@pytest.mark.slow
def test_modes_of_a_gusty_flight_lie_within_their_sigma() -> None:
    """Three minutes of two modes; at least 5 Hz x 180 s = 900 cycles, so f to about sqrt(zeta/(omega T)) = 0.2 %."""
    modes = ((5.0, 0.03, 1.0), (27.0, 0.02, 0.3))
    unit = []
    for seed in range(3):
        estimates = ambient_modes(_gust_driven(seed, modes, 180.0)[:, np.newaxis], 200.0, (2.0, 40.0))
        assert len(estimates) == 2
        for mode, (f, zeta, _) in zip(estimates, modes, strict=True):
            assert mode.frequency_hz == pytest.approx(f, rel=0.01)
            assert mode.damping == pytest.approx(zeta, rel=0.4)
            unit.append((mode.frequency_hz - f) / mode.frequency_sigma_hz)
    # six blocks give a Student's t of 5 degrees of freedom: rms 1.3
    assert 0.4 < np.sqrt(np.mean(np.square(unit))) < 2.5


@pytest.mark.slow
def test_one_mode_of_a_minute_in_gusts_is_as_far_off_as_its_sigmas_say() -> None:
    """The blocks' scatter alone left the damping 1.9 sigma off rms, 7.5 where a record and its blocks disagree."""
    over = []
    for seed in range(24):
        estimates = ambient_modes(_gust_driven(seed, ((6.8, 0.05, 1.0),), 60.0)[:, np.newaxis], 200.0, (2.0, 40.0))
        mode = min(estimates, key=lambda entry: abs(entry.frequency_hz - 6.8))
        over += [((mode.frequency_hz - 6.8) / mode.frequency_sigma_hz, (mode.damping - 0.05) / mode.damping_sigma)]
    rms = np.sqrt(np.mean(np.square(over), axis=0))
    assert np.all((rms > 0.6) & (rms < 1.5))
    assert np.abs(over).max() < 4.5


def test_a_steady_tone_is_no_mode_of_the_wing() -> None:
    """A sine in noise decays never; a mode of 1 % damping does, within the window of the correlations."""
    t = np.arange(round(60.0 * 200.0)) / 200.0
    tone = np.sin(2.0 * np.pi * 7.3 * t) + 0.05 * np.random.default_rng(1).standard_normal(len(t))
    estimates = ambient_modes(tone[:, np.newaxis], 200.0, (2.0, 40.0))
    assert [mode.resolved for mode in estimates if abs(mode.frequency_hz - 7.3) < 0.1] in ([], [False])
    wing = _gust_driven(3, ((7.3, 0.01, 1.0),), 60.0)
    (mode,) = (mode for mode in ambient_modes(wing[:, np.newaxis], 200.0, (2.0, 40.0)) if mode.frequency_hz < 10.0)
    assert mode.resolved


def test_the_longest_segment_holds_no_gap_of_any_station() -> None:
    """One gap within another's, and one that began before the last station did."""
    second = 1_000_000_000
    grid = np.arange(0, 60 * second, second // 100)
    values = np.zeros((len(grid), 6))

    def without(*gaps: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        keep = np.ones(len(grid), dtype=bool)
        for start_s, end_s in gaps:
            keep &= (grid <= start_s * second) | (grid >= end_s * second)
        return grid[keep], values[keep]

    nested = {Station.ROOT: without((10.0, 40.0)), Station.LEFT: without((12.0, 13.0)), Station.RIGHT: without()}
    assert np.array(_shared(nested)) == pytest.approx([40.0 * second, 59.99 * second])
    early = {Station.ROOT: without((5.0, 30.0)), Station.LEFT: without((-1.0, 8.0)), Station.RIGHT: without()}
    assert np.array(_shared(early)) == pytest.approx([30.0 * second, 59.99 * second])


def test_a_tip_that_does_not_move_is_refused() -> None:
    """Half of the other tip's motion is in either family then."""
    t_ns = np.arange(0, 30_000_000_000, 5_000_000)
    values = np.random.default_rng(0).standard_normal((len(t_ns), 6))
    still = np.full_like(values, -9.8)
    batches = [
        ImuBatch(station, ClockName.HOST, t_ns, still if station is Station.RIGHT else values, Axis.Z, 0)
        for station in Station
    ]
    with pytest.raises(SpanwiseError, match="check the sensor of the right tip"):
        wing_motion(batches, load_airframe("nadir-2m"), ClockName.HOST)


def test_families_of_one_frequency_are_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mode = AmbientMode(5.1, 0.02, 0.03, 0.005, 6)
    twins = SimpleNamespace(modes=lambda _: {"symmetric": [mode], "antisymmetric": [mode]})
    recording = SimpleNamespace(airframe=load_airframe("nadir-2m"), records=list, hub=None)
    monkeypatch.setattr(identify, "open_recording", lambda *_: recording)
    monkeypatch.setattr(identify, "wing_motion", lambda *_: twins)
    monkeypatch.setattr(identify, "draw_flight", lambda *_: None)
    assert main(["identify", "flight", "flight.mcap", "--out", str(tmp_path)]) == 0
    assert "note: both families show 5.10 Hz" in capsys.readouterr().out


def test_files_of_a_flight_without_modes_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    calm = SimpleNamespace(modes=lambda _: {"symmetric": [], "antisymmetric": []})
    recording = SimpleNamespace(airframe=load_airframe("nadir-2m"), records=list, hub=None)
    monkeypatch.setattr(identify, "open_recording", lambda *_: recording)
    monkeypatch.setattr(identify, "wing_motion", lambda *_: calm)
    monkeypatch.setattr(identify, "draw_flight", lambda *_: None)
    assert main(["identify", "flight", "flight.mcap", "--out", str(tmp_path)]) == 3
    assert f"{tmp_path / 'modes.json'} and spectra.png have what there is" in capsys.readouterr().out
    assert (tmp_path / "modes.json").is_file()
