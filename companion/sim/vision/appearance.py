"""Mist, lens and gain between a scene and its image: haze, defocus, vignetting, unequal cameras."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np

from companion.records import Side
from companion.sim.flight.world_draw import log_uniform
from companion.sim.flight.worlds import ImageFaults
from companion.sim.vision.scene import PosedCamera, Scene
from companion.sim.vision.texture import Image32

KOSCHMIEDER = 3.912
"""Extinction times visibility: contrast falls to 2 % there (Koschmieder 1924)."""

_HAZE_GRID = (20, 15)  # places across and down at which distance is looked up: haze is smooth (choice)


@dataclass(frozen=True, slots=True)
class Appearance:
    """Faults of one camera's images; ``noise_ratio`` multiplies the sensor's noise."""

    vignetting: float
    defocus_px: float
    gain: float
    noise_ratio: float
    visibility_m: float

    @classmethod
    def draw(cls, faults: ImageFaults, side: Side, seed: int) -> Appearance | None:
        """One camera of a flight; None where the world's images are perfect."""
        if faults == ImageFaults():
            return None
        rng = np.random.default_rng([seed, side, *b"image"])
        return cls(
            log_uniform(faults.vignetting, rng),
            log_uniform(faults.defocus_px, rng),
            1.0 + faults.gain_sigma * float(rng.standard_normal()),
            log_uniform(faults.noise_ratio, rng),
            faults.visibility_m,
        )

    def applied(self, image: Image32, view: PosedCamera, scene: Scene) -> Image32:
        """The image (rows, columns) as it falls on the sensor, in grey levels."""
        if self.visibility_m > 0.0:
            image = self._hazy(image, view, scene)
        if self.defocus_px > 0.0:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), self.defocus_px), dtype=np.float32)
        return np.asarray(image * (self.gain * _light(self.vignetting, image.shape)), dtype=np.float32)

    def _hazy(self, image: Image32, view: PosedCamera, scene: Scene) -> Image32:
        rows, columns = image.shape
        across, down = _HAZE_GRID
        x, y = (np.arange(across) + 0.5) * columns / across - 0.5, (np.arange(down) + 0.5) * rows / down - 0.5
        pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        rays = view.camera.lens.unproject(pixels)
        distance_m = view.depth_m(scene, pixels) * np.linalg.norm(rays, axis=1)
        clear = np.exp(-KOSCHMIEDER * distance_m / self.visibility_m).reshape(down, across).astype(np.float32)
        transmission = np.asarray(cv2.resize(clear, (columns, rows), interpolation=cv2.INTER_LINEAR))
        return np.asarray(scene.sky + transmission * (image - scene.sky), dtype=np.float32)


@functools.lru_cache(maxsize=4)
def _light(vignetting: float, shape: tuple[int, ...]) -> Image32:
    """Share of light (rows, columns): 1 in the middle, falling with the square of the distance to the corner's."""
    rows, columns = shape
    y, x = np.ogrid[-1.0 : 1.0 : rows * 1j, -1.0 : 1.0 : columns * 1j]
    aspect = rows / columns
    square = (x**2 + (aspect * y) ** 2) / (1.0 + aspect**2)
    return np.asarray(1.0 - vignetting * square, dtype=np.float32)
