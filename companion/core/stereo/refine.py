"""Subpixel refinement of matches without pixel locking, and the sigma of each.

Inverse-compositional Gauss-Newton on raw images: the left patch at whole pixels is the template, the right image is
interpolated with six taps per axis (Keys' fourth-order cubic convolution), which leaves no bias toward whole or half
pixels as a bilinear Lucas-Kanade tracker does. Brightness offset and gain of each patch are free.

A patch is not rigid: bend rolls one image of a forward-looking pair against the other, lenses shear, and on slanted
ground disparity grows from row to row. With a rigid patch this gives an error across the epipolar line that depends on
the texture and is the same in every pair. So the template takes the shape that is expected in the right image (to first
order where that is enough, resampled where it is not), and in the last step disparity may grow across it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from companion.records import Bools, Bytes, Floats, Ints

Patches = npt.NDArray[np.float32]

HALF_WINDOW = 10  # px; 21 x 21 patches: texture enough, surfaces still nearly flat (choice)
_WINDOW = 2 * HALF_WINDOW + 1  # derived: pixels of a patch's side
_TAPS = 6  # per axis, of Keys' fourth-order interpolation (by definition)
_BEFORE = 2  # taps before the pixel that the coordinate falls into (by definition)
_CONVERGED_PX = 0.02  # a last step beyond it would be seen in the range (choice)
# Interpolation and lens leave about this much that no patch can tell from displacement (choice).
_FLOOR_PX = 0.006
_FITTED = 4.0  # displacement in two axes, brightness offset and gain (by definition)
_GROWTH = 0.02  # usual growth of disparity across a patch, px per px (choice)
# chosen, px per px: taken to first order, a roll of 0.05 rad cost no match, one of 0.1 rad an eighth of the matches
# and a quarter of the accuracy (a textured plane at 40 m, focal length 500 px)
_STEEP = 0.05
_FLAT = 1e-6  # grey^2 / px^2: no texture at all (numerical)


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Refined matches; entries where ``good`` is false mean nothing.

    Attributes
    ----------
    left_px, right_px : (n, 2) float64
        The left point is where the patch's texture has its weight, so that a disparity that grows across the patch (a
        slanted surface) does not bias the match.
    sigma_px : (n,) float64
        One-sigma along the given direction.
    correlation : (n,) float64
        Weighted normalised correlation of the two patches.
    good : (n,) bool
    """

    left_px: Floats
    right_px: Floats
    sigma_px: Floats
    correlation: Floats
    good: Bools


def refine(
    left: Bytes,
    right: Bytes,
    left_px: Ints,
    start_px: Floats,
    along: Floats,
    slopes: Floats | None = None,
    iterations: int = 3,
) -> Refined:
    """Refine matches from a start that is right to about a pixel.

    Parameters
    ----------
    left, right : (rows, columns) uint8
        Raw images.
    left_px : (n, 2) int64
        Column, row of the patch centres; at least ``HALF_WINDOW + 2`` from the border.
    start_px : (n, 2) float64
        Expected right pixels.
    along : (n, 2) float64
        Unit direction of the epipolar line in the right image.
    slopes : (n, 2, 2) float64, optional
        Expected growth of the displacement (column, row) per pixel to the right and per pixel down.
    iterations : int
        Number of steps; a match that still moves after them is not good.
    """
    slopes = np.zeros((len(left_px), 2, 2)) if slopes is None else slopes
    patches, on_image = _gather(left, left_px, HALF_WINDOW + 2), np.ones(len(left_px), dtype=bool)
    left_from_right, steep = np.tile(np.eye(2), (len(left_px), 1, 1)), is_steep(slopes)
    if steep.any():
        left_from_right[steep] = np.linalg.inv(np.eye(2) + slopes[steep])
        patches[steep], on_image[steep] = _resampled(left, left_px[steep], left_from_right[steep])
        slopes = np.where(steep[:, np.newaxis, np.newaxis], 0.0, slopes)
    template = _Template(patches, along, slopes)
    position = np.array(start_px, dtype=np.float64)
    step = np.full_like(position, np.inf)
    inside = _inside(right, position)
    residual, correlation = np.zeros((len(position), _WINDOW**2), dtype=np.float32), np.zeros(len(position))
    for _ in range(iterations):
        inside &= _inside(right, position)
        held = np.where(inside[:, np.newaxis], position, HALF_WINDOW + _TAPS)
        residual, correlation = template.compare(_interpolated(right, held))
        step = template.step(residual)
        position = held - step
    sigma, centroid = template.quality(residual)
    position = position + step - template.grown(residual, centroid)
    strayed = np.linalg.norm(position - start_px, axis=1)
    settled = (np.abs(step).max(axis=1) < _CONVERGED_PX) & (strayed < 0.5 * HALF_WINDOW) if len(position) else inside
    right_px = position + centroid + np.einsum("nij,nj->ni", slopes, centroid)
    good = (
        on_image & inside & settled & np.isfinite(sigma) & _inside(right, right_px)
    )  # whoever looks back from there needs a patch
    moved_px: Floats = np.where(steep[:, np.newaxis], np.einsum("nij,nj->ni", left_from_right, centroid), centroid)
    return Refined(left_px + moved_px, right_px, sigma, correlation, good)


def is_steep(slopes: Floats) -> Bools:
    """Which displacements (n, 2, 2) grow so much over a patch that its shape is resampled, not taken to first order."""
    steep: Bools = np.abs(slopes).max(axis=(1, 2), initial=0.0) > _STEEP
    return steep


def _resampled(image: Bytes, centres_px: Ints, left_from_right: Floats) -> tuple[Patches, Bools]:
    """Patches (n, side, side) in the shape of the other image, and whether each lies on the image."""
    reach = np.arange(-HALF_WINDOW - 2, HALF_WINDOW + 3.0)
    offsets = np.stack(np.meshgrid(reach, reach), axis=-1)
    at = centres_px[:, np.newaxis, np.newaxis] + np.einsum("nij,rcj->nrci", left_from_right, offsets)
    on_image: Bools = ((at >= 0.0) & (at <= np.array(image.shape[::-1]) - 1.0)).all(axis=(1, 2, 3))
    column, row = (
        np.ascontiguousarray(values_px.reshape(-1, reach.size), dtype=np.float32)
        for values_px in np.moveaxis(at, -1, 0)
    )
    values = cv2.remap(image.astype(np.float32), column, row, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, dtype=np.float32).reshape(-1, reach.size, reach.size), on_image


class _Template:
    """The left patches, in the shape that is expected, with what does not change during the iteration."""

    def __init__(self, patches: Patches, along: Floats, slopes: Floats) -> None:
        self._along = along.astype(np.float32)
        gradient = np.stack([_slope(patches[:, 2:-2], 2), _slope(patches[:, :, 2:-2], 1)], axis=1)
        gradient = gradient.reshape(-1, 2, _WINDOW**2)
        self._grade = (self._along[:, np.newaxis] @ gradient)[:, 0]
        moved = slopes.astype(np.float32) @ _OFFSETS.T.astype(np.float32)
        shaped = patches[:, 2:-2, 2:-2].reshape(-1, _WINDOW**2) - (moved * gradient).sum(axis=1)
        self._texture = shaped - (shaped @ _WEIGHT)[:, np.newaxis]
        self._power = (self._texture**2) @ _WEIGHT
        self._gradient = gradient - (gradient @ _WEIGHT)[..., np.newaxis]
        weighted = self._gradient * _WEIGHT
        self._inverse = _inverse2((weighted @ self._gradient.transpose(0, 2, 1)).astype(np.float64))
        self._weighted = weighted

    def compare(self, patches: Patches) -> tuple[Patches, Floats]:
        """Residual of brightness-adjusted right patches (n, window^2), and the correlation (n,)."""
        other = patches - (patches @ _WEIGHT)[:, np.newaxis]
        product = (other * self._texture) @ _WEIGHT
        power = np.maximum((other**2) @ _WEIGHT, 1e-9)
        correlation: Floats = np.asarray(product / np.sqrt(power * np.maximum(self._power, 1e-9)), dtype=np.float64)
        residual = (product / power)[:, np.newaxis] * other - self._texture
        return np.asarray(residual, dtype=np.float32), correlation

    def step(self, residual: Patches) -> Floats:
        """Displacement (n, 2), px, by one Gauss-Newton step, at most 1 px per axis."""
        pull = (self._weighted @ residual[..., np.newaxis])[..., 0]
        move: Floats = np.einsum("nij,nj->ni", self._inverse, pull.astype(np.float64))
        return np.clip(move, -1.0, 1.0)

    def grown(self, residual: Patches, at: Floats) -> Floats:
        """Displacement (n, 2), px, at a point of each patch (n, 2), if disparity may grow across the patch."""
        growth = self._grade[:, np.newaxis] * _OFFSETS.T.astype(np.float32)
        growth -= (growth @ _WEIGHT)[..., np.newaxis]
        free = np.concatenate([self._gradient, growth], axis=1)
        weighted = free * _WEIGHT
        noise = ((residual**2) @ _WEIGHT).astype(np.float64) / _EFFECTIVE
        prior = _FLAT + noise[:, np.newaxis] * np.array([0.0, 0.0, 1.0, 1.0]) / _GROWTH**2
        normal = (weighted @ free.transpose(0, 2, 1)).astype(np.float64) + prior[:, np.newaxis] * np.eye(4)
        pull = (weighted @ residual[..., np.newaxis]).astype(np.float64)
        solution: Floats = np.linalg.solve(normal, pull)[..., 0]
        displaced: Floats = solution[:, :2] + np.einsum("ni,ni->n", solution[:, 2:], at)[:, np.newaxis] * self._along
        return displaced

    def quality(self, residual: Patches) -> tuple[Floats, Floats]:
        """Sigma (n,) along the epipolar line, and the patch's centre of weight (n, 2) for displacement along it, px."""
        noise = ((residual**2) @ _WEIGHT).astype(np.float64) * _DEGREES
        pulled = np.einsum("nij,nj->ni", self._inverse, self._along).astype(np.float32)
        lever = (pulled[:, np.newaxis] @ self._weighted)[:, 0]
        spread = (lever.astype(np.float64) ** 2).sum(axis=1)
        direct = (self._along[:, np.newaxis] @ self._gradient)[:, 0]
        centroid = (lever * direct).astype(np.float64) @ _OFFSETS
        return np.sqrt(noise * spread + _FLOOR_PX**2), centroid


def _window_weight() -> Patches:
    """Gaussian window of sigma half of HALF_WINDOW, sum 1."""
    across = np.arange(-HALF_WINDOW, HALF_WINDOW + 1)
    profile = np.exp(-0.5 * (across / (0.5 * HALF_WINDOW)) ** 2)
    weight = np.outer(profile, profile)
    flat: Patches = (weight / weight.sum()).astype(np.float32).ravel()
    return flat


_WEIGHT = _window_weight()
_EFFECTIVE = 1.0 / float((_WEIGHT.astype(np.float64) ** 2).sum())
_DEGREES = _EFFECTIVE / (_EFFECTIVE - _FITTED)
_OFFSETS = np.stack(
    np.meshgrid(np.arange(-HALF_WINDOW, HALF_WINDOW + 1.0), np.arange(-HALF_WINDOW, HALF_WINDOW + 1.0)), axis=-1
).reshape(-1, 2)


def _slope(patches: Patches, axis: int) -> Patches:
    """Derivative along an axis by the five-point formula; that axis loses two samples at each end."""
    p = np.moveaxis(patches, axis, -1)
    slope = (8.0 * (p[..., 3:-1] - p[..., 1:-3]) - (p[..., 4:] - p[..., :-4])) / 12.0
    return np.moveaxis(slope, -1, axis).astype(np.float32)


def _inverse2(matrix: Floats) -> Floats:
    """Inverse of (n, 2, 2) positive matrices; NaN where singular."""
    a, b, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 1]
    determinant = a * d - b * b
    determinant = np.where(determinant > 1e-6 * (a + d) ** 2 + 1e-12, determinant, np.nan)
    return np.stack([np.stack([d, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2) / determinant[:, None, None]


def _inside(image: Bytes, position: Floats) -> Bools:
    margin = HALF_WINDOW + _TAPS // 2 + 1
    limit = np.array([image.shape[1] - 1 - margin, image.shape[0] - 1 - margin])
    inside: Bools = np.all((position >= margin) & (position <= limit), axis=1)
    return inside


def _gather(image: Bytes, centre: Ints, before: int, after: int | None = None) -> Patches:
    """Square patches (n, m, m) around whole pixels."""
    size = before + (before if after is None else after) + 1
    windows = np.lib.stride_tricks.sliding_window_view(image, (size, size))
    return windows[centre[:, 1] - before, centre[:, 0] - before].astype(np.float32)


def _interpolated(image: Bytes, position: Floats) -> Patches:
    """Patches (n, window^2) of the image around fractional positions, by separable six-tap interpolation."""
    base_px = np.floor(position).astype(np.int64)
    patches = _gather(image, base_px, HALF_WINDOW + _BEFORE, HALF_WINDOW + _TAPS - 1 - _BEFORE)
    taps = keys_taps(position - base_px).astype(np.float32)
    n, across = len(position), np.arange(_WINDOW)
    blend = np.zeros((2, n, _WINDOW + _TAPS - 1, _WINDOW), dtype=np.float32)
    for tap in range(_TAPS):
        blend[0][:, across + tap, across] = taps[:, 0, tap, np.newaxis]
        blend[1][:, across + tap, across] = taps[:, 1, tap, np.newaxis]
    resampled: Patches = (blend[1].transpose(0, 2, 1) @ (patches @ blend[0])).reshape(n, _WINDOW**2)
    return resampled


def keys_taps(fraction: Floats) -> Floats:
    """Weights (..., 6) of Keys' six-point interpolation at a fraction in [0, 1) after the third tap.

    Source: R. G. Keys, "Cubic convolution interpolation for digital image processing", IEEE Trans. ASSP 29(6), 1981.
    """
    x = np.abs(np.asarray(fraction)[..., np.newaxis] + _BEFORE - np.arange(_TAPS))
    near = (4.0 / 3.0 * x - 7.0 / 3.0) * x * x + 1.0
    middle = ((-7.0 / 12.0 * x + 3.0) * x - 59.0 / 12.0) * x + 2.5
    far = ((x / 12.0 - 2.0 / 3.0) * x + 21.0 / 12.0) * x - 1.5
    taps: Floats = np.where(x < 1.0, near, np.where(x < 2.0, middle, np.where(x < 3.0, far, 0.0)))
    return taps
