"""One textured plane in one image: its homography through the exposure, its octaves, its outline."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from companion.records import Bools, Floats
from companion.sim.vision.scene import Plane, PosedCamera
from companion.sim.vision.shutter import PixelGrid, Track, Window, at_time, margin_of
from companion.sim.vision.texture import (
    LEVELS_PER_RMS,
    ZERO_LEVEL,
    Image16,
    Image32,
    NoiseTile,
    Octave,
    octaves_of,
    visible_cycles_per_px,
    weight,
    within_tile,
)

CONTRAST = 11.0  # chosen: grey levels rms of each octave: rough ground in daylight
_LEAST_WEIGHT = 0.01  # of an octave: below it motion has blurred it away (choice)
_HORIZON_M = 1e4  # a pixel that spans this much shows nothing (choice)
_POSES_PER_CYCLE = 7.0  # of blur: the average then follows the true blur of a wave to 3 % of its amplitude (choice)
_MOST_POSES = 16  # a bound on the cost of one exposure
_OUTLINE_POSES = 8  # a bound on the cost of an outline
_COARSE = ((4, 0.03), (2, 0.06))  # chosen: reduced resolution for octaves below so many cycles per pixel
_EDGE_ON_M = 1e-6  # numerical: a plane seen so flat has no homography


@dataclass(frozen=True, slots=True)
class PlaneView:
    """A plane as one camera sees it during one exposure.

    Attributes
    ----------
    polynomial : (k, 3, 3)
        Through time: from rays (x, y, 1) to (u w, v w, w), plane coordinates in metres about ``origin_m``; w > 0 is
        in front.
    footprint_m : NODES
        Longest extent of a pixel on the plane; infinite where the plane is not seen.
    motion_px : float
        Largest travel of a point of the plane in the image during the exposure.
    """

    plane: Plane
    grid: PixelGrid
    track: Track
    origin_m: Floats
    polynomial: Floats
    footprint_m: Floats
    motion_px: float


class SurfacePainter:
    """Paints planes of one scene."""

    def __init__(self, tile: NoiseTile, seed: int) -> None:
        self._tile = tile
        self._octaves = functools.lru_cache(maxsize=64)(functools.partial(octaves_of, seed))

    def paint(
        self, image: Image32, planes: Sequence[Plane], views: list[PosedCamera], grid: PixelGrid, track: Track
    ) -> None:
        """Draw over ``image`` (rows, columns) what planes cover of it, from far to near; hidden ones are left out.

        ``views`` are at the track's poses.
        """
        visible: list[tuple[PlaneView, Window]] = []
        for plane in reversed(planes):
            window = _window(plane, views, grid)
            if window is None or any(_fills(nearer, window) for nearer, _ in visible):
                continue
            sight = _sight(plane, views, grid, track)
            if sight is not None:
                visible.append((sight, window))
        for sight, window in reversed(visible):
            self._paint(image, sight, window)

    def _paint(self, image: Image32, sight: PlaneView, window: Window) -> None:
        coverage = _coverage(sight, window)
        if coverage is not None and not coverage.any():
            return
        rows = min(window.height, sight.grid.size_px[1] - window.row)
        columns = min(window.width, sight.grid.size_px[0] - window.column)
        painted = self._texture(sight, window)[:rows, :columns]
        target = image[window.row : window.row + rows, window.column : window.column + columns]
        if coverage is None:
            target[:] = painted
        else:
            target += coverage[:rows, :columns] * (painted - target)

    def _texture(self, sight: PlaneView, window: Window) -> Image32:
        layers: dict[int, Image32] = {}
        width = sight.grid.size_px[0]
        nodes = sight.grid.nodes_in(window)
        footprint_m = np.minimum(sight.footprint_m[nodes], _HORIZON_M)
        least, most = visible_cycles_per_px(width) / np.array([footprint_m.max(), footprint_m.min()])
        for octave in self._octaves(sight.plane.surface):
            if not least < octave.cycles_per_m < most:
                continue
            cycles = octave.cycles_per_m * footprint_m
            gain = weight(cycles, width)
            resolved = gain > _LEAST_WEIGHT
            painted = sight.grid.window_of_nodes(resolved, nodes, window)
            if painted is None:
                continue
            finest = float(cycles[resolved].max())
            factor = next((factor for factor, limit in _COARSE if finest <= limit), 1)
            layer = layers.setdefault(factor, np.zeros(sight.grid.cell_shape(window, factor), np.float32))
            wave = self._blurred(sight, painted, octave, factor, finest)
            y, x = (painted.row - window.row) // factor, (painted.column - window.column) // factor
            target = layer[y : y + wave.shape[0], x : x + wave.shape[1]]
            target += wave * sight.grid.spread_nodes(gain, nodes, painted, factor)
        total: Image32 = np.full((window.height, window.width), sight.plane.brightness, np.float32)
        for factor, layer in layers.items():
            cv2.scaleAdd(_enlarged(layer, factor), CONTRAST * sight.plane.contrast, total, dst=total)
        return total

    def _blurred(self, sight: PlaneView, window: Window, octave: Octave, factor: int, cycles_per_px: float) -> Image32:
        """Noise of rms 1, averaged over the exposure."""
        poses = min(max(math.ceil(_POSES_PER_CYCLE * cycles_per_px * sight.motion_px), 1), _MOST_POSES)
        drawn_out = np.array([1.0, 1.0 / sight.plane.furrow])
        texel = np.vstack([octave.texel_from_plane(sight.origin_m * drawn_out), [0.0, 0.0, 1.0]])
        texel[:2, :2] *= drawn_out
        total: Image32 = np.zeros(sight.grid.cell_shape(window, factor), np.float32)
        for sample in self._samples(sight, window, texel, factor, sight.track.instants_s(poses)):
            cv2.accumulate(sample, total)
        total *= np.float32(1.0 / (poses * LEVELS_PER_RMS))
        total -= np.float32(ZERO_LEVEL / LEVELS_PER_RMS)
        return total

    def _samples(
        self, sight: PlaneView, window: Window, texel: Floats, factor: int, instants_s: Floats
    ) -> Iterator[Image16]:
        """The octave at each of some instants."""
        grid = sight.grid
        if sight.track.row_time_ns:
            yield from self._rolled(sight, window, texel, factor, instants_s)
            return
        rows, columns = grid.cell_shape(window, factor)
        ray_from_cell = grid.ray_from_pixel @ grid.pixel_from_cell(window, factor)
        cell_from_ray = np.linalg.inv(ray_from_cell)
        rays = grid.cell_rays(window, factor) if grid.distorted else None
        texel_from_rays = texel @ at_time(sight.polynomial, instants_s)
        for texel_from_start in within_tile(texel_from_rays @ ray_from_cell, columns, rows):
            tile, texel_from_cell = self._tile.along_rows(texel_from_start)
            if rays is not None:
                where = cv2.perspectiveTransform(rays, texel_from_cell @ cell_from_ray)
                yield np.asarray(cv2.remap(tile, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))
                continue
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            yield np.asarray(
                cv2.warpPerspective(tile, texel_from_cell, (columns, rows), flags=flags, borderMode=cv2.BORDER_WRAP)
            )

    def _rolled(
        self, sight: PlaneView, window: Window, texel: Floats, factor: int, instants_s: Floats
    ) -> Iterator[Image16]:
        """Every row at its own pose."""
        delays_s = sight.track.row_delay_s(sight.grid.cell_rows(window, factor))
        rays = sight.grid.cell_rays(window, factor)
        for t_s in instants_s:
            matrices = (texel @ at_time(sight.polynomial, t_s + delays_s)).astype(np.float32)
            full = rays @ matrices[:, :, :2].transpose(0, 2, 1) + matrices[:, None, :, 2]
            where = np.ascontiguousarray(full[..., :2] / full[..., 2:])
            yield np.asarray(cv2.remap(self._tile.upright, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))


def _enlarged(layer: Image32, factor: int) -> Image32:
    if factor == 1:
        return layer
    rows, columns = layer.shape
    large = cv2.resize(layer, (columns * factor, rows * factor), interpolation=cv2.INTER_CUBIC)
    edge = margin_of(factor) * factor
    return np.ascontiguousarray(large[edge:-edge, edge:-edge])


def _window(plane: Plane, views: list[PosedCamera], grid: PixelGrid) -> Window | None:
    """Pixels that the plane may touch; None when it is out of sight."""
    if plane.half_size_m is None:
        return grid.full()
    corners = plane.corners_m()
    outline = np.concatenate([grid.clipped((corners - view.centre_ned_m) @ view.camera_from_ned.T) for view in views])
    if not len(outline):
        return None
    rays = outline[:, :2] / outline[:, 2:]
    return grid.window_of_rays(rays.min(axis=0), rays.max(axis=0))


def _sight(plane: Plane, views: list[PosedCamera], grid: PixelGrid, track: Track) -> PlaneView | None:
    """Set the homography up; None when the plane is seen edge-on or lies behind."""
    middle = views[0]
    if abs(plane.normal @ (plane.centre_m - middle.centre_ned_m)) < _EDGE_ON_M:
        return None
    origin = _origin(plane, middle)
    matrices = np.stack([_plane_from_ray(plane, view, origin) for view in views])
    footprint = _footprint(matrices[0], grid)
    if not np.isfinite(footprint).any():
        return None
    polynomial = track.polynomial(matrices)
    return PlaneView(plane, grid, track, origin, polynomial, footprint, _motion_px(polynomial, grid, track))


def _origin(plane: Plane, view: PosedCamera) -> Floats:
    """Plane coordinates near what is seen, so that single precision suffices from there on."""
    axis = view.camera_from_ned[2]
    factor = plane.hit(view.centre_ned_m, axis[None])[0] if abs(plane.normal @ axis) > 0.05 else np.inf
    spot = view.centre_ned_m + (factor if np.isfinite(factor) else 0.0) * axis - plane.centre_m
    return np.array([spot @ plane.across, spot @ plane.along])


def _plane_from_ray(plane: Plane, view: PosedCamera, origin_m: Floats) -> Floats:
    """From a ray in camera axes to (u w, v w, w): u = across.(C + s d - P) with s = n.(P - C) / n.d, w = n.d."""
    offset = view.centre_ned_m - plane.centre_m
    reach = -float(plane.normal @ offset)
    normal = math.copysign(1.0, reach) * plane.normal
    rows = np.vstack(
        [
            (plane.across @ offset - origin_m[0]) * normal + abs(reach) * plane.across,
            (plane.along @ offset - origin_m[1]) * normal + abs(reach) * plane.along,
            normal,
        ]
    )
    return np.asarray(rows @ view.camera_from_ned.T)


def _footprint(matrix: Floats, grid: PixelGrid) -> Floats:
    """Largest singular value of d(u, v)/d(pixel) at the nodes."""
    uvw = grid.node_rays @ matrix.T
    w = uvw[..., 2]
    in_front = w > 1e-4
    safe = np.where(in_front, w, 1.0)
    uv = uvw[..., :2] / safe[..., None]
    jacobian = (matrix[:2, :2] - uv[..., None] * matrix[2, :2]) / (safe[..., None, None] * grid.focal_px)
    square = np.sum(jacobian**2, axis=(-2, -1))
    area = np.abs(jacobian[..., 0, 0] * jacobian[..., 1, 1] - jacobian[..., 0, 1] * jacobian[..., 1, 0])
    largest = np.sqrt(0.5 * (square + np.sqrt(np.maximum(square**2 - 4.0 * area**2, 0.0))))
    return np.where(in_front, largest, np.inf)


def _motion_px(polynomial: Floats, grid: PixelGrid, track: Track) -> float:
    """Longest way of a plane point between the exposure's ends, at a coarse choice of nodes."""
    half_s = 0.5e-9 * track.exposure_ns
    start, end = at_time(polynomial, np.array([-half_s, half_s]))
    rays = grid.node_rays[::6, ::6].reshape(-1, 3)
    uvw = rays @ start.T
    later = uvw @ np.linalg.inv(end).T
    in_front = (uvw[:, 2] > 1e-2) & (later[:, 2] > 1e-3)
    if not in_front.any():
        return 0.0
    moved = later[in_front, :2] / later[in_front, 2:] - rays[in_front, :2]
    return float(np.max(np.hypot(moved[:, 0], moved[:, 1]))) * grid.focal_px


def _coverage(sight: PlaneView, window: Window) -> Image32 | None:
    """Share of each pixel that the plane covers, averaged over the exposure; None where that is all of it."""
    if _fills(sight, sight.grid.full()):
        return None
    poses = min(max(math.ceil(sight.motion_px), 1), _OUTLINE_POSES)
    rays = sight.grid.cell_rays(window, 1)
    delay_s = sight.track.row_delay_s(sight.grid.cell_rows(window, 1))
    total: Image32 = np.zeros(rays.shape[:2], np.float32)
    for t_s in sight.track.instants_s(poses):
        times = t_s + delay_s if sight.track.row_time_ns else np.array([t_s])
        total += _outline(sight, rays, at_time(sight.polynomial, times).astype(np.float32))
    return total / np.float32(poses)


def _fills(sight: PlaneView, window: Window) -> bool:
    """Whether the plane covers all of a window, throughout the exposure and with room to spare."""
    polynomial = at_time(sight.polynomial, np.zeros(1))[0]
    return bool(np.all(_inside(sight, sight.grid.corner_rays(window) @ polynomial.T)))


def _inside(sight: PlaneView, uvw: Floats) -> Bools:
    """Whether points lie well within the plane, in front of the camera."""
    in_front = uvw[:, 2] > 0.05
    half = sight.plane.half_size_m
    if half is None:
        return in_front
    uv = np.abs(uvw[:, :2] / np.where(in_front, uvw[:, 2], 1.0)[:, None] + sight.origin_m)
    return np.asarray(in_front & np.all(uv < 0.98 * np.array(half), axis=1))


def _outline(sight: PlaneView, rays: Image32, matrices: Image32) -> Image32:
    """Coverage at one pose (or one per row): distance to each edge in pixels, clipped to a pixel's width."""
    m = matrices[:, None]
    u_w, v_w, w = (rays[..., 0] * m[..., i, 0] + rays[..., 1] * m[..., i, 1] + m[..., i, 2] for i in range(3))
    front = w > 1e-6
    safe = np.where(front, w, np.float32(1.0))
    focal = np.float32(sight.grid.focal_px)
    half = sight.plane.half_size_m
    if half is None:
        steep = np.hypot(m[..., 2, 0], m[..., 2, 1]) / focal
        return np.asarray(np.clip(w / steep + np.float32(0.5), 0.0, 1.0), dtype=np.float32)
    coverage = front.astype(np.float32)
    for row, (value, limit) in enumerate(zip((u_w / safe, v_w / safe), half, strict=True)):
        gradient = np.hypot(m[..., row, 0] - value * m[..., 2, 0], m[..., row, 1] - value * m[..., 2, 1]) / (
            safe * focal
        )
        edge = (np.float32(limit) - np.abs(value + np.float32(sight.origin_m[row]))) / gradient
        coverage *= np.clip(edge + np.float32(0.5), 0.0, 1.0)
    return np.asarray(coverage, dtype=np.float32)
