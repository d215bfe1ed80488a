"""Stamps that a logger rounded: evenly sampled all the same, whatever was lost; what really jitters is left alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.adapters.recordings.tables.csv import CsvRecording
from companion.adapters.recordings.tables.stamps import without_rounding
from companion.params.files import load_airframe
from companion.records import Floats


def written(t_s: Floats, decimals: int) -> Floats:
    """Stamps as a text table brings them back."""
    return np.array([float(f"{value:.{decimals}f}") for value in t_s])


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(
    rate_hz=st.floats(150.0, 900.0),
    start_s=st.floats(0.0, 2000.0),
    cut=st.booleans(),
    lost=st.sampled_from([0.0, 0.02]),
    hole=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_rounded_stamps_return_to_the_line_they_were_rounded_from(
    rate_hz: float, start_s: float, cut: bool, lost: float, hole: bool, seed: int
) -> None:
    # a period some per mille beside whole milliseconds (496 Hz) slips so seldom that it is taken for those, to 2 ms
    assume(abs(1e3 / rate_hz - round(1e3 / rate_hz)) > 0.02 or 1e3 % rate_hz == 0.0)
    true_s = start_s + np.arange(int(20.0 * rate_hz)) / rate_hz
    recorded = np.random.default_rng(seed).random(true_s.size) >= lost
    recorded[true_s.size // 3 : true_s.size // 3 + (int(0.7 * rate_hz) if hole else 0)] = False
    true_s = true_s[recorded]
    stamps = written(np.floor(true_s * 1e3) / 1e3 if cut else true_s, 3)
    assume_in_order = bool(np.all(np.diff(stamps) > 0))
    restored_s, note = without_rounding(stamps)
    if not assume_in_order or not note:  # the rate is so near to whole milliseconds that nothing was rounded
        off = stamps - true_s
        assert not assume_in_order or np.ptp(off) < 1e-3 + 1e-9
        return
    # an even grid: what is off is the same everywhere, up to half a millisecond where stamps were cut
    off = restored_s - true_s
    assert abs(np.median(off)) < 1.1e-3
    assert np.std(off - np.median(off)) < 0.5 * np.std(stamps - true_s) + 5e-5


def test_a_rate_that_milliseconds_hold_exactly_is_left_as_it_is() -> None:
    stamps = written(3.0 + np.arange(5000) / 250.0, 3)
    restored_s, note = without_rounding(stamps)
    assert note == ""
    np.testing.assert_array_equal(restored_s, stamps)


def test_stamps_that_jitter_beyond_their_rounding_stay_and_are_told(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    t_s = written(np.sort(np.arange(4000) / 400.0 + rng.uniform(-0.0012, 0.0012, 4000)), 3)
    t_s = np.unique(t_s)
    restored_s, note = without_rounding(t_s)
    assert note == ""
    np.testing.assert_array_equal(restored_s, t_s)


def test_fine_stamps_are_never_moved() -> None:
    stamps = written(np.arange(4000) / 333.0, 6)
    restored_s, note = without_rounding(stamps)
    assert note == ""
    np.testing.assert_array_equal(restored_s, stamps)


def test_a_folder_with_millisecond_stamps_is_read_as_even_and_says_so(tmp_path: Path) -> None:
    t_s = np.arange(8000) / 800.0
    lines = [f"{t:.3f},-9.8,-9.8" for t in np.floor(t_s * 1e3 + 1e-6) / 1e3]
    (tmp_path / "accel.csv").write_text("t_s,left_z_mps2,right_z_mps2\n" + "\n".join(lines) + "\n")
    recording = CsvRecording(tmp_path, load_airframe("nadir-2m"))
    steps_s = np.diff(recording.streams[0].t_ns) * 1e-9
    np.testing.assert_allclose(steps_s, 1.0 / 800.0, atol=2e-6)
    assert np.isclose(recording.airframe.left.rate_hz, 800.0, rtol=1e-3)
    texts = [notice.text for notice in recording.notices]
    assert any("rounded to 1 ms" in text and "1.25 ms" in text for text in texts)
    assert not any("gap" in text or "uneven" in text for text in texts)
