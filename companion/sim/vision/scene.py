"""Scene before the cameras: textured planes in NED, and the true depths along a camera's rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from companion.core.stereo.geometry import MountedCamera, Pose
from companion.records import Bools, Floats
from companion.sim.flight.truth import FlightTruth

_DOWN = np.array([0.0, 0.0, 1.0])
_BOARD_M = (30.0, 20.0)  # width and height of an obstacle: a large house (choice)
_ROUNDING_RAD = 1e-6  # by which a cone is widened, so that nothing on its edge is lost (numerical)


@dataclass(frozen=True, slots=True, eq=False)
class Cone:
    """Field of view of an eye at ``apex_m`` (NED): directions within ``half_angle_rad`` of the unit vector ``axis``."""

    apex_m: Floats
    axis: Floats
    half_angle_rad: float

    @classmethod
    def around(cls, origin_m: Floats, directions: Floats) -> Cone:
        """A cone that holds all directions (n, 3)."""
        units = directions / np.linalg.norm(directions, axis=1)[:, None]
        middle = units.mean(axis=0)
        axis = middle / np.linalg.norm(middle)
        return cls(origin_m, axis, float(np.arccos(np.clip(units @ axis, -1.0, 1.0)).max()))

    def touches(self, centres_m: Floats, radii_m: Floats) -> Bools:
        """Whether spheres (n, 3), (n,) may reach into the cone, (n,)."""
        offsets = centres_m - self.apex_m
        distances = np.maximum(np.linalg.norm(offsets, axis=1), 1e-9)
        away_rad = np.arccos(np.clip(offsets @ self.axis / distances, -1.0, 1.0))
        spread_rad = np.where(radii_m < distances, np.arcsin(np.minimum(radii_m / distances, 1.0)), np.pi)
        return np.asarray(~(away_rad > self.half_angle_rad + spread_rad + _ROUNDING_RAD))


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A flat textured surface.

    Attributes
    ----------
    centre_m, across, along : (3,)
        NED; two orthonormal directions in the plane.
    half_size_m : (across, along) or None
        None has no end.
    surface : int
        Chooses its texture; equal numbers carry equal texture.
    brightness : float
        Mean grey level.
    contrast : float
        Of its texture, over that of meadow.
    furrow : float
        How much longer the texture is along ``along`` than across.
    normal : (3,)
        Unit normal.
    """

    centre_m: Floats
    across: Floats
    along: Floats
    half_size_m: tuple[float, float] | None
    surface: int
    brightness: float = 118.0
    contrast: float = 1.0
    furrow: float = 1.0
    normal: Floats = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "normal", np.cross(self.across, self.along))

    def corners_m(self) -> Floats:
        """The four corners in NED, (4, 3); only for a plane that has an end."""
        assert self.half_size_m is not None
        u, v = self.half_size_m
        signs = np.array([[-u, -v], [u, -v], [u, v], [-u, v]])
        return np.asarray(self.centre_m + signs[:, :1] * self.across + signs[:, 1:] * self.along)

    def hit(self, origin_m: Floats, directions: Floats) -> Floats:
        """How many ``directions`` (n, 3) lead from ``origin_m`` to the plane, (n,); infinite where they miss."""
        reach = self.normal @ (self.centre_m - origin_m)
        closing = directions @ self.normal
        away = closing * np.sign(reach) <= 1e-12
        factors = np.where(away, np.inf, reach / np.where(away, 1.0, closing))
        if self.half_size_m is None:
            return np.asarray(factors)
        local = origin_m + np.where(away, 0.0, factors)[:, None] * directions - self.centre_m
        inside = (np.abs(local @ self.across) <= self.half_size_m[0]) & (
            np.abs(local @ self.along) <= self.half_size_m[1]
        )
        return np.where(inside, factors, np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Surfaces with one texture seed; where none is hit there is plain sky.

    What has an end and lies farther than ``sight_m`` from the eye is lost in the haze, for images and ranges alike.
    """

    planes: tuple[Plane, ...]
    seed: int
    sky: float = 200.0
    sight_m: float = 250.0
    _centres_m: Floats = field(init=False)
    _radii_m: Floats = field(init=False)

    def __post_init__(self) -> None:
        sizes = [plane.half_size_m or (np.inf, np.inf) for plane in self.planes]
        object.__setattr__(self, "_centres_m", np.array([plane.centre_m for plane in self.planes]).reshape(-1, 3))
        object.__setattr__(self, "_radii_m", np.array([np.hypot(*size) for size in sizes]))

    def hit(self, origin_m: Floats, directions: Floats) -> Floats:
        """Nearest surface along each direction, in multiples of it, (n,); infinite for the sky."""
        nearest = np.full(len(directions), np.inf)
        if not len(directions):
            return nearest
        for plane in self.visible(origin_m, [Cone.around(origin_m, directions)]):
            nearest = np.minimum(nearest, plane.hit(origin_m, directions))
        return nearest

    def visible(self, eye_m: Floats, cones: Sequence[Cone]) -> list[Plane]:
        """Surfaces in sight of an eye (3,), in the order of painting: what has no end first, then from far to near.

        What no cone touches is left out.
        """
        distances_m = np.linalg.norm(self._centres_m - eye_m, axis=1)
        endless = np.isinf(self._radii_m)
        touched = np.any([cone.touches(self._centres_m, self._radii_m) for cone in cones], axis=0)
        near = np.flatnonzero(touched & ~endless & (distances_m <= self.sight_m)).tolist()
        near.sort(key=lambda number: (distances_m[number], number), reverse=True)
        return [self.planes[number] for number in [*np.flatnonzero(endless), *near]]


def ground() -> Plane:
    """Endless level ground at NED zero."""
    return Plane(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), None, 0)


def terrace(north_m: float, east_m: float, size_m: tuple[float, float], height_m: float, surface: int) -> Plane:
    """A level platform of ``size_m`` (north, east) above the ground."""
    centre = np.array([north_m, east_m, -height_m])
    return Plane(
        centre, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), (size_m[0] / 2, size_m[1] / 2), surface, 126.0
    )


def board(centre_m: Floats, heading_rad: float, size_m: tuple[float, float], surface: int) -> Plane:
    """An upright board of ``size_m`` (width, height) that faces whoever comes along ``heading_rad``."""
    across = np.array([-np.sin(heading_rad), np.cos(heading_rad), 0.0])
    return Plane(np.asarray(centre_m, float), across, _DOWN, (size_m[0] / 2, size_m[1] / 2), surface, 110.0)


def ground_scene(seed: int) -> Scene:
    """Ground below a downward-looking pair."""
    return Scene((ground(),), seed)


def obstacle_scene(truth: FlightTruth, seed: int, spacing_m: float = 110.0) -> Scene:
    """Ground and upright boards across the path, so that a forward-looking pair closes in on one after another.

    Boards have no thickness and stop nobody: the aircraft passes through each.
    """
    t_ns = truth.t_boot_ns[::20]
    path = truth.series(t_ns)
    flown = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.position_ned_m, axis=0), axis=1))])
    planes = [ground()]
    for number, distance in enumerate(np.arange(spacing_m, flown[-1] + spacing_m, spacing_m), start=1):
        i = min(int(np.searchsorted(flown, distance)), len(flown) - 1)
        velocity = path.velocity_ned_mps[i]
        heading = float(np.arctan2(velocity[1], velocity[0]))
        beyond = (distance - flown[i]) * np.array([np.cos(heading), np.sin(heading), 0.0])
        planes.append(board(path.position_ned_m[i] + beyond, heading, _BOARD_M, number))
    return Scene(tuple(planes), seed)


@dataclass(frozen=True, slots=True, eq=False)
class PosedCamera:
    """One camera in the world: its lens, and its pose in NED."""

    camera: MountedCamera
    camera_from_ned: Floats
    centre_ned_m: Floats

    @classmethod
    def from_body(cls, camera: MountedCamera, pose: Pose, body_from_ned: Floats, position_ned_m: Floats) -> PosedCamera:
        """Carry a body pose into the world; ``body_from_ned`` (3, 3), ``position_ned_m`` (3,)."""
        centre = position_ned_m + body_from_ned.T @ pose.position_body_m
        return cls(camera, pose.camera_from_body @ body_from_ned, centre)

    def depth_m(self, scene: Scene, pixels: Floats) -> Floats:
        """True depth along the optical axis at distorted pixels (n, 2), (n,); infinite for the sky."""
        rays = self.camera.lens.unproject(pixels)
        return scene.hit(self.centre_ned_m, rays @ self.camera_from_ned)

    def points_ned_m(self, scene: Scene, pixels: Floats) -> Floats:
        """Scene points (n, 3) in NED at distorted pixels (n, 2), NaN for the sky."""
        directions = self.camera.lens.unproject(pixels) @ self.camera_from_ned
        factors = scene.hit(self.centre_ned_m, directions)
        return np.asarray(self.centre_ned_m + np.where(np.isfinite(factors), factors, np.nan)[:, None] * directions)

    def project(self, points_ned_m: Floats) -> Floats:
        """Distorted pixels (n, 2) of points (n, 3); NaN behind the camera."""
        return self.camera.lens.project((points_ned_m - self.centre_ned_m) @ self.camera_from_ned.T)
