"""Effects that a diagnosis names, in the airframe file and read back by everything that knows airframes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from companion.core.stereo.geometry import Rig
from companion.core.wing.effects import apply_to_airframe, catalogue, make_effect
from companion.core.wing.model import WingModel
from companion.core.wing.sample_corrections import SampleCorrections
from companion.diagnosis.data.observations import RawRecording, RawStream
from companion.diagnosis.data.resampling import observe
from companion.diagnosis.flights.outcome import FlightDiagnosis
from companion.diagnosis.model.belief import believe
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import FlightFit, FlightState
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.diagnosis.selection.diagnosis import Diagnosis
from companion.diagnosis.selection.fit import Fit
from companion.diagnosis.selection.recordings import Cause, no_correlation
from companion.evaluation.extended_airframe import extended
from companion.params.airframe import Airframe, NamedEffect
from companion.params.files import dump_airframe, load_airframe, parse_airframe
from companion.records import Axis, ClockName, ImuBatch, Side, Station

AIRFRAME = load_airframe("nadir-2m")


def with_effect(name: str, **values: float) -> Airframe:
    return dataclasses.replace(AIRFRAME, effects=(NamedEffect(name, values),))


@pytest.mark.parametrize("name", ["frequency-shift", "damping-shift", "load-dependent-bend"])
def test_an_applied_effect_makes_the_same_wing(name: str) -> None:
    extended = with_effect(name, ratio=0.13)
    simulated, tracked = WingModel.from_airframe(extended), WingModel.from_airframe(apply_to_airframe(extended))
    assert apply_to_airframe(extended).effects == ()
    for field in ("stiffness_radps2", "damping_radps", "static_trim_m", "static_per_g_m"):
        expected, here = getattr(simulated.structure, field), getattr(tracked.structure, field)
        # a damping ratio that grows with a frequency leaves 2 zeta omega in proportion to both
        assert here == pytest.approx(expected), field


def test_an_applied_baseline_and_toe_are_the_rigs() -> None:
    wider = Rig.from_airframe(apply_to_airframe(with_effect("baseline-error", error_m=0.02)))
    assert wider.baseline_m == pytest.approx(Rig.from_airframe(AIRFRAME).baseline_m + 0.02)
    turned = apply_to_airframe(with_effect("convergence-offset", toe_rad=0.004))
    assert turned.left_camera is not None
    assert turned.right_camera is not None
    apart = turned.right_camera.rotation_rad[1] - turned.left_camera.rotation_rad[1]
    assert apart == pytest.approx(0.004)


def test_a_late_stream_is_stamped_earlier() -> None:
    later = apply_to_airframe(with_effect("stream-delay", delay_s=0.003))
    moved = later.sensor(Station.RIGHT).source.stamp_offset_s - AIRFRAME.right.source.stamp_offset_s
    assert moved == pytest.approx(-0.003)
    assert later.left == AIRFRAME.left


def batch_of(station: Station) -> ImuBatch:
    values = np.tile([0.1, 0.2, -9.9, 0.01, 0.02, 0.03], (3, 1))
    return ImuBatch(station, ClockName.NODE_RIGHT, 1_000_000 * np.arange(3), values, Axis.Z, 0)


@pytest.mark.parametrize("name", ["accel-scale", "accel-bias"])
def test_a_named_error_of_a_sensor_is_out_of_what_the_tracker_gets(name: str) -> None:
    """The effect's change of true samples is undone, on its side, and nothing on the other."""
    first, second = (entry.name for entry in catalogue()[name].parameters())
    applied = with_effect(name, **{first: 0.0, second: 0.2})
    true = batch_of(Station.RIGHT)
    sent = make_effect(applied.effects[0]).sense(Station.RIGHT, true.t_ns * 1e-9, true.values)
    assert not np.allclose(sent, true.values)
    corrections = SampleCorrections.of(applied)
    assert corrections.corrected(dataclasses.replace(true, values=sent)).values == pytest.approx(true.values)
    other = batch_of(Station.LEFT)
    assert corrections.corrected(other) is other


def test_a_named_late_stream_reaches_the_tracker_with_earlier_stamps() -> None:
    corrections = SampleCorrections.of(with_effect("stream-delay", delay_s=-0.002))
    late, other = batch_of(Station.LEFT), batch_of(Station.RIGHT)
    assert corrections.corrected(late).t_ns == pytest.approx(late.t_ns - 2_000_000)
    assert corrections.corrected(other) is other


def test_what_is_no_airframe_value_stays_an_effect() -> None:
    rubbing = with_effect("coulomb-friction", friction_mps2=0.4)
    assert apply_to_airframe(rubbing) == rubbing


def test_an_extended_airframe_survives_its_file() -> None:
    extended = with_effect("left-right-frequency", ratio=0.02)
    again = parse_airframe(dump_airframe(extended), "again.toml")
    assert again == extended
    coupled = WingModel.from_airframe(again).structure.stiffness_radps2
    assert np.count_nonzero(coupled - np.diag(np.diag(coupled))) == 2


def named(name: str) -> NamedEffect:
    """An effect at a hundredth of its priors, following a channel where it needs one."""
    kind = catalogue()[name]
    values = {entry.name: entry.default + 0.01 * entry.sigma for entry in kind.parameters()}
    return NamedEffect(name, values, *(("airspeed_mps", 17.0, 2.0) if kind.follows_channel else ()))


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_every_effect_survives_its_file_and_is_in_force_for_all(name: str) -> None:
    """Simulator (as it is), tracker and replay (applied as values, or kept), and the next diagnosis."""
    entry = named(name)
    extended = dataclasses.replace(AIRFRAME, effects=(entry,))
    again = parse_airframe(dump_airframe(extended), "again.toml")
    assert again == extended
    assert WingModel.from_airframe(again).effects == (make_effect(entry),)
    believed = believe(again, (Side.LEFT, Side.RIGHT), False, False)
    in_force = not catalogue()[name].belongs_to_recording()
    assert believed.terms == (EffectTerm(make_effect(entry), entry.channel),) * in_force
    value = apply_to_airframe(again)
    assert value.effects == again.effects or (not value.effects and value != AIRFRAME)


def test_an_effect_in_force_follows_its_channel_in_the_units_it_was_found_in() -> None:
    """Known from the airframe file, or given beside it: the same likelihood; without its channel another one."""
    rng = np.random.default_rng(3)
    t_s = np.arange(12000) / 1000.0
    airspeed = 15.0 + 3.0 * np.sin(0.9 * t_s)
    mode = AIRFRAME.wing.symmetric
    pole = np.exp(2e-3 * np.pi * mode.frequency_hz.value * (1j - mode.damping.value))
    swing = lfilter([1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], rng.standard_normal((2, len(t_s))))
    tips = {side: RawStream(t_s, -9.80665 + swing[side] / swing.std()) for side in Side}
    raw = RawRecording(tips, None, None, {"airspeed_mps": (t_s, airspeed)})
    entry = NamedEffect("airspeed-dependence", {"frequency_per_rms": 0.05}, "airspeed_mps", 17.0, 2.0)

    def likelihood(effect: NamedEffect | None) -> float:
        airframe = dataclasses.replace(AIRFRAME, effects=(effect,) if effect else ())
        (observations,) = observe(raw, airframe, 40.0)
        model = FlightModel(believe(airframe, observations.sides, False, False), observations, 40.0)
        if effect and effect.channel:
            assert model.observations.covariates["airspeed_mps"].mean() == pytest.approx(-1.0, abs=0.2)
        return model.log_likelihood(model.expect(np.zeros(len(model.belief.nuisances))))

    plain, lost = likelihood(None), likelihood(dataclasses.replace(entry, channel=""))
    assert lost == pytest.approx(plain)
    assert abs(likelihood(entry) - plain) > 1e-3 * abs(plain)


def test_a_fitted_toe_turns_the_cameras_and_leaves_the_sigma_of_their_three_axes() -> None:
    belief = believe(AIRFRAME, tuple(Side), True, False)
    keys = tuple(entry.key for entry in belief.nuisances)
    values = np.array([0.002 if key == "toe_rad" else 0.0 for key in keys])
    count = len(keys)
    fitted: FlightFit = Fit(
        (), keys, (), values, values, np.ones(count), 1e-14 * np.eye(count), 0.0, 0.0, True, FlightState((), ())
    )
    none = no_correlation([])
    causes = [
        Cause(EffectTerm(catalogue()[name]()), (), 50.0, -100.0, 10.0, (0.1,))
        for name in ("tone", "dropout-jitter", "impulsive-forcing", "frequency-drift")
    ]
    diagnosis: FlightDiagnosis = Diagnosis(
        DiagnosisVerdict.EXPLAINED, tuple(causes), "", (), "", fitted, fitted, none, (), (), None
    )
    applied = extended(AIRFRAME, belief, diagnosis)
    assert [effect.name for effect in applied.effects] == ["frequency-drift"]
    for camera, before, sign in (
        (applied.left_camera, AIRFRAME.left_camera, -1.0),
        (applied.right_camera, AIRFRAME.right_camera, 1.0),
    ):
        assert camera is not None
        assert before is not None
        assert camera.rotation_rad[1] - before.rotation_rad[1] == pytest.approx(sign * 0.001)
        assert camera.rotation_sigma_rad == before.rotation_sigma_rad
        assert camera.focal_px.sigma < before.focal_px.sigma
