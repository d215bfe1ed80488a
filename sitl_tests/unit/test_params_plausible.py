"""Airframes that cannot be are refused with key, value and range; those that travel with Spanwise are not."""

from __future__ import annotations

import dataclasses
import re

import pytest

from companion.errors import ConfigError
from companion.params import airframe as schema
from companion.params.airframe import Airframe, Uncertain
from companion.params.files import load_airframe, parse_airframe, shipped_airframes
from companion.params.plausible import RANGES, problems
from companion.params.shipped import shipped

NADIR = (shipped("airframes") / "nadir-2m.toml").read_text(encoding="utf-8")


def changed(section: str, key: str, value: str) -> str:
    """The demo's airframe with one line changed or put in."""
    before, after = NADIR, ""
    if section:
        head = f"[{section}]\n"
        at = NADIR.index(head) + len(head)
        before, after = NADIR[:at], NADIR[at:]
        body, *rest = re.split(r"(?m)^(?=\[)", after, maxsplit=1)
    else:
        body, *rest = re.split(r"(?m)^(?=\[)", NADIR, maxsplit=1)
        before = ""
    body = re.sub(rf"(?m)^{key} = .*\n", "", body)
    return before + f"{key} = {value}\n" + body + "".join(rest)


@pytest.mark.parametrize(
    ("section", "key", "value", "words"),
    [
        ("", "orientation", "99", "'orientation' = 99 is outside 0 to 39"),
        ("wing", "semispan_m", "1000.0", "'wing.semispan_m' = 1000 m is outside 0.05 to 50 m"),
        ("wing", "trim_bend_m", "1.4", "'wing.trim_bend_m' = 1.4 m is more than the semispan of 1 m"),
        ("wing.symmetric", "damping", "3.0", "'wing.symmetric.damping' = 3 is outside 0.0001 to 0.5"),
        ("wing.symmetric", "damping", "0.0", "'wing.symmetric.damping' = 0 is outside"),
        ("wing.symmetric", "frequency_hz", "5000.0", "frequency_hz' = 5000 Hz is outside 0.2 to 500 Hz"),
        ("wing.symmetric", "frequency_hz", "{ value = 5.0, sigma = -1.0 }", "must be a sigma >= 0, not -1"),
        ("wing.symmetric", "frequency_hz", "{ value = 5.0, sigma = 50.0 }", "frequency_hz.sigma' = 50 is outside"),
        ("wing.symmetric", "frequency_hz", "nan", "must be a finite number, not nan"),
        ("wing.gust", "deflection_rms_m", "0.0", "'wing.gust.deflection_rms_m' = 0 m is outside"),
        ("left", "rate_hz", "0.0", "'left.rate_hz' = 0 Hz is outside 5 to 50000 Hz"),
        ("left", "rate_hz", "9.0", "'left.rate_hz' = 9 Hz is below two samples a period"),
        ("left", "sends", '"xyw"', "'left.sends' = 'xyw' must be letters of 'xyzpqr'"),
        ("left", "sends", '""', "'left.sends' = ''"),
        ("left", "accel_noise_mps2_rthz", "0.0", "'left.accel_noise_mps2_rthz' = 0 m/s^2/rt Hz is outside 1e-08 to 10"),
        ("left", "gyro_noise_radps_rthz", "-0.1", "'left.gyro_noise_radps_rthz' = -0.1"),
        ("left", "accel_bias_sigma_mps2", "-0.1", "'left.accel_bias_sigma_mps2' = -0.1 m/s^2 is outside 0 to 20"),
        ("left", "position_m", "[0.0, 1.0, 0.0]", "'left.position_m' y = 1 m must be below 0"),
        ("right", "position_m", "[0.0, -1.0, 0.0]", "are they swapped, or on one side?"),
        ("right", "position_m", "[0.0, 3.0, 0.0]", "'right.position_m' y = 3 m is outside -1.5 to 1.5 m"),
        ("left_camera", "focal_px", "0.0", "'left_camera.focal_px' = 0 px is outside 10 to 1e+06 px"),
        ("left_camera", "width_px", "0", "'left_camera.width_px' = 0 px is outside 16 to 32768 px"),
        ("left_camera", "principal_px", "[5000.0, 240.0]", "principal_px' x = 5000 px is outside -640 to 1280"),
        ("left_camera", "position_m", "[0.0, 0.99, 0.0]", "= 0 m is below 0.01 m: the baseline"),
        ("left_camera", "axes", '["y", "x", "z"]', "right-handed"),
        ("left_camera", "axes", '["y", "y", "z"]', "'left_camera.axes'"),
        ("left_camera", "distortion", "[0.1]", "'left_camera.distortion' has 1 terms, not 5"),
        ("left_camera", "row_time_s", "0.009", "from row to row, not of the whole read-out"),
        ("left_camera", "exposure_s", "0.0", "'left_camera.exposure_s' = 0 s is outside"),
        ("left_camera", "stamp_sigma_s", "0.0", "no clock is without error"),
    ],
)  # fmt: skip
def test_what_no_aircraft_can_be_is_refused_with_key_value_and_range(
    section: str, key: str, value: str, words: str
) -> None:
    with pytest.raises(ConfigError, match=re.escape(words)) as caught:
        parse_airframe(changed(section, key, value), "my.toml")
    assert str(caught.value).startswith("my.toml: ")
    assert "\n" not in str(caught.value)


def test_left_and_right_swapped_are_refused() -> None:
    swapped = NADIR.replace("[left]", "[other]").replace("[right]", "[left]").replace("[other]", "[right]")
    with pytest.raises(ConfigError, match="are they swapped"):
        parse_airframe(swapped, "my.toml")


def test_one_camera_alone_is_refused() -> None:
    with pytest.raises(ConfigError, match="'right_camera' is missing"):
        parse_airframe(NADIR[: NADIR.index("[right_camera]")], "my.toml")


@pytest.mark.parametrize("name", shipped_airframes())
def test_what_travels_with_spanwise_is_plausible(name: str) -> None:
    assert not list(problems(load_airframe(name)))


def test_every_number_of_an_airframe_has_a_range() -> None:
    """A key that is added gets one, too."""
    numbers = ("float", "int", "Uncertain", "Vector3", "tuple[float, float]", "tuple[float, ...]")
    kinds = {kind.__name__: kind for kind in vars(schema).values() if dataclasses.is_dataclass(kind)}
    free = {"NamedEffect", "Uncertain"}  # an effect's parameters are its own; a sigma is ranged with its value
    for name in kinds.keys() - free:
        keys = {entry.name for entry in dataclasses.fields(kinds[name]) if entry.type in numbers}
        assert keys == RANGES.get(name, {}).keys(), name


def test_every_sigma_can_be_held_to_its_range() -> None:
    base = load_airframe("nadir-2m")
    wide = dataclasses.replace(base.wing, trim_bend_m=Uncertain(0.01, 30.0))
    (problem,) = problems(dataclasses.replace(base, wing=wide))
    assert problem == "'wing.trim_bend_m.sigma' = 30 m is outside 0 to 20 m"


def test_an_airframe_is_what_it_was(tmp_path: object) -> None:
    airframe = parse_airframe(changed("", "orientation", "0"), "my.toml")
    assert isinstance(airframe, Airframe)
    assert dataclasses.replace(airframe, orientation=25) == load_airframe("nadir-2m")
