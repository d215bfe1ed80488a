"""Images of the truth: what a camera at a wingtip records during its exposure, exact to a hundredth of a pixel.

Every plane is sampled from its texture octave by octave through the exact homography of the pose (through a map where
the lens distorts or the shutter rolls). Blur is the average over poses spread evenly about mid-exposure, as many for
each octave as its wavelength needs; the poses of one exposure lie on a polynomial through exact ones.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import cv2
import numpy as np

from companion.core.wing.effect import viewed
from companion.params.airframe import Airframe
from companion.records import Bytes, Side
from companion.sim.flight.truth import FlightTruth
from companion.sim.flight.worlds import ImageFaults
from companion.sim.vision.appearance import Appearance
from companion.sim.vision.posed_pair import PosedPair
from companion.sim.vision.scene import Cone, Scene
from companion.sim.vision.shutter import PixelGrid
from companion.sim.vision.texture import Image32, NoiseTile
from companion.sim.vision.textured_plane import SurfacePainter

_READ_NOISE = 0.8  # grey levels rms, an 8-bit machine-vision sensor (choice)
_PHOTON_GAIN = 0.012  # variance of photon noise per grey level: 83 electrons a level (choice)
PERFECT = ImageFaults()
_NOISE_SPARE = 512  # pixels by which the noise field is larger than an image, each way (choice)


@dataclass(frozen=True, slots=True)
class ExposureInterval:
    """When a camera looked: middle of the middle row's exposure, its length, time between rows."""

    mid_boot_ns: int
    exposure_ns: int
    row_time_ns: int = 0


class Renderer(PosedPair):
    """Both cameras of the true airframe in one scene.

    As :class:`companion.sim.vision.posed_pair.PosedPair`; ``seed`` is of the sensor noise (the texture has the
    scene's), ``images`` are the faults of the world flown in.
    """

    def __init__(
        self, airframe: Airframe, truth: FlightTruth, scene: Scene, seed: int, images: ImageFaults = PERFECT
    ) -> None:
        super().__init__(airframe, truth, scene)
        self.seed = seed
        self._appearance = {side: Appearance.draw(images, side, seed) for side in Side}
        self._painter = SurfacePainter(NoiseTile(scene.seed), scene.seed)
        self._grids = {side: PixelGrid(self.rig.camera(side).lens) for side in Side}
        largest = np.max([self.rig.camera(side).lens.size_px for side in Side], axis=0)
        bank = np.random.default_rng([seed, 0x5E25])
        self._noise: Image32 = bank.standard_normal((largest + _NOISE_SPARE)[::-1], dtype=np.float32)

    def render(self, side: Side, exposure: ExposureInterval, shot: int) -> Bytes:
        """One image (rows, columns); ``shot`` chooses the noise.

        Raises
        ------
        ValueError
            If the exposure does not lie wholly within the flight.
        """
        delay_ns = round(viewed(self.effects, side, exposure.mid_boot_ns * 1e-9).exposure_delay_s * 1e9)
        exposure = dataclasses.replace(exposure, mid_boot_ns=exposure.mid_boot_ns + delay_ns)
        grid = self._grids[side]
        track = grid.track(exposure.exposure_ns, exposure.row_time_ns)
        views = self.views(side, exposure.mid_boot_ns + track.offsets_ns)
        width, height = grid.size_px
        image: Image32 = np.full((height, width), self.scene.sky, np.float32)
        cones = [Cone(view.centre_ned_m, view.camera_from_ned[2], grid.half_angle_rad) for view in views]
        planes = self.scene.visible(views[0].centre_ned_m, cones)
        self._painter.paint(image, planes, views, grid, track)
        appearance = self._appearance[side]
        if appearance is None:
            return self._expose(image, side, shot, 1.0)
        return self._expose(appearance.applied(image, views[0], self.scene), side, shot, appearance.noise_ratio)

    def _expose(self, image: Image32, side: Side, shot: int, noise_ratio: float) -> Bytes:
        """Photon and read noise, quantisation, saturation; the noise is a random place of a random field."""
        rows, columns = image.shape
        place = np.random.default_rng([self.seed, side, shot])
        row, column = place.integers(0, _NOISE_SPARE + 1, 2)
        field = self._noise[row : row + rows, column : column + columns]
        if place.integers(0, 2):
            field = field[::-1]
        cv2.max(image, 0.0, dst=image)
        spread = cv2.sqrt(cv2.add(cv2.multiply(image, _PHOTON_GAIN), _READ_NOISE**2))
        noise = cv2.multiply(spread, field, scale=noise_ratio)
        return np.asarray(cv2.add(image, noise, dtype=cv2.CV_8U))
