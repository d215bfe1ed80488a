"""The true camera pair in its scene: where each camera is and what it looks at, at any instant."""

from __future__ import annotations

import dataclasses

import numpy as np

from companion.core.stereo.geometry import MountedCamera, Pose, Rig
from companion.core.stereo.rotation import exp_rotation
from companion.core.wing.effect import Effect, viewed
from companion.core.wing.effects import make_effects
from companion.params.airframe import Airframe, Camera, Uncertain
from companion.records import Floats, Ints, Side
from companion.sim.flight.truth import FlightTruth
from companion.sim.vision.scene import PosedCamera, Scene


class PosedPair:
    """Both cameras of the true airframe in one scene.

    ``airframe`` is the true one (not the belief): its cameras and effects.
    """

    def __init__(self, airframe: Airframe, truth: FlightTruth, scene: Scene) -> None:
        self.truth = truth
        self.scene = scene
        self.effects: tuple[Effect, ...] = make_effects(airframe.effects)
        self.rig = Rig.from_airframe(_refocused(airframe, self.effects))

    def view(self, side: Side, t_boot_ns: int) -> PosedCamera:
        """Pose of a camera at one instant, effects included."""
        return self.views(side, np.array([t_boot_ns], dtype=np.int64))[0]

    def views(self, side: Side, t_boot_ns: Ints) -> list[PosedCamera]:
        """The same at many instants (n,)."""
        series = self.truth.series(t_boot_ns)
        views = []
        for i, t_ns in enumerate(t_boot_ns):
            camera, pose = self._mounted(side, int(t_ns), series.slope_rad[i], series.lift_m[i], series.twist_rad[i])
            views.append(PosedCamera.from_body(camera, pose, series.body_from_ned[i], series.position_ned_m[i]))
        return views

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


def _refocused(airframe: Airframe, effects: tuple[Effect, ...]) -> Airframe:
    """The airframe with the focal lengths that the effects leave it; focal errors do not change in flight."""

    def refocused(side: Side, camera: Camera) -> Camera:
        ratio = viewed(effects, side, 0.0).focal_ratio
        return dataclasses.replace(camera, focal_px=Uncertain(camera.focal_px.value * ratio, camera.focal_px.sigma))

    return airframe.with_cameras(refocused)
