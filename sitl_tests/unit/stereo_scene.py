"""Image pairs of a textured plane with exactly known geometry, for the stereo tests.

The texture is a sum of plane waves whose wavelength in the image stays above three pixels, so that sampling it at pixel
centres is exact: no interpolation, no aliasing, no sub-pixel bias of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.stereo.geometry import MountedCamera, Pose


@dataclass(frozen=True)
class TexturedPlane:
    """Plane ``normal . X = distance`` in body axes, with waves of ``wave_radpm`` (k, 2) in its own two axes."""

    normal: np.ndarray
    distance_m: float
    wave_radpm: np.ndarray
    phase_rad: np.ndarray
    weight: np.ndarray

    @classmethod
    def facing(
        cls, normal: tuple[float, float, float], distance_m: float, focal_px: float, seed: int, waves: int = 90
    ) -> TexturedPlane:
        """Texture that has about equal power per octave between 3.5 and 60 px in an image at that distance."""
        random = np.random.default_rng(seed)
        unit = np.array(normal) / np.linalg.norm(normal)
        wavelength_px = 3.5 * (60.0 / 3.5) ** random.uniform(0.0, 1.0, waves)
        direction = random.uniform(0.0, 2.0 * np.pi, waves)
        number = 2.0 * np.pi / (wavelength_px * distance_m / focal_px)
        wave = number[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
        return cls(unit, distance_m, wave, random.uniform(0.0, 2.0 * np.pi, waves), np.full(waves, 1.0))

    def axes(self) -> np.ndarray:
        """Two unit vectors in the plane, as rows."""
        helper = np.eye(3)[np.argmin(np.abs(self.normal))]
        first = np.cross(self.normal, helper)
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.normal, first)])

    def shade(self, points_m: np.ndarray) -> np.ndarray:
        """Brightness, mean 0 and standard deviation 1, of points (n, 3) on the plane.

        The cosines are taken in single precision, many times faster: a phase of a thousand radians, at an image's far
        edge, is rounded by 6e-5, which is 3e-5 px of the shortest wave.
        """
        local = (points_m @ self.axes().T).astype(np.float64)
        total = np.zeros(len(points_m))
        for wave, phase, weight in zip(self.wave_radpm, self.phase_rad, self.weight, strict=True):
            total += weight * np.cos((local @ wave + phase).astype(np.float32))
        return total / np.sqrt(0.5 * np.sum(self.weight**2))


def photograph(
    plane: TexturedPlane, camera: MountedCamera, pose: Pose, *, noise_grey: float = 0.0, seed: int = 0
) -> np.ndarray:
    """uint8 image (rows, columns) of the plane; brightness 128 +- 40, plus white noise."""
    width, height = camera.lens.size_px
    columns, rows = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    rays = camera.rays(pose, np.column_stack([columns.ravel(), rows.ravel()]))
    stretch = (plane.distance_m - plane.normal @ pose.position_body_m) / (rays @ plane.normal)
    grey = 128.0 + 40.0 * plane.shade(pose.position_body_m + rays * stretch[:, None])
    grey += noise_grey * np.random.default_rng(seed).normal(size=grey.shape)
    grey[stretch <= 0.0] = 128.0
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8).reshape(height, width)
