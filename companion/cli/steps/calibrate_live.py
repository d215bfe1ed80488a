"""Takes calibration views from running cameras: says what to do next, keeps the images it took."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import cv2

from companion.calibration.boards import Board
from companion.calibration.live import LiveViews, Taken
from companion.errors import ConfigError
from companion.ports import CameraPair

_POLL_S = 0.2  # chosen: five looks a second are enough for a board held by hand
_PREVIEW = "live.jpg"


def take_views(
    pair: CameraPair,
    board: Board,
    wanted: int,
    folder: Path,
    seconds: float,
    focal_px: float,
    say: Callable[[str], None] = print,
) -> Path:
    """Run until the set is complete, the time is over or Ctrl-C; give the folder of images (cam0, cam1).

    Every view is written at once, lossless; ``live.jpg`` beside them shows the last one, corners drawn, for a look
    from another computer.

    Raises
    ------
    ConfigError
        The folder holds images already, or no view was taken.
    """
    images = folder / "views"
    if images.exists() and any(images.rglob("*.png")):
        raise ConfigError(f"{images} holds views already: give another --out, or calibrate from that folder")
    live, ends, last = LiveViews(board, wanted, focal_px), time.monotonic() + seconds, ""
    try:
        while time.monotonic() < ends and (not live.taken or live.advice):
            sentence = live.add(list(pair.poll(_POLL_S)))
            if sentence is not None and sentence != last:
                say(_line(live, sentence))
                last = sentence
            if sentence is not None and sentence.startswith("took"):
                _keep(live.taken[-1], images, folder / _PREVIEW)
    except KeyboardInterrupt:
        say("stopped: calibrating with what there is")
    finally:
        pair.close()
    if not live.taken:
        raise ConfigError("no view of the board was taken; is it the board that --board, --squares and --square-m say?")
    return images


def _line(live: LiveViews, sentence: str) -> str:
    rest = live.advice if live.taken else []
    return f"{len(live.taken):3d} views  {sentence}" + (f"; next: {rest[0]}" if rest else "")


def _keep(taken: Taken, images: Path, preview: Path) -> None:
    marked = []
    for camera, image, corners in (("cam0", taken.left, taken.view.left), ("cam1", taken.right, taken.view.right)):
        (images / camera).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(images / camera / f"{int(taken.view.name[4:]):04d}.png"), image)
        colour = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        for x, y in corners.pixels:
            cv2.circle(colour, (round(x), round(y)), 4, (0, 200, 0), 1, cv2.LINE_AA)
        marked.append(colour)
    cv2.imwrite(str(preview), cv2.hconcat(marked))
