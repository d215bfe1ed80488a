"""``spanwise calibrate``: the stereo rig from a board, the cameras' mounting by gravity, the latency of the trigger."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from companion.adapters.cameras import camera_factory as cameras
from companion.adapters.cameras.folder import list_images, read_grey
from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.recording_factory import open_recording
from companion.calibration.attitudes import find_attitudes
from companion.calibration.boards import LEAST_SQUARES, MOST_SQUARES, Board
from companion.calibration.guidance import advice
from companion.calibration.latency import trigger_latency
from companion.calibration.mounting import airframe_with_mounting, disagreement_rad, mount
from companion.calibration.rig_airframe import airframe_with_rig, baselines, rough_focal_px
from companion.calibration.stereo_rig import CELLS, RigFit, calibrate_rig, find_views
from companion.cli.steps.calibrate_live import take_views
from companion.cli.steps.calibrate_rehearsal import Rehearsal, errors_in_sigmas
from companion.cli.steps.numbers import integer, number, seconds, seed
from companion.cli.steps.options import check_earlier, check_output, result_folder
from companion.errors import ConfigError
from companion.evaluation.metrics import rms
from companion.evaluation.pages.calibration_page import Pairs, report, rows, verdict
from companion.params.airframe import Airframe, Camera, Uncertain
from companion.params.files import dump_airframe, load_airframe, parse_airframe
from companion.ports import CameraPair
from companion.records import Side
from companion.reporting.plotting import require_report


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="stereo|mounting|latency")
    stereo = kinds.add_parser("stereo", help="lenses and relative pose from images of a board")
    stereo.add_argument(
        "folder", type=Path, nargs="?", help="cam0 (left) and cam1 (right), images of equal stamp are a pair"
    )
    stereo.add_argument(
        "--cameras", metavar="PAIR",
        help="take the views now: sim (rehearse with simulated cameras and board); " + "; ".join(cameras.SPELLINGS),
    )  # fmt: skip
    stereo.add_argument("--seed", type=seed, default=1, metavar="N", help="with --cameras sim: another board holder")
    stereo.add_argument(
        "--views", type=integer(1, 1000), default=20, metavar="N", help="with --cameras: how many views to take"
    )
    stereo.add_argument("--for", type=seconds, default=600.0, dest="seconds", metavar="SECONDS", help="and how long")
    mounting = kinds.add_parser("mounting", help="how the cameras sit on their wing sections, by gravity")
    mounting.add_argument(
        "recording",
        type=Path,
        help="made with --record-images: the aircraft held still in several attitudes at a board",
    )
    for kind in (stereo, mounting):
        kind.add_argument(
            "--board", choices=("chessboard", "charuco"), default="charuco", help="charuco: 4x4_250 markers"
        )
        kind.add_argument(
            "--squares", type=integer(LEAST_SQUARES, MOST_SQUARES), nargs=2, default=(10, 7), metavar="N",
            help="across and down",
        )  # fmt: skip
        kind.add_argument(
            "--square-m", type=number(0.0, 10.0, "m"), required=True, metavar="M", help="side of a square, metres"
        )
    latency = kinds.add_parser("latency", help="from the fired instant to the start of the exposure")
    latency.add_argument("recording", type=Path, help="a recording of ours, with shots and matches")
    for kind in (stereo, mounting, latency):
        kind.add_argument("--airframe", required=True, metavar="NAME", help="what the result is written into")
        kind.add_argument(
            "--out", type=Path, default=Path("out/calibrate"), metavar="FOLDER",
            help="where to write airframe.toml, which replaces none but that of --airframe",
        )  # fmt: skip


def execute(options: argparse.Namespace) -> int:
    """Calibrate, print the result, write the airframe (and a report)."""
    if options.kind == "stereo":
        require_report()
    base = load_airframe(options.airframe)
    path = options.out / "airframe.toml"
    with result_folder(options.out):
        check_output(path, "--out")
        check_earlier(path, options.airframe)
        airframe = {"stereo": _stereo, "mounting": _mounting, "latency": _latency}[options.kind](options, base)
        path.write_text(_text(airframe, path), encoding="utf-8")
    print(f"wrote {path}")
    return 0


def _text(airframe: Airframe, path: Path) -> str:
    """The airframe as its file has it; :class:`ConfigError` for one that no file may hold."""
    text = dump_airframe(airframe)
    parse_airframe(text, f"{path}, not written")
    return text


def _stereo(options: argparse.Namespace, base: Airframe) -> Airframe:
    board = _board(options)
    if (options.folder is None) == (options.cameras is None):
        raise ConfigError("give a folder of images, or --cameras to take them now")
    rehearsal = Rehearsal(base, board, options.seed) if options.cameras == "sim" else None
    folder = options.folder or _taken(options, base, board, rehearsal)
    pairs, lonely = _read_pairs(folder)
    views, rejected = find_views(pairs, board)
    size_px = (pairs[0][1].shape[1], pairs[0][1].shape[0])
    fit = calibrate_rig(views, board, size_px, lonely | rejected, rough_focal_px(base, size_px[0]))
    airframe = airframe_with_rig(base, fit)
    _text(airframe, options.out / "airframe.toml")
    missing = advice([view for view in views if view.name in fit.views], board, size_px)
    _print_fit(base, fit, missing)
    page, picture = report(fit, views, pairs, board, missing)
    (options.out / "report.html").write_text(page, encoding="utf-8")
    (options.out / "report.png").write_bytes(picture)
    print(f"wrote {options.out / 'report.html'} and report.png")
    if rehearsal is not None:
        off = np.abs(errors_in_sigmas(fit, rehearsal.airframe))
        text = f"error over sigma {rms(off):.2f} rms over 24 parameters, {off.max():.2f} at most"
        print(f"against the simulated truth: {text}")
    return airframe


def _board(options: argparse.Namespace) -> Board:
    return Board(options.board, tuple(options.squares), options.square_m)


def _taken(options: argparse.Namespace, base: Airframe, board: Board, rehearsal: Rehearsal | None) -> Path:
    """Folder of views that are taken now, by the cameras or in a rehearsal."""
    pair: CameraPair = rehearsal or cameras.camera_factory(options.cameras, base, triggered=False)()
    focal_px = base.camera_pair[0].focal_px.value
    return take_views(pair, board, options.views, options.out, options.seconds, focal_px)


def _print_fit(base: Airframe, fit: RigFit, missing: list[str]) -> None:
    print(verdict(fit)[1])
    print(f"{len(fit.views)} views used, reprojection error {fit.error_px:.3f} px")
    for name, value, sigma, where in rows(fit):
        print(f"{where:14s} {name:18s} {value:>12s} +- {sigma}")
    print(baselines(base, fit))
    for name, why in fit.rejected.items():
        print(f"refused {name}: {why}")
    for text in missing:
        print(f"for a better result: {text}")
    for side, parts in fit.unseen.items():
        if parts:
            print(f"no corner in {len(parts)} of {CELLS**2} parts of the {side} image: the lens is extrapolated there")


def _read_pairs(folder: Path) -> tuple[Pairs, dict[str, str]]:
    left, right = (_by_stamp(folder, side) for side in Side)
    both = sorted(left.keys() & right.keys())
    lonely = {str(t): "only one camera has this image" for t in left.keys() ^ right.keys()}
    for side, stamped in zip(Side, (left, right), strict=True):
        for t_ns, paths in stamped.items():
            if len(paths) > 1:
                names = ", ".join(path.name for path in paths)
                lonely[str(t_ns)] = f"{names} of cam{int(side)} all have this stamp: give each image its own"
    both = [t_ns for t_ns in both if str(t_ns) not in lonely]
    if not both:
        raise ConfigError(f"{folder}: no stamp has one image of each camera")
    pairs = [(left[t][0].name, read_grey(left[t][0]), read_grey(right[t][0])) for t in both]
    rows, columns = pairs[0][1].shape
    for name, *images in pairs:
        for side, image in zip(Side, images, strict=True):
            if image.shape != (rows, columns):
                raise ConfigError(
                    f"{folder}: {name} in cam{int(side)} is {image.shape[1]} x {image.shape[0]} px, the first image of "
                    f"cam0 {columns} x {rows} px: set both cameras to the size that is flown, take all images anew"
                )
    return pairs, lonely


def _by_stamp(folder: Path, side: Side) -> dict[int, list[Path]]:
    images: dict[int, list[Path]] = {}
    for entry in list_images(folder / f"cam{int(side)}", side):
        images.setdefault(entry.t_ns, []).append(entry.path)
    return images


def _mounting(options: argparse.Namespace, base: Airframe) -> Airframe:
    board = _board(options)
    recording = open_recording(options.recording, base)
    result = []
    for side in Side:
        attitudes, refused = find_attitudes(recording, base, board, side)
        for name, why in refused.items():
            print(f"{side.name.lower():5s} refused {name}: {why}")
        mounting = mount(attitudes)
        sigma = ", ".join(f"{1e3 * value:.2f}" for value in mounting.sigma_rad)
        worst = int(np.argmax(mounting.errors_rad))
        print(
            f"{side.name.lower():5s} {len(attitudes)} attitudes, sigma {sigma} mrad (x, y, z of the camera); "
            f"worst {1e3 * mounting.errors_rad[worst]:.2f} mrad at {attitudes[worst].name}"
        )
        result.append(mounting)
    apart = disagreement_rad(base, *result)
    print(f"both mountings against the stereo calibration, which is kept between the cameras: {1e3 * apart:.2f} mrad")
    return airframe_with_mounting(base, *result)


def _latency(options: argparse.Namespace, base: Airframe) -> Airframe:
    pair, recording = base.camera_pair, McapRecording(options.recording)  # with the airframe that flew it
    if recording.airframe.name != base.name:
        raise ConfigError(
            f"{options.recording}: recorded by airframe '{recording.airframe.name}', not by '{base.name}'; "
            "give the airframe whose cameras it has"
        )
    result = trigger_latency(recording.records(), recording.airframe.camera_pair)
    cameras: list[Camera] = []
    for side, camera in zip(Side, pair, strict=True):
        median, sigma, p99 = (float(values[side]) for values in (result.median_s, result.sigma_s, result.p99_s))
        print(
            f"{side.name.lower():5s} median {1e3 * median:.3f} ms, sigma {1e3 * sigma:.3f} ms, p99 {1e3 * p99:.3f} ms"
        )
        cameras.append(dataclasses.replace(camera, latency_s=Uncertain(median, sigma)))
    print(f"from {result.shots} shots")
    if result.ambiguous_s is not None:
        print(
            f"the exposures do not name their shots, which came {1e3 * result.ambiguous_s:.0f} ms apart at the "
            "shortest: a latency longer than that is told too short; record with shots farther apart where it may be"
        )
    return dataclasses.replace(base, left_camera=cameras[0], right_camera=cameras[1])
