"""``spanwise calibrate``: the stereo rig from images of a board, the trigger latency from a recording."""

from __future__ import annotations

import argparse
import base64
import dataclasses
import html
from pathlib import Path

import cv2
import numpy as np

from companion.adapters.cameras.folder import list_images, read_grey
from companion.adapters.recordings.opening import open_recording
from companion.calibration.boards import Board, find_corners
from companion.calibration.latency import trigger_latency
from companion.calibration.stereo_rig import RigFit, airframe_with_rig, calibrate_rig, find_views
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Camera, Uncertain
from companion.params.files import dump_airframe, load_airframe
from companion.records import Bytes, Side

_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
_SHOWN = 6
_Pairs = list[tuple[str, Bytes, Bytes]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="stereo|latency")
    stereo = kinds.add_parser("stereo", help="lenses and relative pose from images of a board")
    stereo.add_argument("folder", type=Path, help="cam0 (left) and cam1 (right), images of equal stamp are a pair")
    stereo.add_argument(
        "--board", choices=("chessboard", "charuco"), default="charuco", help="charuco: 4x4_250 markers"
    )
    stereo.add_argument("--squares", type=int, nargs=2, default=(10, 7), metavar="N", help="across and down")
    stereo.add_argument("--square-m", type=float, required=True, metavar="M", help="side of a square, metres")
    latency = kinds.add_parser("latency", help="from the fired instant to the start of the exposure")
    latency.add_argument("recording", type=Path, help="a recording of ours, with shots and matches")
    for kind in (stereo, latency):
        kind.add_argument("--airframe", required=True, metavar="NAME", help="what the result is written into")
        kind.add_argument("--out", type=Path, default=Path("out/calibrate"), metavar="FOLDER", help="where to write")


def execute(options: argparse.Namespace) -> int:
    """Calibrate, print the result, write the airframe (and a report)."""
    base = load_airframe(options.airframe)
    options.out.mkdir(parents=True, exist_ok=True)
    airframe = _stereo(options, base) if options.kind == "stereo" else _latency(options, base)
    path = options.out / "airframe.toml"
    path.write_text(dump_airframe(airframe), encoding="utf-8")
    print(f"wrote {path}")
    return 0


def _stereo(options: argparse.Namespace, base: Airframe) -> Airframe:
    board = Board(options.board, tuple(options.squares), options.square_m)
    pairs, lonely = _read_pairs(options.folder)
    views, rejected = find_views(pairs, board)
    rows, columns = pairs[0][1].shape
    fit = calibrate_rig(views, board, (columns, rows), lonely | rejected)
    for line in _lines(fit):
        print(line)
    report = options.out / "report.html"
    report.write_text(_report(fit, pairs, board), encoding="utf-8")
    print(f"wrote {report}")
    return airframe_with_rig(base, fit)


def _read_pairs(folder: Path) -> tuple[_Pairs, dict[str, str]]:
    left, right = ({e.t_ns: e.path for e in list_images(folder / f"cam{int(side)}", side)} for side in Side)
    both = sorted(left.keys() & right.keys())
    lonely = {str(t): "only one camera has this image" for t in left.keys() ^ right.keys()}
    if not both:
        raise ConfigError(f"{folder}: no stamp has an image of both cameras")
    return [(left[t].name, read_grey(left[t]), read_grey(right[t])) for t in both], lonely


def _lines(fit: RigFit) -> list[str]:
    lines = [f"{len(fit.views)} views used, reprojection error {fit.error_px:.3f} px"]
    for side, lens in zip(Side, fit.lenses, strict=True):
        values = zip(_NAMES, lens.values, lens.sigmas, strict=True)
        lines.append(f"{side.name.lower()}: " + ", ".join(f"{name} {v:.6g} +- {s:.2g}" for name, v, s in values))
    turned = zip(1e3 * fit.rotation_rad, 1e3 * fit.rotation_sigma_rad, strict=True)
    moved = zip(1e3 * fit.translation_m, 1e3 * fit.translation_sigma_m, strict=True)
    lines.append("rotation, mrad: " + ", ".join(f"{v:.3f} +- {s:.3f}" for v, s in turned))
    lines.append("translation, mm: " + ", ".join(f"{v:.2f} +- {s:.2f}" for v, s in moved))
    lines += [f"refused {name}: {why}" for name, why in fit.rejected.items()]
    lines += [
        f"no corners yet in the {side} image at {', '.join(cells)}" for side, cells in fit.unseen.items() if cells
    ]
    return lines


def _report(fit: RigFit, pairs: _Pairs, board: Board) -> str:
    """A page with numbers and some of the views, nothing external in it."""
    pictures = []
    for name, *images in pairs[:_SHOWN]:
        drawn = [cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) for image in images]
        for picture, image in zip(drawn, images, strict=True):
            seen = find_corners(image, board)
            for x, y in np.empty((0, 2)) if seen is None else seen.pixels:
                cv2.circle(picture, (round(x), round(y)), 4, (0, 0, 255), 1)
        data = cv2.imencode(".jpg", cv2.hconcat(drawn))[1].tobytes()
        source = base64.b64encode(data).decode("ascii")
        why = html.escape(fit.rejected.get(name, "used"))
        pictures.append(f"<h3>{html.escape(name)}: {why}</h3><img width=900 src='data:image/jpeg;base64,{source}'>")
    text = html.escape("\n".join(_lines(fit)))
    body = f"<h1>Stereo calibration</h1><pre>{text}</pre>{''.join(pictures)}"
    return f"<!doctype html><meta charset=utf-8><title>Stereo calibration</title>{body}"


def _latency(options: argparse.Namespace, base: Airframe) -> Airframe:
    if base.left_camera is None or base.right_camera is None:
        raise ConfigError(f"airframe '{base.name}' has no cameras")
    found = trigger_latency(open_recording(options.recording, base).records())
    cameras: list[Camera] = []
    for side, camera in zip(Side, (base.left_camera, base.right_camera), strict=True):
        median, sigma, p99 = (float(values[side]) for values in (found.median_s, found.sigma_s, found.p99_s))
        print(
            f"{side.name.lower():5s} median {1e3 * median:.3f} ms, sigma {1e3 * sigma:.3f} ms, p99 {1e3 * p99:.3f} ms"
        )
        cameras.append(dataclasses.replace(camera, latency_s=Uncertain(median, sigma)))
    print(f"from {found.shots} shots")
    return dataclasses.replace(base, left_camera=cameras[0], right_camera=cameras[1])
