"""Picks calibration views from a camera pair that runs: pairs frames, waits until the board holds still, guides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.calibration.boards import LEAST_CORNERS, Board, Corners, common, find_corners
from companion.calibration.guidance import advice, is_new
from companion.calibration.stereo_rig import BoardView
from companion.records import Bytes, Frame, Side

_SKEW_NS = 50_000_000  # a board that holds still may be seen by cameras that are not synchronised (choice)
_STILL_PX = 0.5  # chosen: between two images: less blurs no corner
_NO_BOARD_NS = 5_000_000_000  # chosen: without a board from the begin for so long, something is wrong with it
_LATELY_NS = 1_000_000_000  # older images do not show that the board is still (choice)


@dataclass(frozen=True, slots=True)
class Taken:
    """A view with its images."""

    view: BoardView
    left: Bytes
    right: Bytes


class LiveViews:
    """Frames in, views and guidance out."""

    def __init__(self, board: Board, wanted: int, focal_px: float) -> None:
        """Look for a board until ``wanted`` views that cover images, tilts and distances are there.

        The lenses' ``focal_px``, about, says how near a board must be that is not seen.
        """
        self._board, self._wanted, self._focal_px = board, wanted, focal_px
        self._missing_since_ns: int | None = None
        self._newest: dict[Side, Frame] = {}
        self._before: tuple[int, Corners, Corners] | None = None
        self.taken: list[Taken] = []
        self.size_px = (0, 0)

    @property
    def views(self) -> list[BoardView]:
        """Views so far."""
        return [each.view for each in self.taken]

    @property
    def advice(self) -> list[str]:
        """Missing views, in words; empty when done."""
        return advice(self.views, self._board, self.size_px, self._wanted)

    def add(self, frames: list[Frame]) -> str | None:
        """Take what a poll gave, look at the newest pair, and say what came of it; None where there was no new pair."""
        for frame in frames:
            self._newest[frame.side] = frame
        if len(self._newest) < len(Side):
            return None
        left, right = (self._newest[side] for side in Side)
        if left.clock == right.clock and abs(left.mid_exposure_ns - right.mid_exposure_ns) > _SKEW_NS:
            return None
        self._newest = {}
        return self._find_board(left, right)

    def _find_board(self, left: Frame, right: Frame) -> str:
        self.size_px = (left.image.shape[1], left.image.shape[0])
        detected = find_corners(left.image, self._board), find_corners(right.image, self._board)
        before, self._before = self._before, None
        if detected[0] is None or detected[1] is None:
            missing = [side.name.lower() for side, corners in zip(Side, detected, strict=True) if corners is None]
            return f"no board in the {' and '.join(missing)} image{self._hint(left.mid_exposure_ns)}"
        if len(common(detected[0], detected[1])) < LEAST_CORNERS:
            return "the cameras share too few corners: hold the board where both see it"
        self._before = (left.mid_exposure_ns, detected[0], detected[1])
        if before is None or left.mid_exposure_ns - before[0] > _LATELY_NS or not _still(before[1:], detected):
            return "hold still"
        view = BoardView(f"view{len(self.taken) + 1:02d}", detected[0], detected[1])
        if not is_new(view, self.views, self.size_px):
            return "this view is there already: move or tilt the board"
        self.taken.append(Taken(view, left.image, right.image))
        return f"took {view.name}"

    def _hint(self, now_ns: int) -> str:
        """Which board is looked for, where none was ever taken for some seconds; else empty."""
        if self._missing_since_ns is None:
            self._missing_since_ns = now_ns
        waited_ns = now_ns - self._missing_since_ns
        return f"; {self._board.hint(self._focal_px)}" if not self.taken and waited_ns >= _NO_BOARD_NS else ""


def _still(before: tuple[Corners, Corners], now: tuple[Corners | None, Corners | None]) -> bool:
    """Whether no camera saw the board move."""
    for old, new in zip(before, now, strict=True):
        if new is None:
            return False
        both, first, second = np.intersect1d(old.ids, new.ids, return_indices=True)
        if not len(both) or float(np.median(np.abs(old.pixels[first] - new.pixels[second]))) > _STILL_PX:
            return False
    return True
