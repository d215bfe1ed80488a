"""``spanwise identify``: wing modes from a ground vibration test, or from a flight, written as an airframe file."""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

from companion.adapters.recordings.opening import open_recording
from companion.calibration.ambient import AmbientMode
from companion.calibration.flight_modes import wing_motion
from companion.calibration.modes import IdentifiedMode, identify_runs
from companion.calibration.vibration import VibrationTest, read_vibration_test
from companion.calibration.wing_modes import airframe_with, bending_modes, symmetry
from companion.cli.identify_picture import draw_flight, draw_test
from companion.params.airframe import Airframe, Mode, Uncertain
from companion.params.files import dump_airframe, load_airframe

_NOTHING = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="gvt|flight")
    gvt = kinds.add_parser("gvt", help="from force and accelerometers of a ground vibration test")
    gvt.add_argument("folder", type=Path, help="the .mat files of the runs")
    gvt.add_argument("--layout", type=Path, required=True, metavar="FILE.toml", help="points, channels and runs")
    flight = kinds.add_parser("flight", help="from the gusts of a recorded flight")
    flight.add_argument("recording", type=Path, help=".mcap, .tlog, .BIN, .ulg, or a folder with accel.csv")
    flight.add_argument("--band", type=float, nargs=2, default=(2.0, 40.0), metavar="HZ", help="where modes are sought")
    for kind in (gvt, flight):
        kind.add_argument("--airframe", default="nadir-2m", metavar="NAME", help="what the modes are written into")
        kind.add_argument("--out", type=Path, default=Path("out/identify"), metavar="FOLDER", help="where to write")


def execute(options: argparse.Namespace) -> int:
    """Identify, print a table, write airframe, figures and numbers."""
    base = load_airframe(options.airframe)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.kind == "gvt":
        return _from_test(options, base)
    return _from_flight(options, base)


def _from_test(options: argparse.Namespace, base: Airframe) -> int:
    test = read_vibration_test(options.layout, options.folder)
    modes = identify_runs(test.runs, len(test.points))
    if not modes:
        print("no mode came back in half of the runs")
        return _NOTHING
    _print_modes(modes, test)
    found = bending_modes(modes, test.points)
    draw_test(test, modes, found, options.out)
    rows = [dataclasses.asdict(m) | {"shape": list(m.shape), "shape_sigma": list(m.shape_sigma)} for m in modes]
    (options.out / "modes.json").write_text(json.dumps(rows, indent=2), encoding="utf-8")
    _write(airframe_with(base, found), options.out)
    return 0


def _print_modes(modes: list[IdentifiedMode], test: VibrationTest) -> None:
    heads = ("f, Hz", "one run", "zeta, %", "one run", "MAC", "symmetry", "phase, deg")
    print(" ".join(f"{head:>{width}s}" for head, width in zip(heads, (8, 8, 8, 8, 6, 9, 11), strict=True)), "runs")
    for mode in modes:
        print(
            f"{mode.frequency_hz:8.3f} {mode.frequency_sigma_hz:8.3f} {100 * mode.damping:8.3f} "
            f"{100 * mode.damping_sigma:8.3f} {mode.assurance:6.3f} {symmetry(mode, test.points):9.3f} "
            f"{57.2958 * mode.phase_scatter_rad:11.1f} {mode.runs}/{len(test.runs)}"
        )


def _from_flight(options: argparse.Namespace, base: Airframe) -> int:
    recording = open_recording(options.recording, base)
    motion = wing_motion(recording.records(), recording.airframe, recording.hub)
    modes = motion.modes(tuple(options.band))
    for name, family in modes.items():
        for mode in family:
            print(
                f"{name:13s} {mode.frequency_hz:8.3f} +- {mode.frequency_sigma_hz:.3f} Hz   "
                f"zeta {100 * mode.damping:6.2f} +- {100 * mode.damping_sigma:.2f} %   blocks {mode.blocks}"
            )
    draw_flight(motion, modes, options.out)
    if not all(modes.values()):
        print("not both families show a mode: no airframe written")
        return _NOTHING
    wing = recording.airframe.wing
    bent = dataclasses.replace(
        wing,
        symmetric=_with(wing.symmetric, modes["symmetric"][0]),
        antisymmetric=_with(wing.antisymmetric, modes["antisymmetric"][0]),
    )
    _write(dataclasses.replace(recording.airframe, wing=bent), options.out)
    return 0


def _with(mode: Mode, seen: AmbientMode) -> Mode:
    frequency = Uncertain(round(seen.frequency_hz, 4), round(seen.frequency_sigma_hz, 4))
    return dataclasses.replace(
        mode, frequency_hz=frequency, damping=Uncertain(round(seen.damping, 5), round(seen.damping_sigma, 5))
    )


def _write(airframe: Airframe, folder: Path) -> None:
    path = folder / "airframe.toml"
    path.write_text(dump_airframe(airframe), encoding="utf-8")
    print(f"wrote {path}; figures beside it")
