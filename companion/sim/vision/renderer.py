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

from companion.core.stereo.geometry import MountedCamera, Pose, Rig
from companion.core.stereo.rotation import exp_rotation
from companion.core.wing.effect import Effect, viewed
from companion.core.wing.effects import make_effects
from companion.params.airframe import Airframe, Camera, Uncertain
from companion.records import Bytes, Floats, Ints, Side
from companion.sim.flight.truth import FlightTruth
from companion.sim.vision.scene import PosedCamera, Scene
from companion.sim.vision.shutter import PixelGrid
from companion.sim.vision.texture import Image32, NoiseTile
from companion.sim.vision.textured_plane import SurfacePainter

_READ_NOISE = 0.8  # grey levels rms, an 8-bit machine-vision sensor
_PHOTON_GAIN = 0.012  # variance of photon noise per grey level: 83 electrons a level
_NOISE_SPARE = 512  # pixels by which the noise field is larger than an image, each way


@dataclass(frozen=True, slots=True)
class ExposureInterval:
    """When a camera looked: middle of the middle row's exposure, its length, time between rows."""

    mid_boot_ns: int
    exposure_ns: int
    row_time_ns: int = 0


class Renderer:
    """Both cameras of the true airframe in one scene.

    Parameters
    ----------
    airframe : Airframe
        The true one (not the belief): its cameras and effects.
    truth : FlightTruth
    scene : Scene
    seed : int
        Of the sensor noise; the texture has the scene's.
    """

    def __init__(self, airframe: Airframe, truth: FlightTruth, scene: Scene, seed: int) -> None:
        self.truth = truth
        self.scene = scene
        self.seed = seed
        self.effects: tuple[Effect, ...] = make_effects(airframe.effects)
        self.rig = Rig.from_airframe(_refocused(airframe, self.effects))
        self._painter = SurfacePainter(NoiseTile(scene.seed), scene.seed)
        self._grids = {side: PixelGrid(self.rig.camera(side).lens) for side in Side}
        largest = np.max([self.rig.camera(side).lens.size_px for side in Side], axis=0)
        bank = np.random.default_rng([seed, 0x5E25])
        self._noise: Image32 = bank.standard_normal((largest + _NOISE_SPARE)[::-1], dtype=np.float32)

    def view(self, side: Side, t_boot_ns: int) -> PosedCamera:
        """Pose of a camera at one instant, effects included."""
        return self.views(side, np.array([t_boot_ns], dtype=np.int64))[0]

    def views(self, side: Side, t_boot_ns: Ints) -> list[PosedCamera]:
        """The same at many instants."""
        series = self.truth.series(t_boot_ns)
        views = []
        for i, t_ns in enumerate(t_boot_ns):
            camera, pose = self._mounted(side, int(t_ns), series.slope_rad[i], series.lift_m[i], series.twist_rad[i])
            views.append(PosedCamera.from_body(camera, pose, series.body_from_ned[i], series.position_ned_m[i]))
        return views

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
        self._painter.paint(image, self.scene.visible(views[0].centre_ned_m), views, grid, track)
        return self._expose(image, side, shot)

    def _mounted(
        self, side: Side, t_ns: int, slope_rad: Floats, lift_m: Floats, twist_rad: Floats
    ) -> tuple[MountedCamera, Pose]:
        camera = self.rig.camera(side)
        pose = camera.pose(float(slope_rad[side]), float(lift_m[side]), float(twist_rad[side]))
        if self.effects:
            extra = viewed(self.effects, side, t_ns * 1e-9)
            turned = exp_rotation(-extra.rotation_rad) @ pose.camera_from_body
            pose = Pose(turned, pose.position_body_m + extra.shift_m)
        return camera, pose

    def _expose(self, image: Image32, side: Side, shot: int) -> Bytes:
        """Photon and read noise, quantisation, saturation; the noise is a random place of a random field."""
        rows, columns = image.shape
        place = np.random.default_rng([self.seed, side, shot])
        row, column = place.integers(0, _NOISE_SPARE + 1, 2)
        field = self._noise[row : row + rows, column : column + columns]
        if place.integers(0, 2):
            field = field[::-1]
        cv2.max(image, 0.0, dst=image)
        spread = cv2.sqrt(cv2.add(cv2.multiply(image, _PHOTON_GAIN), _READ_NOISE**2))
        noise = cv2.multiply(spread, field)
        return np.asarray(cv2.add(image, noise, dtype=cv2.CV_8U))


def _refocused(airframe: Airframe, effects: tuple[Effect, ...]) -> Airframe:
    """The airframe with the focal lengths that the effects leave it; focal errors do not change in flight."""

    def camera(side: Side, record: Camera | None) -> Camera | None:
        if record is None:
            return None
        ratio = viewed(effects, side, 0.0).focal_ratio
        return dataclasses.replace(record, focal_px=Uncertain(record.focal_px.value * ratio, record.focal_px.sigma))

    return dataclasses.replace(
        airframe,
        left_camera=camera(Side.LEFT, airframe.left_camera),
        right_camera=camera(Side.RIGHT, airframe.right_camera),
    )
