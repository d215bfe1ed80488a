"""Covariance of a calibrated pair, in the terms that the flight's error budget has: looks, and residuals of the lenses.

Principal point, tangential distortion and rotation hang together in a bundle: each may be off by a great deal while
rays hardly are. So the covariance is carried to the slopes of rays over the image, and those are fitted by a rotation
and the fields of :mod:`companion.core.stereo.lens_residual`; what is left (higher radial terms) lies below them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from companion.calibration.bundle import LENS, Bundle, camera_matrix
from companion.core.stereo.lens_residual import LENS_TERMS, PRISM_X, PRISM_Y, RADIAL, TILT_X, TILT_Y, residual_field
from companion.records import Floats

_GRID = 9  # pixels a side, evenly over the image, at which rays are compared (choice)
_MARGIN = 0.04  # of the image left out at each side: features lie inside it (choice)
_STEP_SIGMAS = 1e-2  # of the difference quotient (numerical)
_ROTATION = 3  # entries of a rotation vector (derived)


@dataclass(frozen=True, slots=True)
class LensSigmas:
    """Sigma of one lens: keystone (rad), thin prism, first radial term; the larger of two axes."""

    tilt_rad: float
    prism: float
    radial: float


def lens_sigmas(bundle: Bundle, size_px: tuple[int, int]) -> tuple[LensSigmas, LensSigmas]:
    """Sigmas of the left and of the right lens."""
    left, right = (_terms(bundle, side, size_px)[_ROTATION:] for side in (0, 1))
    return _sigmas(left, bundle.covariance), _sigmas(right, bundle.covariance)


def look_sigma_rad(bundle: Bundle, size_px: tuple[int, int]) -> Floats:
    """Sigma (3,) of the direction in which the right camera's image looks against the left one's, camera axes, rad."""
    apart = _terms(bundle, 1, size_px)[:_ROTATION] - _terms(bundle, 0, size_px)[:_ROTATION]
    apart[:, 2 * LENS : 2 * LENS + _ROTATION] -= np.eye(_ROTATION)
    return np.sqrt(np.diag(apart @ bundle.covariance @ apart.T))


def _sigmas(terms: Floats, covariance: Floats) -> LensSigmas:
    sigma = np.sqrt(np.diag(terms @ covariance @ terms.T))
    tilt, prism = sigma[TILT_X : TILT_Y + 1], sigma[PRISM_X : PRISM_Y + 1]
    return LensSigmas(float(tilt.max()), float(prism.max()), float(sigma[RADIAL]))


def _terms(bundle: Bundle, side: int, size_px: tuple[int, int]) -> Floats:
    """Rotation and residual terms (9, 24) of one camera per unit of each shared parameter."""
    size = np.array(size_px, dtype=np.float64) - 1.0
    places = np.linspace(_MARGIN, 1.0 - _MARGIN, _GRID)
    pixels = np.array([(u, v) for u in places for v in places]) * size
    lens = bundle.shared[side * LENS : (side + 1) * LENS]
    sigma = np.sqrt(np.diag(bundle.covariance))[side * LENS : (side + 1) * LENS]
    by = np.empty((2 * len(pixels), LENS))
    for k in range(LENS):
        step = np.zeros(LENS)
        step[k] = _STEP_SIGMAS * max(float(sigma[k]), 1e-12)
        by[:, k] = (_slopes(pixels, lens + step) - _slopes(pixels, lens - step)).ravel() / (2.0 * step[k])
    fields = _fields(_slopes(pixels, lens))
    terms = np.zeros((_ROTATION + LENS_TERMS, len(bundle.shared)))
    terms[:, side * LENS : (side + 1) * LENS] = np.linalg.lstsq(fields, by, rcond=None)[0][: len(terms)]
    return terms


def _fields(slopes: Floats) -> Floats:
    """Slopes' errors (2 n, 10) per unit of rotation, residual terms, and of a ratio between the focal lengths."""
    x, y = slopes.T
    none = np.zeros_like(x)
    along, across = [-x * y, 1.0 + x * x, -y], [-1.0 - y * y, x * y, x]
    turned = np.stack([np.stack(along, axis=-1), np.stack(across, axis=-1)], axis=1)
    ratio = np.stack([none, y], axis=1)[..., np.newaxis]
    fields: Floats = np.concatenate([turned, residual_field(x, y), ratio], axis=-1)
    return fields.reshape(2 * len(x), -1)


def _slopes(pixels: Floats, lens: Floats) -> Floats:
    slopes = cv2.undistortPoints(pixels[:, np.newaxis], camera_matrix(lens), lens[4:])[:, 0]
    return np.asarray(slopes, dtype=np.float64)
