"""``spanwise identify``: wing modes from a ground vibration test, or from a flight, written as an airframe file."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from pathlib import Path

import numpy as np

from companion.adapters.recordings.recording_factory import open_recording
from companion.adapters.recordings.tables.matlab_file import read_matlab
from companion.calibration.ambient import AmbientMode
from companion.calibration.flight_modes import wing_motion
from companion.calibration.modes import IdentifiedMode, identify_runs
from companion.calibration.vibration import VibrationTest, read_vibration_test
from companion.calibration.wing_modes import BendingMode, airframe_with, bending_modes, stations, symmetry
from companion.cli.steps.numbers import number
from companion.cli.steps.options import check_earlier, check_output, result_folder
from companion.errors import NOTHING_TO_ESTIMATE
from companion.evaluation.pages.identification_figures import draw_flight, draw_test
from companion.params.airframe import Airframe, Mode, Uncertain
from companion.params.files import dump_airframe, load_airframe
from companion.reporting.plotting import require_report

_DRAFT = "nadir-2m"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="gvt|flight")
    gvt = kinds.add_parser("gvt", help="from force and accelerometers of a ground vibration test")
    gvt.add_argument("folder", type=Path, help="the .mat files of the runs")
    gvt.add_argument("--layout", type=Path, required=True, metavar="FILE.toml", help="points, channels and runs")
    flight = kinds.add_parser("flight", help="from the gusts of a recorded flight")
    flight.add_argument("recording", type=Path, help=".mcap, .tlog, .BIN, .ulg, or a folder with accel.csv")
    flight.add_argument(
        "--band", type=number(0.0, 1e5, "Hz"), nargs=2, default=(2.0, 40.0), metavar="HZ", help="where modes are sought"
    )
    for kind, name in ((gvt, "gvt"), (flight, "flight")):
        default = _DRAFT if kind is gvt else "the recording's own"
        kind.add_argument("--airframe", metavar="NAME", help=f"what the modes are written into (default: {default})")
        folder = Path("out/identify", name)
        kind.add_argument(
            "--out", type=Path, default=folder, metavar="FOLDER",
            help="where to write; an airframe.toml there is replaced only if it is that of --airframe",
        )  # fmt: skip


def execute(options: argparse.Namespace) -> int:
    """Identify, print a table, write airframe, figures and numbers."""
    require_report()
    base = None if options.airframe is None else load_airframe(options.airframe)
    path = options.out / "airframe.toml"
    with result_folder(options.out):
        check_output(path, "--out")
        check_earlier(path, options.airframe)
        if options.kind == "gvt":
            return _from_test(options, base or load_airframe(_DRAFT))
        return _from_flight(options, base)


def _from_test(options: argparse.Namespace, base: Airframe) -> int:
    test = read_vibration_test(options.layout, options.folder, read_matlab)
    modes = identify_runs(test.runs, len(test.points))
    if not modes:
        print("no mode came back in half of the runs: check the column of the force, and 'band_hz'")
        return NOTHING_TO_ESTIMATE
    _print_modes(modes, test)
    bending = bending_modes(modes, test.points)
    draw_test(test, modes, bending, options.out)
    _write_numbers([_plain(mode) for mode in modes], options.out)
    airframe = airframe_with(base, bending)
    _print_factors(base, airframe, bending)
    _write(airframe, options.out)
    return 0


def _plain(mode: IdentifiedMode) -> dict[str, object]:
    """Everything but the halves, whose likeness is in ``assurance``; null where no run, or no second one, measured."""
    plain: dict[str, object] = {"resolved": mode.resolved}
    for field in dataclasses.fields(mode):
        value = getattr(mode, field.name)
        if field.name in ("shape", "shape_sigma"):
            plain[field.name] = [float(entry) if np.isfinite(entry) else None for entry in value]
        elif isinstance(value, float):
            plain[field.name] = value if math.isfinite(value) else None
        elif field.name != "halves":
            plain[field.name] = value.tolist() if isinstance(value, np.ndarray) else value
    return plain


def _write_numbers(plain: object, folder: Path) -> None:
    text = json.dumps(plain, indent=2, allow_nan=False)
    (folder / "modes.json").write_text(text, encoding="utf-8")


def _print_modes(modes: list[IdentifiedMode], test: VibrationTest) -> None:
    heads = ("f, Hz", "one run", "zeta, %", "one run", "MAC", "symmetry", "phase, deg")
    print(" ".join(f"{head:>{width}s}" for head, width in zip(heads, (8, 8, 8, 8, 6, 9, 11), strict=True)), "runs")
    for mode in modes:
        print(
            f"{mode.frequency_hz:8.3f} {_scatter(mode.frequency_sigma_hz)} {100 * mode.damping:8.3f} "
            f"{_scatter(100 * mode.damping_sigma)} {mode.assurance:6.3f} {symmetry(mode, test.points):9.3f} "
            f"{57.2958 * mode.phase_scatter_rad:11.1f} {mode.runs}/{len(test.runs)}"
            + ("" if mode.resolved else f"  only {mode.bandwidth_lines:.1f} lines wide: not resolved, left out")
        )


def _scatter(sigma: float) -> str:
    return f"{sigma:8.3f}" if math.isfinite(sigma) else f"{'-':>8s}"


def _print_factors(base: Airframe, airframe: Airframe, bending: list[BendingMode]) -> None:
    place = stations(base, bending)
    for name, mode in (("symmetric", airframe.wing.symmetric), ("antisymmetric", airframe.wing.antisymmetric)):
        print(
            f"{name:13s} {mode.frequency_hz.value:.2f} Hz, at {place.sensor_m:.2f} m per metre there: slope "
            f"{mode.slope_factor_radpm.value:.3f} +- {mode.slope_factor_radpm.sigma:.3f} rad, nose-up twist "
            f"{mode.twist_factor_radpm.value:.3f} +- {mode.twist_factor_radpm.sigma:.3f} rad"
        )
    if airframe.left_camera is not None:
        camera = airframe.left_camera
        print(
            f"cameras at {place.camera_m:.2f} m: slope x {camera.slope_gain:.3f}, deflection x {camera.lift_gain:.3f}"
        )
    for note in place.notes:
        print(f"note: {note}")
    for each in (next(mode for mode in bending if mode.sign == sign).mode for sign in (1.0, -1.0)):
        if each.runs == 1:
            print(f"note: a single run shows {each.frequency_hz:.2f} Hz: its sigmas are the base airframe's, scaled")
    wing = airframe.wing
    static = (wing.trim_bend_m, wing.bend_per_g_m, wing.gust.deflection_rms_m)
    trim, per_g, gusts = (f"{1e3 * belief.value:.1f} mm" for belief in static)
    print(f"note: trim bend {trim}, {per_g} per g, gusts of {gusts}: the base airframe's, brought to this frequency")
    print("note: air adds to the damping; `spanwise identify flight` measures it")


def _from_flight(options: argparse.Namespace, base: Airframe | None) -> int:
    recording = open_recording(options.recording, base)
    into = base or recording.airframe  # a log's sensors are as it holds them, not as they are mounted
    motion = wing_motion(recording.records(), recording.airframe, recording.hub)
    modes = motion.modes(tuple(options.band))
    plain = {
        name: [dataclasses.asdict(mode) | {"resolved": mode.resolved} for mode in family]
        for name, family in modes.items()
    }
    _write_numbers({"airframe": recording.airframe.name, **plain}, options.out)
    _print_families(modes)
    draw_flight(motion, modes, options.out)
    modes = {name: [mode for mode in family if mode.resolved] for name, family in modes.items()}
    if not all(modes.values()):
        beside = f"{options.out / 'modes.json'} and spectra.png have what there is"
        print(f"not both families show a mode: no airframe written; {beside}")
        return NOTHING_TO_ESTIMATE
    first, second = modes["symmetric"][0], modes["antisymmetric"][0]
    apart_hz = abs(first.frequency_hz - second.frequency_hz)
    if apart_hz < math.hypot(first.frequency_sigma_hz, second.frequency_sigma_hz):
        print(f"note: both families show {first.frequency_hz:.2f} Hz: is each tip's channel from a sensor on that tip?")
    symmetric, antisymmetric = _with(into.wing.symmetric, first), _with(into.wing.antisymmetric, second)
    wing = dataclasses.replace(into.wing, symmetric=symmetric, antisymmetric=antisymmetric)
    _write(dataclasses.replace(into, wing=wing), options.out)
    return 0


def _print_families(modes: dict[str, list[AmbientMode]]) -> None:
    for name, family in modes.items():
        for mode in family:
            print(
                f"{name:13s} {mode.frequency_hz:8.3f} +- {mode.frequency_sigma_hz:.3f} Hz   "
                f"zeta {100 * mode.damping:6.2f} +- {100 * mode.damping_sigma:.2f} %   blocks {mode.blocks}"
                + ("" if mode.resolved else "   a steady tone, or damped too little to tell: left out")
            )


def _with(mode: Mode, measured: AmbientMode) -> Mode:
    frequency = Uncertain(round(measured.frequency_hz, 4), round(measured.frequency_sigma_hz, 4))
    return dataclasses.replace(
        mode, frequency_hz=frequency, damping=Uncertain(round(measured.damping, 5), round(measured.damping_sigma, 5))
    )


def _write(airframe: Airframe, folder: Path) -> None:
    path = folder / "airframe.toml"
    path.write_text(dump_airframe(airframe), encoding="utf-8")
    print(f"wrote {path}; figures beside it")
