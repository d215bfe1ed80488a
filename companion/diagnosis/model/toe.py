"""Measured toe given the accelerations: its mean, and the covariance that they leave."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from companion.core.stereo.geometry import Rig, epipolar_axes
from companion.core.wing.effect import CameraView, Effect, viewed
from companion.core.wing.model import WingModel
from companion.diagnosis.data.observations import Observations, ToeData
from companion.diagnosis.data.transforms import Transforms
from companion.diagnosis.model.belief import Belief
from companion.diagnosis.model.expectation import Motion
from companion.diagnosis.model.generic_effects import PLAY, GenericToe, GenericToeVariance
from companion.diagnosis.model.toe_regressors import of_unit_rms, taken_up, toe_regressors, toe_variance_regressors
from companion.diagnosis.spectral_matrices import adjoint, product
from companion.records import Complexes, Floats, Side

_FINER = 8  # grid points a sample of the correlation function (choice)
_FOLLOWED = 3  # chosen: modes of which regressors are made: higher ones hardly turn a camera


class ToeModel:
    """The exposures of one recording, on the grid and frequency axis of its accelerations."""

    def __init__(
        self, belief: Belief, observations: Observations, toe: ToeData, transforms: Transforms, f_hz: Floats
    ) -> None:
        self._belief, self._observations, self._toe, self._transforms = belief, observations, toe, transforms
        self._omega: Floats = 2.0 * np.pi * f_hz
        left_camera, right_camera = belief.airframe.left_camera, belief.airframe.right_camera
        assert left_camera is not None
        assert right_camera is not None
        self.baseline_m = right_camera.position_m[1] - left_camera.position_m[1]
        self._toe_per_slope = _toe_per_slope(Rig.from_airframe(belief.airframe))
        place = np.abs(np.subtract.outer(toe.t_s, toe.t_s)) * (_FINER / transforms.dt_s)
        self._lag = place.astype(np.int32)
        self._beyond = place - self._lag
        self._cached: tuple[Motion, object, Floats] | None = None

    def residual(
        self, wing: WingModel, effects: Sequence[Effect], deviation: Mapping[str, float], motion: Motion
    ) -> tuple[Floats, Floats]:
        """Measured minus expected toe, and the variance of the measurement, (k,) each."""
        toe = self._toe
        views = [viewed(effects, side, 0.0) for side in Side]
        late_s = 0.5 * (views[0].exposure_delay_s + views[1].exposure_delay_s)
        rows = self._slope(wing, views)
        row = rows.sum(0)
        expected = self._bending(motion, row, late_s)
        expected = expected + sum(self._static(wing, side, views[side], toe.t_s + late_s) for side in Side)
        sign = (-1.0, 1.0)
        rotation = sum(sign[side] * float(views[side].rotation_rad[1]) for side in Side)
        wider_m = sum(sign[side] * float(views[side].shift_m[1]) for side in Side)
        focal = 0.5 * (views[0].focal_ratio + views[1].focal_ratio) - 1.0 + deviation.get("focal", 0.0)
        expected += rotation + deviation.get("toe_rad", 0.0)
        expected += focal * (self.baseline_m * toe.inverse_m + expected) + wider_m * toe.inverse_m
        expected = expected + self._generic(effects, motion, expected)
        residual = toe.toe_rad - expected
        if not toe.has_reference:
            residual = residual - residual.mean()
        variance = np.full(len(residual), (self._belief.match_sigma_rad() * np.exp(deviation.get("match", 0.0))) ** 2)
        if views[0].jitter_s:
            scattered = self._scattered(wing, views)
            variance += views[0].jitter_s ** 2 * self._squared_rates(motion, scattered, late_s, views[0].jitter_shared)
        spread = [effect for effect in effects if isinstance(effect, GenericToeVariance)]
        if spread:
            turning = self._squared_rates(motion, rows, late_s, 0.0)
            offered = toe_variance_regressors(toe, *self._modes(motion), turning)
            variance = variance * (1.0 + sum(effect.growth(offered) for effect in spread))
        return residual, variance

    def _scattered(self, wing: WingModel, views: Sequence[CameraView]) -> Complexes:
        """Slopes of either camera whose rates give the scatter of exposures that wander, (2, n, f).

        A motion at omega scatters by 1 - exp(-x) times its amplitude squared where it is fastest, x = (omega sigma)^2:
        x exp(-x / 2) to second order.
        """
        still = [dataclasses.replace(view, jitter_s=0.0) for view in views]
        return np.asarray(self._slope(wing, still) * np.exp(-0.25 * (self._omega * views[0].jitter_s) ** 2))

    def _squared_rates(self, motion: Motion, rows: Complexes, late_s: float, shared: float) -> Floats:
        """Square of the toe's rate by its share, and of either camera's by the rest, (k,).

        Exposures that wander together scatter the toe as its own rate has it, others as the rate of either camera.
        """
        left, right = (self._bending(motion, row * (1j * self._omega), late_s) for row in rows)
        return shared * (left + right) ** 2 + (1.0 - shared) * (left**2 + right**2)

    def _generic(self, effects: Sequence[Effect], motion: Motion, expected: Floats) -> Floats | float:
        """Toe that laws without a name add, (k,), rad."""
        toe_terms = [effect for effect in effects if isinstance(effect, GenericToe)]
        if not toe_terms:
            return 0.0
        toe = self._toe
        load = np.interp(toe.t_s, self._observations.t_s, self._observations.wing_load_factor)
        reading_rad = self.baseline_m * toe.inverse_m + expected
        offered = toe_regressors(toe, *self._modes(motion), load, reading_rad)
        for which in {effect.follows for effect in toe_terms} & PLAY.keys():
            played = np.interp(toe.t_s, self._observations.t_s, taken_up(motion.in_time[0], which))
            unit = of_unit_rms(played - np.mean(played))
            offered |= {} if unit is None else {which: unit}
        return sum(effect.added(offered) for effect in toe_terms)

    def _modes(self, motion: Motion) -> tuple[Floats, Floats]:
        """Smoothed deflection and speed of the first modes, and of one more, at the exposures, (n, k) each."""
        t_s = self._observations.t_s
        deflection, speed = (
            np.stack([np.interp(self._toe.t_s, t_s, row) for row in series[:_FOLLOWED]]) for series in motion.in_time
        )
        return deflection, speed

    def posterior(self, wing: WingModel, effects: Sequence[Effect], motion: Motion) -> Floats:
        """Covariance of the toe that the accelerations leave, (k, k), rad^2; with a reference, that of its mean too."""
        row = self._slope(wing, [viewed(effects, side, 0.0) for side in Side]).sum(0)[None]
        density = product(product(row, motion.unknown), adjoint(row))[0, 0].real
        if not self._toe.has_reference:
            density[0] = 0.0  # the residual's mean is taken out
        m = _FINER * self._transforms.count
        lags = np.fft.irfft(np.maximum(density, 0.0), m) * (_FINER / self._transforms.dt_s)
        # periodic like the transform, which keeps it positive definite
        lags = np.append(lags, lags[0])
        return np.asarray(lags[self._lag] * (1.0 - self._beyond) + lags[self._lag + 1] * self._beyond)

    def _bending(self, motion: Motion, row: Complexes, late_s: float) -> Floats:
        """Toe of the smoothed bending at the exposures, (k,), rad; kept, as most camera parameters do not change it."""
        steady = row.shape[-1] == 1
        key = (row.tobytes(), late_s)
        if steady and self._cached is not None and self._cached[0] is motion and self._cached[1] == key:
            return self._cached[2]
        bending_rad = self._transforms.at(np.sum(row * motion.modal, axis=0), self._toe.t_s + late_s)
        if steady:
            self._cached = (motion, key, bending_rad)
        return bending_rad

    def _slope(self, wing: WingModel, views: Sequence[CameraView]) -> Complexes:
        """Slope of either camera per modal deflection, (2, n, f); (2, n, 1) where every frequency is followed alike."""
        slope = wing.structure.slope_radpm[..., None] * self._toe_per_slope[:, None, None]
        return np.stack([view.follows(self._omega) * slope[side] for side, view in enumerate(views)])

    def _static(self, wing: WingModel, side: Side, view: CameraView, at_s: Floats) -> Floats:
        structure = wing.structure
        # what the load factor bends beyond its mean is in the motion: it drives the wing
        load = np.full(len(at_s), float(np.mean(self._observations.load_factor)) - 1.0)
        bend = structure.static_trim_m[:, None] + structure.static_per_g_m[:, None] * load
        return np.asarray(view.slope_gain * self._toe_per_slope[side] * (structure.slope_radpm[side] @ bend))


def _toe_per_slope(rig: Rig) -> Floats:
    """Toe by the slope of either tip, (2,): 1 for a pair that looks down, 0 ahead, where a bend turns images alone."""
    turns = np.stack([-rig.left.turn_rad(1.0), rig.right.turn_rad(1.0)], axis=1)
    return np.asarray((epipolar_axes(rig.left.rest, rig.right.rest) @ turns)[1])
