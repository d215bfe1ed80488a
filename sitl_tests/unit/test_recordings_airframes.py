"""The airframes that travel with Spanwise: they load, come back from TOML equal, and believe plausible things."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from companion.adapters.mavlink.decode.source_map import build_mapping
from companion.adapters.recordings.tables.csv import CsvRecording
from companion.errors import TableError
from companion.params import airframe as schema
from companion.params.airframe import Airframe, Uncertain
from companion.params.files import dump_airframe, load_airframe, parse_airframe, shipped_airframes
from companion.params.toml import parse_toml, quoted
from companion.records import Station

CONFIG = Path(__file__).resolve().parents[2] / "config"
NAMES = sorted(path.stem for path in (CONFIG / "airframes").glob("*.toml"))
AXIS = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}


@pytest.fixture(params=NAMES)
def airframe(request: pytest.FixtureRequest) -> Airframe:
    return load_airframe(request.param)


def test_all_of_them_travel_with_the_package() -> None:
    assert sorted(shipped_airframes()) == NAMES
    assert {"forward-2m", "nadir-2m", "paper-beam", "paper-flying-wing", "sitl-plane"} <= set(NAMES)


def test_it_comes_back_from_toml_equal_and_can_be_mapped(airframe: Airframe) -> None:
    assert parse_airframe(dump_airframe(airframe), "copy") == airframe
    assert len(build_mapping(airframe).sources) == 3


@pytest.mark.parametrize("text", ["\x07", "a\r\nb", "\x7f", "\t", "\x00", 'a"b\\\n', "é"])
def test_any_text_that_a_file_may_hold_comes_back(text: str) -> None:
    """A recording by an airframe with a control character in its description could not be read again."""
    described = dataclasses.replace(load_airframe("nadir-2m"), description=text)
    assert parse_airframe(dump_airframe(described), "copy") == described


def test_bytes_that_are_no_text_are_spelled() -> None:
    assert parse_toml(f"path = {quoted('serial:a' + chr(0xDCFF))}", "copy") == {"path": "serial:a\\udcff"}


def test_left_and_right_are_mirror_images(airframe: Airframe) -> None:
    def mirrored(thing: object) -> object:
        x, y, z = thing.position_m  # type: ignore[attr-defined]
        return dataclasses.replace(thing, position_m=(x, -y, z))  # type: ignore[type-var]

    source = airframe.right.source
    assert dataclasses.replace(airframe.left, source=source) == mirrored(airframe.right)
    assert airframe.left.position_m[1] < 0
    assert (airframe.left_camera is None) == (airframe.right_camera is None)
    if airframe.right_camera is not None:
        assert airframe.left_camera == mirrored(airframe.right_camera)


def test_every_belief_that_matters_has_a_sigma_of_a_sensible_size(airframe: Airframe) -> None:
    wing = airframe.wing
    for mode in (wing.symmetric, wing.antisymmetric):
        for belief in (mode.frequency_hz, mode.damping, mode.slope_factor_radpm):
            assert 0.005 < belief.sigma / belief.value < 1.0
    for static in (wing.trim_bend_m, wing.bend_per_g_m):
        assert isinstance(static, Uncertain)
        assert static.sigma > 0
    assert 0 < wing.gust.deflection_rms_m.sigma < wing.gust.deflection_rms_m.value


def test_cameras_are_right_handed_and_look_where_the_orientation_says(airframe: Airframe) -> None:
    looks = {25: (0, 0, 1), 0: (1, 0, 0)}
    for camera in (airframe.left_camera, airframe.right_camera):
        if camera is None:
            continue
        axes = np.array([np.array(AXIS[name[-1]]) * (-1 if name[0] == "-" else 1) for name in camera.axes])
        assert np.linalg.det(axes) == pytest.approx(1.0)
        assert tuple(axes[2]) == looks[airframe.orientation]
        assert tuple(axes[0]) == (0, 1, 0), "image columns run along the baseline, left to right"


def test_the_baselines_are_the_papers() -> None:
    for name, baseline_m in (("paper-beam", 10 * 0.0254), ("paper-flying-wing", 1.98)):
        airframe = load_airframe(name)
        assert airframe.left_camera is not None
        assert airframe.right_camera is not None
        across_m = airframe.right_camera.position_m[1] - airframe.left_camera.position_m[1]
        assert across_m == pytest.approx(baseline_m)
        assert (airframe.left_camera.width_px, airframe.left_camera.height_px) == (640, 480)


def test_the_beam_is_a_cantilever_with_the_tip_mass_that_fits_the_papers_frequencies() -> None:
    mass_ratio, scale_radps, length_m = 2.389, 118.156, 0.1115
    beta_l = brentq(
        lambda x: 1 + np.cos(x) * np.cosh(x) + mass_ratio * x * (np.cos(x) * np.sinh(x) - np.sin(x) * np.cosh(x)),
        0.5,
        1.5,
    )
    ratio = (np.cos(beta_l) + np.cosh(beta_l)) / (np.sin(beta_l) + np.sinh(beta_l))
    deflection = np.cosh(beta_l) - np.cos(beta_l) - ratio * (np.sinh(beta_l) - np.sin(beta_l))
    slope = beta_l * (np.sinh(beta_l) + np.sin(beta_l) - ratio * (np.cosh(beta_l) - np.cos(beta_l)))
    beam = load_airframe("paper-beam").wing
    assert beam.semispan_m == length_m
    assert beam.symmetric.slope_factor_radpm.value == pytest.approx(slope / deflection / length_m, rel=1e-4)
    assert beam.symmetric.frequency_hz.value == pytest.approx(scale_radps * beta_l**2 / (2 * np.pi), rel=2e-4)
    # with the tip mass alone the participation is 1, with the beam's own mass a little more
    quasi_static_m = -9.80665 / (scale_radps * beta_l**2) ** 2
    assert 1.0 < beam.bend_per_g_m.value / quasi_static_m < 1.1


def test_sitl_plane_takes_the_three_imus_as_stations_and_undoes_what_ardupilot_does_to_them() -> None:
    airframe = load_airframe("sitl-plane")
    messages = [airframe.sensor(station).source.message for station in Station]
    assert messages == ["RAW_IMU", "SCALED_IMU2", "SCALED_IMU3"]
    assert [airframe.sensor(station).source.stamp_offset_s for station in Station] == [0.0, 0.0005, 0.0005]
    for station in Station:
        assert airframe.sensor(station).sends == "z"
        assert airframe.sensor(station).lowpass_accel_hz == 20.0
    assert airframe.left_camera is None


def test_the_readme_tells_every_key() -> None:
    text = (CONFIG / "README.md").read_text()
    kinds = [kind for kind in vars(schema).values() if dataclasses.is_dataclass(kind) and kind is not Uncertain]
    names = {entry.name for kind in kinds for entry in dataclasses.fields(kind)}
    missing = [name for name in sorted(names) if not re.search(rf"\b{name}\b", text)]
    assert missing == [], "config/README.md explains each key of an airframe file"
    unnamed = [name for name in shipped_airframes() if f"`{name}`" not in text]
    assert unnamed == [], "config/README.md has a row for each airframe"


def test_the_readmes_csv_example_and_its_error_are_true(tmp_path: Path) -> None:
    text = (CONFIG / "README.md").read_text()
    (example,) = re.findall(r"```\n(t_s,.*?)```", text, re.DOTALL)
    (tmp_path / "accel.csv").write_text(example)
    recording = CsvRecording(tmp_path, load_airframe("nadir-2m"))
    assert [stream.station for stream in recording.streams] == [Station.LEFT, Station.RIGHT]
    assert recording.covariates.keys() == {"airspeed_mps"}
    (tmp_path / "accel.csv").write_text(example.replace("-9.815", "nan"))
    with pytest.raises(TableError) as caught:
        CsvRecording(tmp_path, load_airframe("nadir-2m"))
    assert str(caught.value).replace(str(tmp_path), "lab") in text


def test_an_airframe_with_numpy_s_floats_is_written_as_numbers() -> None:
    """As an identification leaves them."""
    base = load_airframe("nadir-2m")
    wing = dataclasses.replace(base.wing, trim_bend_m=Uncertain(np.float64(0.5), np.float64(0.1)))
    written = dump_airframe(dataclasses.replace(base, wing=wing))
    assert parse_airframe(written, "here").wing.trim_bend_m == Uncertain(0.5, 0.1)
