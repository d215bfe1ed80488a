"""Poses within one exposure, and the rays of a camera's pixels at full and reduced resolution."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np

from companion.core.stereo.geometry import Lens
from companion.records import Bools, Floats, Ints
from companion.sim.vision.texture import Image32

NODES = (24, 32)  # chosen: rows and columns of cells, 20 pixels of a VGA image, in which lens and pose change little
# numerical: within one exposure a pose is a parabola, over a rolling read-out of higher order
_GLOBAL_POSES, _ROLLING_POSES = 3, 7
_INSTANT_NS = 100  # numerical: no wing moves in it, and one pose stands for all


@dataclass(frozen=True, slots=True)
class Track:
    """Instants at which poses are taken exactly, and the polynomial between them.

    ``offsets_ns`` (k,) lie about mid-exposure of the middle row; the first is the middle itself.
    """

    offsets_ns: Ints
    exposure_ns: int
    row_time_ns: int
    rows: int

    @classmethod
    def of(cls, exposure_ns: int, row_time_ns: int, rows: int) -> Track:
        """Three poses for a global shutter, seven for a rolling one, Chebyshev-spaced."""
        half_ns = 0.5 * (exposure_ns + abs(row_time_ns) * (rows - 1))
        if half_ns < _INSTANT_NS:
            return cls(np.zeros(1, dtype=np.int64), exposure_ns, row_time_ns, rows)
        count = _ROLLING_POSES if row_time_ns else _GLOBAL_POSES
        nodes = np.cos(np.pi * np.arange(count) / (count - 1))
        nodes = nodes[np.argsort(np.abs(nodes))]
        return cls(np.rint(nodes * half_ns).astype(np.int64), exposure_ns, row_time_ns, rows)

    def polynomial(self, values: Floats) -> Floats:
        """Coefficients (k, ...) in seconds, lowest first, through ``values`` (k, ...) at the poses."""
        powers = np.vander(self.offsets_ns * 1e-9, increasing=True)
        flat = np.linalg.solve(powers, values.reshape(len(powers), -1))
        return np.asarray(flat.reshape(values.shape))

    def instants_s(self, count: int) -> Floats:
        """Middles (count,) of equal parts of the exposure, about its middle."""
        return ((np.arange(count) + 0.5) / count - 0.5) * self.exposure_ns * 1e-9

    def row_delay_s(self, rows: Floats) -> Floats:
        """How much later than the middle row each row (n,) is exposed."""
        return (rows - 0.5 * (self.rows - 1)) * self.row_time_ns * 1e-9


def at_time(polynomial: Floats, t_s: Floats) -> Floats:
    """Evaluate (k, 3, 3) coefficients at times (m,): (m, 3, 3)."""
    powers = np.asarray(t_s)[:, None] ** np.arange(len(polynomial))
    return np.asarray(np.einsum("mk,kij->mij", powers, polynomial))


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of pixels, its corners on multiples of :data:`Window.STEP` (it may reach beyond the image)."""

    column: int
    row: int
    width: int
    height: int

    @classmethod
    def around(cls, low: Floats, high: Floats, size_px: tuple[int, int]) -> Window | None:
        """The smallest aligned window that holds pixels ``low`` to ``high``, both (2,); None when that is empty."""
        start = np.maximum(np.floor(low / STEP), 0).astype(int) * STEP
        limit = -(-np.array(size_px) // STEP) * STEP
        stop = np.minimum(np.ceil((high + 1.0) / STEP).astype(int) * STEP, limit)
        if np.any(stop <= start):
            return None
        return cls(int(start[0]), int(start[1]), int(stop[0] - start[0]), int(stop[1] - start[1]))


STEP = 4  # px of the coarse grid on which rays are bent (choice)
MARGIN_CELLS = 2  # of the coarse grid, for interpolation at the edge (choice)
_OUTLINE_RAYS = 17  # along each side of a box: what a lens bends between two of them is less than 0.1 px (choice)
_NEAR_M = 0.05  # nearer than this nothing is drawn: half a lens' length (choice)
_EVEN = 0.005  # px: below it a shift is the same all over the image (choice)


class PixelGrid:
    """Rays of one camera's pixels; ``cells`` of ``factor`` x ``factor`` pixels stand for their middle."""

    def __init__(self, lens: Lens) -> None:
        self.lens = lens
        self.size_px = lens.size_px
        self.focal_px = lens.focal_px
        self.ray_from_pixel: Floats = np.linalg.inv(lens.matrix).astype(np.float64)
        self.distorted = bool(np.any(lens.distortion != 0.0))
        self._cell_px: Floats = np.array(lens.size_px) / NODES[::-1]
        rows, columns = np.meshgrid(
            *(_middles(n, cells) for n, cells in zip(lens.size_px[::-1], NODES, strict=True)), indexing="ij"
        )
        pixels = np.stack([columns, rows], axis=-1)
        self.node_rays: Floats = lens.unproject(pixels.reshape(-1, 2)).reshape(*NODES, 3)
        across = self.node_rays[..., :2]
        self._reach = 1.1 * np.array([across.min(axis=(0, 1)), across.max(axis=(0, 1))])
        self.half_angle_rad = float(np.arctan(np.hypot(*np.abs(self._reach).max(axis=0))))
        self._cached = functools.lru_cache(maxsize=4)(self._level_rays)

    def track(self, exposure_ns: int, row_time_ns: int) -> Track:
        """Where in time this camera's poses are needed."""
        return Track.of(exposure_ns, row_time_ns, self.size_px[1])

    def full(self) -> Window:
        """The whole image, rounded up."""
        width, height = (-(-n // STEP) * STEP for n in self.size_px)
        return Window(0, 0, width, height)

    def corner_rays(self, window: Window) -> Floats:
        """Rays (4, 3), z = 1, whose quadrangle holds all of a window's pixels."""
        if self.distorted or window == self.full():
            return self.node_rays[[0, 0, -1, -1], [0, -1, 0, -1]] * [1.1, 1.1, 1.0]
        x = window.column - 0.5 + np.array([0, window.width, 0, window.width])
        y = window.row - 0.5 + np.array([0, 0, window.height, window.height])
        return np.stack([x, y, np.ones(4)], axis=1) @ self.ray_from_pixel.T

    def clipped(self, corners_m: Floats) -> Floats:
        """Corners (m, 3) of what a convex polygon (n, 3) has within the pyramid of rays; none where it is out of sight.

        Camera axes, metres. Sutherland, Hodgman: Reentrant polygon clipping, Communications of the ACM 17(1), 1974.
        """
        low, high = self._reach
        corners_m = _cut(corners_m, corners_m[:, 2] - _NEAR_M)
        for inward in np.array([(1.0, 0.0, -low[0]), (-1.0, 0.0, high[0]), (0.0, 1.0, -low[1]), (0.0, -1.0, high[1])]):
            corners_m = _cut(corners_m, corners_m @ inward)
        return corners_m

    def window_of_rays(self, low: Floats, high: Floats) -> Window | None:
        """Window of pixels whose rays (x, y, z = 1) lie between ``low`` and ``high``, (2,); None when out of sight."""
        low, high = np.maximum(low, self._reach[0]), np.minimum(high, self._reach[1])
        if np.any(high <= low):
            return None
        x, y = np.linspace(low, high, _OUTLINE_RAYS).T
        outline = [(x, y[:1]), (x, y[-1:]), (x[:1], y), (x[-1:], y)]
        rays = np.concatenate([np.stack(np.broadcast_arrays(*side, 1.0), axis=-1) for side in outline])
        pixels = self.lens.project(rays)
        return Window.around(pixels.min(axis=0) - 2.0, pixels.max(axis=0) + 2.0, self.size_px)

    def pixel_from_cell(self, window: Window, factor: int) -> Floats:
        """Homogeneous map (3, 3) from cells of a window to pixels."""
        margin = margin_of(factor)
        middle = 0.5 * (factor - 1)
        x0, y0 = window.column - margin * factor + middle, window.row - margin * factor + middle
        return np.array([[factor, 0.0, x0], [0.0, factor, y0], [0.0, 0.0, 1.0]], dtype=np.float64)

    def cell_shape(self, window: Window, factor: int) -> tuple[int, int]:
        """Rows and columns of cells, margin included."""
        return window.height // factor + 2 * margin_of(factor), window.width // factor + 2 * margin_of(factor)

    def cell_rows(self, window: Window, factor: int) -> Floats:
        """Pixel row of each row of cells, (rows,)."""
        count = self.cell_shape(window, factor)[0]
        return np.asarray(
            window.row + (np.arange(count) - margin_of(factor)) * factor + 0.5 * (factor - 1), dtype=np.float64
        )

    def cell_rays(self, window: Window, factor: int) -> Image32:
        """Rays (rows, columns, 2) through the lens, z = 1 left out."""
        rows, columns = self.cell_shape(window, factor)
        y, x = window.row // factor, window.column // factor
        return np.ascontiguousarray(self._cached(factor)[y : y + rows, x : x + columns])

    def nodes_in(self, window: Window) -> tuple[slice, slice]:
        """Rows and columns of the nodes in and around a window."""
        spans = ((window.row, window.height, self._cell_px[1]), (window.column, window.width, self._cell_px[0]))
        spans_nodes = []
        for (start, length, cell), count in zip(spans, NODES, strict=True):
            first, last = int(start / cell - 0.5), int((start + length) / cell - 0.5) + 1
            spans_nodes.append(slice(min(max(first, 0), count - 1), min(last, count - 1) + 1))
        return spans_nodes[0], spans_nodes[1]

    def window_of_nodes(self, visible_nodes: Bools, nodes: tuple[slice, slice], window: Window) -> Window | None:
        """The part of a window around ``nodes`` that are ``visible_nodes`` (rows, columns); None where none is."""
        if visible_nodes.all():
            return window
        rows, columns = (np.flatnonzero(visible_nodes.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return None
        first = np.array([columns[0] + nodes[1].start, rows[0] + nodes[0].start])
        last = np.array([columns[-1] + nodes[1].start, rows[-1] + nodes[0].start])
        low = np.maximum((first - 0.5) * self._cell_px, [window.column, window.row])
        end = [window.column + window.width - 1, window.row + window.height - 1]
        return Window.around(low, np.minimum((last + 1.5) * self._cell_px, end), self.size_px)

    def spread_nodes(
        self, values: Floats, nodes: tuple[slice, slice], window: Window, factor: int
    ) -> Image32 | np.float32:
        """Values (rows, columns) at ``nodes`` spread over a window's cells; one number where they hardly differ."""
        low, high = float(values.min()), float(values.max())
        if high - low < _EVEN:
            return np.float32(0.5 * (low + high))
        scale = np.diag([1.0 / self._cell_px[0], 1.0 / self._cell_px[1], 1.0])
        shift = np.array([0.5 / self._cell_px[0] - 0.5 - nodes[1].start, 0.5 / self._cell_px[1] - 0.5 - nodes[0].start])
        node_from_cell = (scale @ self.pixel_from_cell(window, factor))[:2]
        node_from_cell[:, 2] += shift
        rows, columns = self.cell_shape(window, factor)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        spread = cv2.warpAffine(
            values.astype(np.float32), node_from_cell, (columns, rows), flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(spread)

    def _level_rays(self, factor: int) -> Image32:
        window = self.full()
        rows, columns = self.cell_shape(window, factor)
        matrix = self.pixel_from_cell(window, factor)
        x = matrix[0, 0] * np.arange(columns) + matrix[0, 2]
        y = matrix[1, 1] * np.arange(rows) + matrix[1, 2]
        pixels = np.stack(np.meshgrid(x, y), axis=-1)
        rays = self.lens.unproject(pixels.reshape(-1, 2))[:, :2]
        return rays.reshape(rows, columns, 2).astype(np.float32)


def _cut(polygon: Floats, depth_m: Floats) -> Floats:
    """The part of a convex polygon (n, 3) on the side where its corners' ``depth_m`` (n,) are positive."""
    inside = depth_m > 0.0
    if inside.all():
        return polygon
    corners: list[Floats] = []
    for corner in range(len(polygon)):
        if inside[corner]:
            corners.append(polygon[corner])
        following = (corner + 1) % len(polygon)
        if inside[corner] != inside[following]:
            fraction = depth_m[corner] / (depth_m[corner] - depth_m[following])
            corners.append(polygon[corner] + fraction * (polygon[following] - polygon[corner]))
    return np.array(corners).reshape(-1, 3)


def margin_of(factor: int) -> int:
    """Cells beyond the window that the enlarging filter needs."""
    return 0 if factor == 1 else MARGIN_CELLS


def _middles(pixels: int, cells: int) -> Floats:
    return (np.arange(cells) + 0.5) * pixels / cells - 0.5
