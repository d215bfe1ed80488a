"""``spanwise new-airframe``: the first airframe file, from a few questions or as many options."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from companion.calibration.airframe_draft import (
    Measured,
    bend_per_g_m,
    default_antisymmetric_hz,
    default_frequency_sigma_hz,
    draft,
    tip_trim_bend_m,
    trim_bend_m,
    trusted_to_m,
)
from companion.cli.steps.options import check_output
from companion.errors import ConfigError
from companion.params.files import load_airframe, parse_airframe
from companion.params.plausible import RANGES

Answers = dict[str, Any]
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Question:
    """One number: its option, what is asked, its unit and range, and what is taken where nothing is answered.

    ``default`` is a value, or what computes it from the answers before; None: it must be answered.
    """

    key: str
    text: str
    unit: str
    minimum: float
    maximum: float
    default: float | Callable[[Answers], float] | None = None
    cameras: bool = False

    def suggestion(self, answers: Answers) -> float | None:
        """The default in the light of the answers before."""
        return self.default(answers) if callable(self.default) else self.default

    def checked(self, text: str) -> float:
        """The number that was written.

        Raises
        ------
        ConfigError
            It is no number, or outside what an aircraft can be; the message names key, value and range.
        """
        try:
            value = float(text)
        except ValueError as error:
            raise ConfigError(f"{self.key}: '{text}' is not a number ({self.unit})") from error
        if not self.minimum <= value <= self.maximum:
            span = f"{self.minimum:g} to {self.maximum:g} {self.unit}"
            raise ConfigError(f"{self.key} = {value:g} {self.unit} is outside {span}; is the unit right?")
        return value


def _of_file(
    kind: str, key: str, text: str, default: float | Callable[[Answers], float] | None = None, name: str = ""
) -> Question:
    """A question for a key of the airframe file, with the unit and range that the file's own check has."""
    limits = RANGES[kind][key]
    return Question(name or key, text, limits.unit, limits.minimum, limits.maximum, default, cameras=kind == "Camera")


_NUMBERS = (
    _of_file("Wing", "semispan_m", "semispan, centreline to tip"),
    _of_file("Mode", "frequency_hz", "first bending frequency (tap the wing, count or record)"),
    Question(
        "frequency_sigma_hz", "how far that may be off in flight", "Hz", 1e-3, 500.0,
        lambda a: default_frequency_sigma_hz(a["frequency_hz"]),
    ),
    _of_file(
        "Mode", "frequency_hz", "the same, tips opposed", lambda a: default_antisymmetric_hz(a["frequency_hz"]),
        name="antisymmetric_hz",
    ),
    Question("mass_kg", "all-up mass", "kg", 0.05, 5000.0),
    Question("wing_mass_kg", "mass of both wing halves", "kg", 0.01, 4500.0, lambda a: 0.5 * a["mass_kg"]),
    Question("station_y_m", "centreline to node and camera", "m", 0.01, 50.0, lambda a: 0.99 * a["semispan_m"]),
    _of_file("Camera", "focal_px", "focal length (mm over pixel pitch in mm)"),
    _of_file("Sensor", "rate_hz", "rate of the autopilot's IMU messages", 333.0, name="imu_rate_hz"),
    _of_file("Sensor", "lowpass_accel_hz", "INS_ACCEL_FILTER, 0 for none", 20.0, name="accel_filter_hz"),
    _of_file("Sensor", "rate_hz", "rate of the wing nodes", 1000.0, name="node_rate_hz"),
)  # fmt: skip
_LOOKS = ("down", "forward", "none")
_TIP_AXES = ("xyzpqr", "z")
_IMAGE = "1280x800"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.toml", help="the file to write")
    parser.add_argument("--force", action="store_true", help="overwrite it")
    parser.add_argument("--name", help="of the aircraft (default: that of the file)")
    for entry in _NUMBERS:
        default = f"; default {entry.default:g}" if isinstance(entry.default, float) else ""
        parser.add_argument(
            _option(entry.key), metavar=entry.unit.upper(),
            help=f"{entry.text}, {entry.minimum:g} to {entry.maximum:g} {entry.unit}{default}",
        )  # fmt: skip
    parser.add_argument("--looks", choices=_LOOKS, help="where the cameras look; default down")
    parser.add_argument("--image", metavar="WxH", help=f"image size in pixels; default {_IMAGE}")
    parser.add_argument("--tip-axes", choices=_TIP_AXES, help="6-axis nodes, or one vertical accelerometer each")
    parser.add_argument(
        "--hanging", action=argparse.BooleanOptionalAction,
        help="the cameras are calibrated with the wing hanging by its own weight (default), or laid straight",
    )  # fmt: skip
    parser.add_argument("--defaults", action="store_true", help="ask nothing that has a default")


def execute(options: argparse.Namespace) -> int:
    """Ask, draft, check, write, and say what comes next."""
    _check_out(options)
    measured = _measured(options)
    text = draft(measured)
    parse_airframe(text, str(options.out))
    try:
        options.out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write {options.out}: {error.strerror}") from error
    load_airframe(str(options.out))
    print(_next(measured, options.out))
    return 0


def _check_out(options: argparse.Namespace) -> None:
    if options.out.suffix != ".toml":
        raise ConfigError(f"--out {options.out}: an airframe file ends in .toml")
    if options.out.exists() and not options.force:
        raise ConfigError(f"--out {options.out}: is there already; give another name, or --force")
    check_output(options.out, "--out")  # before a dozen questions are answered for nothing


def _measured(options: argparse.Namespace) -> Measured:
    asks = sys.stdin.isatty() and not options.defaults
    looks = options.looks or (_choose("where the cameras look", _LOOKS) if asks else _LOOKS[0])
    answers: Answers = {"name": _name(options), "looks": looks}
    for entry in _NUMBERS:
        if entry.cameras and looks == "none":
            answers[entry.key] = 0.0
        else:
            answers[entry.key] = _number(entry, getattr(options, entry.key), answers, sys.stdin.isatty(), asks)
    answers["width_px"], answers["height_px"] = _size(options, asks and looks != "none")
    answers["tip_axes"] = options.tip_axes or (
        _choose("axes of the wing nodes (x y z accelerations, p q r rates)", _TIP_AXES) if asks else _TIP_AXES[0]
    )
    hanging = options.hanging
    if hanging is None:
        words = ("hanging", "straight")
        hanging = not asks or _choose("the wing during the stereo calibration", words) == words[0]
    measured = Measured(**answers, hanging=hanging)
    _check_together(measured)
    return measured


def _check_together(measured: Measured) -> None:
    """Refuse numbers that contradict each other."""
    if measured.wing_mass_kg >= 0.98 * measured.mass_kg:
        raise ConfigError(
            f"wing_mass_kg = {measured.wing_mass_kg:g} kg of mass_kg = {measured.mass_kg:g} kg: at most 98 %; "
            "what sits in the fuselage bends the wing"
        )
    if measured.station_y_m > measured.semispan_m:
        raise ConfigError(f"station_y_m = {measured.station_y_m:g} m is beyond semispan_m = {measured.semispan_m:g} m")
    if measured.frequency_sigma_hz > 0.5 * measured.frequency_hz:
        raise ConfigError(
            f"frequency_sigma_hz = {measured.frequency_sigma_hz:g} Hz is more than half of frequency_hz = "
            f"{measured.frequency_hz:g} Hz; tap the wing and count"
        )
    tip_m = tip_trim_bend_m(measured)
    if tip_m > 0.3 * measured.semispan_m:
        raise ConfigError(
            f"frequency_hz = {measured.frequency_hz:g} Hz with mass_kg = {measured.mass_kg:g} kg would bend the tip by "
            f"{tip_m:.2g} m in level flight, more than 30 % of semispan_m = {measured.semispan_m:g} m"
        )


def _number(entry: Question, text: str | None, answers: Answers, terminal: bool, asks: bool) -> float:
    if text is not None:
        return entry.checked(text)
    suggestion = entry.suggestion(answers)
    if suggestion is not None and not asks:
        return suggestion
    if not terminal:
        raise ConfigError(f"give {_option(entry.key)} ({entry.text}, {entry.unit}); there is no terminal to ask at")
    shown = "" if suggestion is None else f" [{suggestion:g}]"
    return _ask(
        f"{entry.text}, {entry.unit}{shown}: ",
        lambda answer: suggestion if not answer and suggestion is not None else entry.checked(answer),
    )


def _ask(prompt: str, checked: Callable[[str], _T]) -> _T:
    """The first answer that passes the check; each other one is refused in a sentence."""
    while True:
        try:
            return checked(input(prompt).strip())
        except ConfigError as error:
            print(error, file=sys.stderr)


def _choose(text: str, words: tuple[str, ...]) -> str:
    while True:
        answer = input(f"{text}, {' or '.join(words)} [{words[0]}]: ").strip() or words[0]
        if answer in words:
            return answer
        print(f"one of: {', '.join(words)}", file=sys.stderr)


def _size(options: argparse.Namespace, asks: bool) -> tuple[int, int]:
    if options.image or not asks:
        return _sides_px(options.image or _IMAGE)
    return _ask(f"image size, pixels [{_IMAGE}]: ", lambda answer: _sides_px(answer or _IMAGE))


def _sides_px(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{2,5})\s*[xX*,]\s*(\d{2,5})", text)
    if match is None or not all(32 <= int(side) <= 16384 for side in match.groups()):
        raise ConfigError(f"image = '{text}': give width x height from 32 to 16384 px, as in {_IMAGE}")
    return int(match[1]), int(match[2])


def _name(options: argparse.Namespace) -> str:
    name: str = options.name or options.out.stem
    if re.search(r"[\"\\\x00-\x1f\x7f\ud800-\udfff]", name):
        raise ConfigError(f"name = {name!r}: no quotes, backslashes, control characters or bytes that are not UTF-8")
    return name


def _option(key: str) -> str:
    return "--" + key.replace("_", "-")


def _next(measured: Measured, out: Path) -> str:
    trim_mm, per_g_mm = 1e3 * trim_bend_m(measured), 1e3 * bend_per_g_m(measured)
    steps = [
        (f"spanwise simulate --airframe {out} --out out/rehearsal", "does it bend as you know it to?"),
        (f"spanwise doctor --connect LINK --airframe {out}", "on the vehicle: rates, filters, nodes, parameters"),
        (f"spanwise setup wing --connect LINK --airframe {out}", "nodes, axes, signs and modes, guided, by hand"),
        (f"spanwise run --connect LINK --airframe {out}", "lift both tips by hand: symmetric bending must follow"),
    ]
    if measured.looks != "none":
        slow = "the toe, at a mark ahead" if measured.looks == "forward" else "the trim bend"
        limit = f"until then some {trusted_to_m(measured):.1f} m is the farthest trusted without matched features"
        steps += [
            ("spanwise calibrate stereo --help", "lens and mounting, each with its sigma"),
            ("python -m mission_scripts.calibrate_target --help", f"in a checkout of Spanwise: {slow}; {limit}"),
        ]
    lines = [f"  {command}\n      {purpose}" for command, purpose in steps]
    bends = f"by beam theory the nodes rise {trim_mm:.1f} mm in level flight and {per_g_mm:.1f} mm for each further g"
    return "\n".join([f"wrote {out}: {bends}", "next:", *lines])
