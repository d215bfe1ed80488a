"""Delay of the tips' sensors by the fuselage's recoil: measured, a part of the likelihood, no clock of the cameras."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from companion.core.wing.effects import catalogue
from companion.core.wing.lowpass import Butterworth2
from companion.diagnosis.data.observations import RawRecording, RawStream
from companion.diagnosis.data.recoil import RecoilDelay, recoil_delay
from companion.diagnosis.flights.recordings import diagnose
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import fit
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.evaluation.flight_models import models_of
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.records import Floats, Side, Station
from tools.trial_generators import STRANGER
from tools.trial_judge import model_of
from tools.trial_truths.stranger.cases import fly_all, hide

RATE_HZ, SECONDS = 400.0, 60.0


def _flown(airframe: Airframe, late_s: float, lifted: float, recoils: bool = True) -> tuple[Floats, Floats]:
    """Tips (m, 2) through their own filters, late, and a root that recoils by 6 % and is lifted by the mode's load."""
    rng = np.random.default_rng(3)
    count = round(RATE_HZ * SECONDS)
    omega = 2.0 * np.pi * np.fft.rfftfreq(count, 1.0 / RATE_HZ)
    mode = airframe.wing.symmetric
    first, zeta = 2.0 * np.pi * mode.frequency_hz.value, mode.damping.value
    load = np.fft.rfft(rng.standard_normal(count))
    tip = -(omega**2) * load / (first**2 - omega**2 + 2j * zeta * first * omega)
    root = -0.06 * tip * recoils + lifted * 0.06 * load
    root += 0.003 * np.std(np.fft.irfft(tip, count)) * np.fft.rfft(rng.standard_normal(count))
    shown = (
        tip * np.exp(-1j * omega * late_s) * Butterworth2(airframe.left.lowpass_accel_hz).response(omega / 2.0 / np.pi)
    )
    both = np.fft.irfft(shown, count)
    return np.stack([both, both], 1), np.fft.irfft(root, count)


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    """One whose tips' sensors are filtered."""
    loaded = load_airframe("nadir-2m")
    return dataclasses.replace(
        loaded,
        left=dataclasses.replace(loaded.left, lowpass_accel_hz=60.0),
        right=dataclasses.replace(loaded.right, lowpass_accel_hz=60.0),
    )


@pytest.mark.parametrize("lifted", [0.0, 1.0])
@pytest.mark.parametrize("late_s", [0.0, 0.002, -0.003])
def test_a_delay_of_the_tips_is_measured_whatever_the_gust_does_to_the_fuselage(
    airframe: Airframe, late_s: float, lifted: float
) -> None:
    measured = recoil_delay(*_flown(airframe, late_s, lifted), RATE_HZ, airframe)
    assert measured is not None
    assert measured.sigma_s < 1e-3
    assert abs(measured.delay_s - late_s) < 3.0 * measured.sigma_s


def test_a_fuselage_that_does_not_recoil_is_no_clock(airframe: Airframe) -> None:
    assert recoil_delay(*_flown(airframe, 0.002, 0.0, recoils=False), RATE_HZ, airframe) is None


def _stranger(name: str, seed: int) -> FlightModel:
    label = hide([name], (10.0, 10.0), np.random.default_rng(seed))
    (tables,) = fly_all([label], [20.0], seed)
    return model_of(tables, STRANGER.airframe(20.0, 0.0), STRANGER.top_hz)


@pytest.mark.long
def test_a_filter_of_the_sensors_is_not_taken_for_a_late_exposure() -> None:
    """Ranges alone confuse them; where the filter is no longer offered, nothing is named."""
    model = _stranger("sensor-filter", 41)
    measured = model.observations.recoil
    assert isinstance(measured, RecoilDelay)
    assert measured.delay_s == pytest.approx(0.002, abs=4.0 * measured.sigma_s)
    named = diagnose([model], list(catalogue().values()))
    assert [(cause.term.effect.name, cause.group) for cause in named.causes] == [("sensor-filter", ())]
    without = diagnose([model], [kind for name, kind in catalogue().items() if name != "sensor-filter"])
    assert without.verdict is DiagnosisVerdict.UNEXPLAINED


@pytest.mark.slow
def test_a_window_of_a_recording_does_not_count_the_recoil_of_the_whole() -> None:
    model = _stranger("accel-bias", 42)
    assert model.observations.recoil is not None
    assert model.observations.window(10.0, 30.0).recoil is None


@pytest.mark.slow
def test_what_nature_has_one_way_has_half_a_prior_of_twice_the_density() -> None:
    """The evidence of a lag, which is never negative, is that of a whole normal prior and ln 2."""
    model = _stranger("accel-bias", 42)
    term = EffectTerm(catalogue()["mount-lag"].from_values({"lag_s": 1e-4}))
    fitted = fit([model], [term])
    sigmas, precision = fitted.sigmas, np.linalg.inv(fitted.covariance)
    laplace = fitted.log_likelihood - fitted.neg_log_prior(range(len(fitted.values)))
    laplace -= float(np.sum(np.log(sigmas))) + 0.5 * float(np.linalg.slogdet(precision)[1])
    assert fitted.log_evidence - laplace == pytest.approx(np.log(2.0))


def test_a_sensor_s_filter_is_stable_whatever_its_second_term() -> None:
    """A gain that falls and turns no phase is none of a filter: it would pass for a gust that is coloured."""
    kind, f_hz = catalogue()["sensor-filter"], np.linspace(0.0, 50.0, 11)
    first_order = kind.from_values({"lag_s": 0.001}).response(Station.LEFT, f_hz)
    beyond = kind.from_values({"lag_s": 0.001, "second_s2": -5e-6}).response(Station.LEFT, f_hz)
    np.testing.assert_array_equal(beyond, first_order)


def test_each_piece_of_a_long_recording_is_timed_by_its_own_recoil(
    airframe: Airframe, monkeypatch: pytest.MonkeyPatch
) -> None:
    tips, root = _flown(airframe, 0.003, 0.0)
    t_s = np.arange(len(root)) / RATE_HZ
    sides = {side: RawStream(t_s, tip) for side, tip in zip(Side, tips.T, strict=True)}
    raw = RawRecording(sides, RawStream(t_s, root - 9.8))
    monkeypatch.setattr("companion.evaluation.flight_models.load", lambda *_: raw)
    monkeypatch.setattr("companion.evaluation.flight_models._LONGEST_S", 25.0)
    unfiltered = dataclasses.replace(airframe, root=dataclasses.replace(airframe.root, lowpass_accel_hz=0.0))
    models = models_of([Path("long")], unfiltered)
    assert len(models) == 3
    for model in models:
        assert model.observations.recoil is not None
        assert model.observations.recoil.delay_s == pytest.approx(0.003, abs=0.0003)
