"""True geometry of a simulated flight's shots: readings by rigid, corrected and perfectly known extrinsics.

Every way of ranging reads the same matches with the same robust product; the true inverse range is what that product
gives for the true depths of the very same features, so that nothing but the extrinsics and the matching is scored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.stereo.epipolar_geometry import epipolar_frame
from companion.core.stereo.exposure import CameraExposure, TipMotion, exposures, rest_exposures, with_relative_rotation
from companion.core.stereo.geometry import Rig, orientation_axis
from companion.core.stereo.inverse_depth import RangeProduct, robust_inverse_depth
from companion.core.stereo.lens_residual import LensAxes, straightened
from companion.core.stereo.ranging import divergence
from companion.core.stereo.triangulation import Rays, match_rays, range_axis_of_rig, triangulate
from companion.params.settings import Settings
from companion.records import Deflection, Floats, MatchSet, RelativeRotation, Side
from companion.sim.flight.flight import Flight
from companion.sim.flight.truth import by_family
from companion.sim.vision.posed_pair import PosedPair


@dataclass(frozen=True, slots=True)
class TrueReading:
    """One way's inverse range of a shot (1/m), and the truth for the same features."""

    inverse_pm: float
    true_inverse_pm: float


class TrueGeometry:
    """Knows the flight's truth; ``start_host_ns`` is the host time of boot time 0."""

    def __init__(self, flight: Flight, pair: PosedPair, settings: Settings, start_host_ns: int) -> None:
        self.flight = flight
        self.pair = pair
        self.start_host_ns = start_host_ns
        self.settings = settings
        self._belief = Rig.from_airframe(flight.airframe)
        self._tips = TipMotion.from_airframe(flight.airframe)
        self._true_tips = TipMotion.from_airframe(flight.real.actual)
        self._axis = orientation_axis(flight.airframe.orientation)
        self._last: tuple[MatchSet, Floats] | None = None  # every way of ranging asks for the same shot's truth

    @property
    def baseline_m(self) -> float:
        """Believed distance of the cameras."""
        return self._belief.baseline_m

    def rigid(self, matches: MatchSet) -> TrueReading | None:
        """The ground calibration, unmodified."""
        return self._read(matches, self._belief, rest_exposures(self._belief))

    def rigid_in_trim(self, matches: MatchSet) -> TrueReading | None:
        """Rigid stereo that was calibrated in level flight: the believed trim bend, and nothing that moves."""
        wing = self.flight.airframe.wing
        bend_m = wing.trim_bend_m.value
        slope_rad = np.full(2, wing.symmetric.slope_factor_radpm.value * bend_m)
        t_ns = int(matches.mid_exposure_ns[0])
        still = _deflection(t_ns, np.array([bend_m, 0.0]), np.zeros(2), slope_rad, np.zeros(3))
        return self._read(matches, self._belief, exposures(self._belief, self._tips, still, still))

    def corrected(
        self, matches: MatchSet, left: Deflection, right: Deflection, turned: RelativeRotation | None = None
    ) -> TrueReading | None:
        """The estimate's own extrinsics: the tracked bend, and what the matches told of the rotation beyond it.

        The flight between both exposures is the true one: what the autopilot tells of it is wrong by a millimetre.
        """
        moving = exposures(self._belief, self._tips, left, right, self._velocity_mps(matches))
        frame = epipolar_frame(self._belief)
        if turned is None:
            return self._read(matches, self._belief, moving)
        moving = with_relative_rotation(moving, frame.T @ turned.rotation_rad)
        rays = straightened(match_rays(self._belief, moving, matches), turned.lens, LensAxes.exposed(moving, frame))
        return self._read_rays(matches, self._belief, rays)

    def oracle(self, matches: MatchSet) -> TrueReading | None:
        """The true extrinsics and lenses."""
        return self._read(matches, self.pair.rig, self._true_exposures(matches))

    def true_toe_rad(self, matches: MatchSet) -> float:
        """Divergence at the exposures of where the middles of both images look, beyond the ground calibration's.

        Counterpart of :attr:`CorrectedRange.toe_rad`: the yaw of a pair that looks ahead, whose wing bends in roll; in
        the plane of the baseline as flown. The middle is the pixel that the belief has on the optical axis: a principal
        point that is off, with the camera turned so that the calibration's board was where it was, is no toe.
        """
        moving = self._true_exposures(matches)
        left_ray, right_ray = (
            self.pair.rig.camera(side).lens.unproject(self._belief.camera(side).lens.matrix[None, :2, 2])[0]
            for side in Side
        )
        return divergence(moving, (left_ray, right_ray)) - divergence(rest_exposures(self._belief))

    def true_range_m(self, matches: MatchSet) -> float:
        """Distance along the range axis to the first surface that it meets midway between the exposures; NaN for sky.

        A range is that of a beam along the axis. The truth of a :class:`TrueReading` is that of the features which it
        counts, and these may lie on another surface.
        """
        body = self.flight.truth.at(self._between_ns(matches))
        sight = range_axis_of_rig(self._belief, self._axis)
        origin_m = body.position_ned_m + body.body_from_ned.T @ sight.origin_m
        reach_m = float(self.pair.scene.hit(origin_m, (body.body_from_ned.T @ sight.axis)[np.newaxis])[0])
        return reach_m if np.isfinite(reach_m) else float("nan")

    def _true_exposures(self, matches: MatchSet) -> tuple[CameraExposure, CameraExposure]:
        left, right = (self.true_deflection(int(t_ns)) for t_ns in matches.mid_exposure_ns)
        return exposures(self.pair.rig, self._true_tips, left, right, self._velocity_mps(matches))

    def _between_ns(self, matches: MatchSet) -> int:
        """Instant midway between the exposures, since boot."""
        left_ns, right_ns = (int(t_ns) - self.start_host_ns for t_ns in matches.mid_exposure_ns)
        return (left_ns + right_ns) // 2

    def _velocity_mps(self, matches: MatchSet) -> Floats:
        """True velocity midway between the exposures, body axes: 10 ms apart it turns the baseline by 0.1 rad."""
        sample = self.flight.truth.at(self._between_ns(matches))
        return np.asarray(sample.body_from_ned @ sample.velocity_ned_mps)

    def true_deflection(self, t_host_ns: int) -> Deflection:
        """The wing as it really was, as an estimate without error."""
        sample = self.flight.truth.at(t_host_ns - self.start_host_ns)
        return _deflection(
            t_host_ns, by_family(sample.q_m), by_family(sample.qdot_mps), sample.slope_rad, sample.body_rate_radps
        )

    def _read(self, matches: MatchSet, rig: Rig, moving: tuple[CameraExposure, CameraExposure]) -> TrueReading | None:
        return self._read_rays(matches, rig, match_rays(rig, moving, matches))

    def _read_rays(self, matches: MatchSet, rig: Rig, rays: Rays) -> TrueReading | None:
        sight = range_axis_of_rig(self._belief, self._axis)
        depths = triangulate(rays, sight, rig.slope_sigma_rad(Side.RIGHT, matches.right_px, matches.sigma_px))
        product, looks_down = RangeProduct(self.settings.product), self.flight.airframe.looks_down
        reading = robust_inverse_depth(depths, product, self.settings.min_matches, one_surface=looks_down)
        if reading is None:
            return None
        if self._last is None or self._last[0] is not matches:
            self._last = matches, self._true_inverse(matches)
        true_inverse = self._last[1]
        counted = np.isfinite(true_inverse) & (reading.weights != 0)
        if not np.array_equal(counted, reading.weights != 0):
            return None
        return TrueReading(reading.inverse_pm, float(reading.weights[counted] @ true_inverse[counted]))

    def _true_inverse(self, matches: MatchSet) -> Floats:
        """Inverse depth along the range axis of what each left pixel really showed, (n,)."""
        left_ns = int(matches.mid_exposure_ns[Side.LEFT]) - self.start_host_ns
        points = self.pair.view(Side.LEFT, left_ns).points_ned_m(self.pair.scene, matches.left_px)
        body = self.flight.truth.at(self._between_ns(matches))
        sight = range_axis_of_rig(self._belief, self._axis)
        depth = ((points - body.position_ned_m) @ body.body_from_ned.T - sight.origin_m) @ sight.axis
        inverse: Floats = 1.0 / np.where(depth > 0, depth, np.nan)
        return inverse


def _deflection(
    t_host_ns: int, q_m: Floats, qdot_mps: Floats, slope_rad: Floats, body_rate_radps: Floats
) -> Deflection:
    """A wing that is known without error."""
    return Deflection(
        t_host_ns=t_host_ns,
        q_m=q_m,
        qdot_mps=qdot_mps,
        slope_rad=slope_rad,
        covariance=np.zeros((6, 6)),
        body_rate_radps=body_rate_radps,
        lag_ns=0,
        slow_slope_sigma_rad=0.0,
    )
