"""Corrections of a recording on its grid: warps without steps, short loads, laws of what is half told."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.wing.effects import catalogue
from companion.core.wing.model import WingModel
from companion.diagnosis.data.transforms import Transforms
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.nonlinear_correction import SensorLineariser
from sitl_tests.unit.test_diagnosis_generic_effects import flown

COUNT, DT_S = 4096, 0.01


@pytest.fixture(scope="module")
def model() -> FlightModel:
    return flown()


def test_a_warp_that_grows_a_little_changes_a_reading_by_its_slope_alone() -> None:
    """Also where some instants pass from one nearest grid point to the next, for signals up to 0.9 of the top."""
    transforms = Transforms(COUNT, DT_S, 0.0)
    rng = np.random.default_rng(4)
    spectrum = np.fft.rfft(rng.standard_normal(COUNT))
    spectrum[int(0.45 * COUNT) :] = 0.0
    slope = spectrum * 2j * np.pi * transforms.f_hz
    t_s = np.arange(COUNT) * DT_S
    at_s = t_s * (1.0 + 5e-5) + 0.003
    grown_s = 1e-8 * t_s
    change = (transforms.at(spectrum, at_s + grown_s) - transforms.at(spectrum, at_s))[8:-8]
    expected = (transforms.at(slope, at_s) * grown_s)[8:-8]
    assert np.std(change - expected) < 0.01 * np.std(expected)


@pytest.mark.slow
def test_columns_of_a_clock_do_not_depend_on_the_step_of_their_difference(model: FlightModel) -> None:
    kind = catalogue()["clock-skew"]
    deviations = np.zeros(len(model.belief.nuisances))

    def toe(rate_s_per_min: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        term = EffectTerm(kind.from_values({"skew_s_per_min": rate_s_per_min, "set_at_s": 3.0}))
        return model.expect(deviations, [term]).toe_residual_rad

    fine, coarse = ((toe(0.004 + step) - toe(0.004)) / step for step in (5e-7, 5e-5))
    assert np.std(fine - coarse) < 0.01 * np.std(coarse)


def test_a_kick_shorter_than_a_sample_gives_its_whole_speed_and_nothing_beyond_the_band(model: FlightModel) -> None:
    """Its integral is the speed it gives; its spectrum at half the top frequency that of a bell of its width."""
    lineariser = SensorLineariser(model.observations, model.transforms)
    kick = catalogue()["impulsive-forcing"].from_values({"symmetric1_mps": 0.5, "at1_s": 20.0, "width_s": 0.002})
    still = np.zeros((2, model.transforms.count))
    wing = WingModel(model.belief.airframe.wing)
    load = lineariser.linearise_forces(wing, [EffectTerm(kick)], still, still).residual_mps2
    spectrum = np.abs(np.fft.rfft(load[0])) * model.transforms.dt_s
    assert spectrum[0] == pytest.approx(0.5, rel=1e-6)
    half = len(spectrum) // 2
    omega_radps = 2.0 * np.pi * model.transforms.f_hz[half]
    assert spectrum[half] == pytest.approx(0.5 * np.exp(-0.5 * (0.002 * omega_radps) ** 2), rel=1e-6)
    assert not np.any(load[1])
    piece = dataclasses.replace(model.observations, start_s=60.0)  # the kick was before it began
    lineariser = SensorLineariser(piece, model.transforms)
    assert not np.any(lineariser.linearise_forces(wing, [EffectTerm(kick)], still, still).residual_mps2)


def test_a_gap_smaller_than_what_is_not_told_of_the_deflection_acts_by_its_mean(model: FlightModel) -> None:
    """The mean of a clipped normal variable, against 200,000 draws of it."""
    lineariser = SensorLineariser(model.observations, model.transforms)
    wing = WingModel(model.belief.airframe.wing)
    rng = np.random.default_rng(5)
    q_m = np.zeros((2, model.transforms.count))
    q_m[0] = 0.005 * rng.standard_normal(q_m.shape[1])
    term = EffectTerm(catalogue()["freeplay"].from_values({"gap_m": 0.0006}))
    pushed = lineariser.linearise_forces(wing, [term], q_m, np.zeros_like(q_m), 0.001)
    force = pushed.residual_mps2[0] + pushed.per_q[0] @ q_m
    near = np.argsort(np.abs(q_m[0] - 0.001))[:5]
    drawn = q_m[0, near] + 0.001 * rng.standard_normal((200_000, 1))
    expected = wing.structure.stiffness_radps2[0, 0] * np.clip(drawn, -0.0006, 0.0006).mean(0)
    assert force[near] == pytest.approx(expected, rel=0.12)
    sharp = lineariser.linearise_forces(wing, [term], q_m, np.zeros_like(q_m))
    assert np.all((sharp.residual_mps2[0] + sharp.per_q[0] @ q_m)[near] > 1.25 * expected)


def test_the_smoother_s_posterior_sigma_is_that_of_each_half(model: FlightModel) -> None:
    motion = model.expect(np.zeros(len(model.belief.nuisances))).motion
    density = 0.0
    for k in range(2):
        prior = (np.abs(motion.linear.receptance[k]) ** 2 * motion.linear.load[k]).real
        gain, recorded = motion.smoother[k], motion.spectrum
        low = gain.shape[-1] - recorded.shape[-1]  # below the band the smoother is 0
        spread = np.einsum("if,ijf,jf->f", gain[:, low:], recorded, gain.conj()[:, low:]).real
        common = np.sum(gain * motion.cross[k].conj(), axis=0).real
        density += float(np.sum((prior - 2.0 * common)[1:]) + np.sum(spread))
    expected_m = np.sqrt(2.0 * density * model.transforms.f_hz[1])
    assert motion._posterior_sigma_m(motion.smoother) == pytest.approx(expected_m, rel=1e-6)  # type: ignore[attr-defined]
    assert 0.0 < expected_m < 0.3 * np.std(motion.in_time[0][0])
