"""Modes of a flight out of its poles: each pole of a block of the recording stands for one mode."""

from __future__ import annotations

import numpy as np
import pytest

from companion.calibration.ambient import AmbientMode, ambient_modes
from companion.records import Floats


def test_a_pole_of_a_block_counts_for_one_mode_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The demo's antisymmetric mode: the whole record split it into 1.4 and 5.2 % of damping, every block shows one."""
    block_poles = np.array(
        [[6.775, 0.057], [6.896, 0.038], [6.911, 0.042], [6.785, 0.057], [6.839, 0.050], [6.927, 0.058]]
    )
    split = np.array([[6.767, 0.014], [6.925, 0.052]])
    (mode,) = _ambient_of(split, [pole[np.newaxis] for pole in block_poles], monkeypatch)
    assert (mode.frequency_hz, mode.damping) == pytest.approx(tuple(block_poles.mean(axis=0)))
    assert (mode.frequency_sigma_hz, mode.damping_sigma) == pytest.approx(
        tuple(block_poles.std(axis=0, ddof=1) / np.sqrt(6))
    )
    assert mode.blocks == 6


def test_two_close_modes_that_every_block_shows_are_two(monkeypatch: pytest.MonkeyPatch) -> None:
    record = np.array([[6.6, 0.02], [7.0, 0.03]])
    blocks = [record + sign * np.array([[0.05, 0.002], [0.08, 0.001]]) for sign in (-1, 1, -1, 1, -1, 1)]
    modes = _ambient_of(record, blocks, monkeypatch)
    assert [(mode.frequency_hz, mode.damping) for mode in modes] == [(6.6, 0.02), (7.0, 0.03)]
    spread = np.sqrt(6 / 5 / 6)  # of six values of +-1
    assert [mode.frequency_sigma_hz for mode in modes] == pytest.approx([0.05 * spread, 0.08 * spread])


def _ambient_of(record: Floats, blocks: list[Floats], monkeypatch: pytest.MonkeyPatch) -> list[AmbientMode]:
    answers = iter([record, *blocks])
    monkeypatch.setattr("companion.calibration.ambient._poles", lambda *_: next(answers))
    return ambient_modes(np.zeros((60, 1)), 200.0, (2.0, 40.0))
