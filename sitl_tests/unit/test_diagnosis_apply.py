"""What a diagnosis found, in the airframe file and read back by everything that knows airframes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.stereo.geometry import Rig
from companion.core.wing.folding import folded
from companion.core.wing.model import WingModel
from companion.params.airframe import Airframe, NamedEffect
from companion.params.files import dump_airframe, load_airframe, parse_airframe
from companion.records import Station

AIRFRAME = load_airframe("nadir-2m")


def with_effect(name: str, **values: float) -> Airframe:
    return dataclasses.replace(AIRFRAME, effects=(NamedEffect(name, values),))


@pytest.mark.parametrize("name", ["frequency-shift", "damping-shift", "load-dependent-bend"])
def test_a_folded_effect_makes_the_same_wing(name: str) -> None:
    extended = with_effect(name, ratio=0.13)
    simulated, tracked = WingModel.from_airframe(extended), WingModel.from_airframe(folded(extended))
    assert folded(extended).effects == ()
    for field in ("stiffness_radps2", "damping_radps", "static_trim_m", "static_per_g_m"):
        there, here = getattr(simulated.structure, field), getattr(tracked.structure, field)
        # a damping ratio that grows with a frequency leaves 2 zeta omega in proportion to both
        assert here == pytest.approx(there), field


def test_a_folded_baseline_and_toe_are_the_rigs() -> None:
    wider = Rig.from_airframe(folded(with_effect("baseline-error", error_m=0.02)))
    assert wider.baseline_m == pytest.approx(Rig.from_airframe(AIRFRAME).baseline_m + 0.02)
    turned = folded(with_effect("convergence-offset", toe_rad=0.004))
    assert turned.left_camera is not None
    assert turned.right_camera is not None
    apart = turned.right_camera.rotation_rad[1] - turned.left_camera.rotation_rad[1]
    assert apart == pytest.approx(0.004)


def test_a_late_stream_is_stamped_earlier() -> None:
    later = folded(with_effect("stream-delay", delay_s=0.003))
    moved = later.sensor(Station.RIGHT).source.stamp_offset_s - AIRFRAME.right.source.stamp_offset_s
    assert moved == pytest.approx(-0.003)
    assert later.left == AIRFRAME.left


def test_what_is_no_airframe_value_stays_an_effect() -> None:
    rubbing = with_effect("coulomb-friction", friction_mps2=0.4)
    assert folded(rubbing) == rubbing


def test_an_extended_airframe_survives_its_file() -> None:
    extended = with_effect("left-right-frequency", ratio=0.02)
    again = parse_airframe(dump_airframe(extended), "again.toml")
    assert again == extended
    coupled = WingModel.from_airframe(again).structure.stiffness_radps2
    assert np.count_nonzero(coupled - np.diag(np.diag(coupled))) == 2
