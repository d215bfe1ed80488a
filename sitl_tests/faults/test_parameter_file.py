"""The parameter file under power cuts, bit rot, foreign hands and full disks."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import ConfigError
from companion.params import persist
from companion.params.persist import Keeper, decimal32, last_good, load_stored, store
from companion.params.settings import Settings, tunables

ROWS = list(tunables())
FIRST, SECOND = {"TRG_RATE": 7.0, "RNG_MAX": 120.0}, {"TRG_RATE": 8.0}


def test_no_file_is_no_problem(tmp_path: Path) -> None:
    assert load_stored(tmp_path / "none") == persist.Stored({})


def test_a_removed_file_begins_anew_and_a_damaged_one_does_not(tmp_path: Path) -> None:
    path = tmp_path / "p"
    store(path, FIRST)
    store(path, SECOND)
    path.write_bytes(b"")
    assert load_stored(path).values == FIRST
    path.unlink()
    assert load_stored(path) == persist.Stored({})


@given(st.dictionaries(st.sampled_from(ROWS), st.floats(0, 1), max_size=len(ROWS)))
def test_what_is_stored_is_loaded_exactly(tmp_path_factory: pytest.TempPathFactory, fractions: dict) -> None:
    values = {}
    for row, fraction in fractions.items():
        value = row.minimum + fraction * (row.maximum - row.minimum)
        values[row.name] = float(round(value)) if row.integer else min(max(value, row.minimum), row.maximum)
    path = tmp_path_factory.mktemp("params") / "p"
    store(path, values)
    assert load_stored(path) == persist.Stored(values)


def test_every_damaged_byte_and_every_cut_is_seen_and_the_last_good_file_taken(tmp_path: Path) -> None:
    path = tmp_path / "p"
    store(path, FIRST)
    store(path, SECOND)
    good = path.read_bytes()
    for at in range(len(good)):
        path.write_bytes(good[:at] + bytes([good[at] ^ 0x41]) + good[at + 1 :])
        stored = load_stored(path)
        assert stored.values == FIRST, at
        assert "damaged" in stored.problems[0] or "is not text in UTF-8" in stored.problems[0]
        path.write_bytes(good[:at])
        assert load_stored(path).values == FIRST


def test_a_file_that_is_no_text_is_told_without_a_codec(tmp_path: Path) -> None:
    path = tmp_path / "p"
    path.write_bytes(b"\xa4\x00 rubbish")
    (problem,) = load_stored(path).problems
    assert problem == f"{path}: is not text in UTF-8 (byte 0), so no parameter file; not used"


def test_a_damaged_file_never_replaces_the_last_good_one(tmp_path: Path) -> None:
    path = tmp_path / "p"
    store(path, FIRST)
    store(path, SECOND)
    path.write_text("rubbish")
    store(path, {"TRG_RATE": 9.0})
    assert load_stored(path).values == {"TRG_RATE": 9.0}
    assert load_stored(last_good(path)).values == FIRST


def test_both_files_damaged_gives_the_defaults_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "p"
    path.write_bytes(b"\xff\xfe\x00")
    last_good(path).write_text("")
    stored = load_stored(path)
    assert stored.values == {}
    assert len(stored.problems) == 2
    assert Settings().with_values(stored.values) == Settings()


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_a_power_cut_at_any_step_leaves_the_old_values_or_the_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    for cut_at in range(6):
        path = tmp_path / f"{step}{cut_at}"
        store(path, FIRST)
        calls = 0
        real = getattr(persist.os, step)

        def cut(*arguments: object, cut_at: int = cut_at, real: object = real) -> object:
            nonlocal calls
            calls += 1
            if calls > cut_at:
                raise OSError(5, "power cut")
            return real(*arguments)  # type: ignore[operator]

        with monkeypatch.context() as patch:
            patch.setattr(persist.os, step, cut)
            if cut_at < 2:
                with pytest.raises(ConfigError, match="power cut"):
                    store(path, SECOND)
            else:
                with contextlib.suppress(ConfigError):
                    store(path, SECOND)
        assert load_stored(path).values in (FIRST, SECOND)
        assert not load_stored(path).problems


def test_values_of_another_version_are_left_out_and_named(tmp_path: Path) -> None:
    path = tmp_path / "p"
    store(path, {"OLD_THING": 1.0, "RNG_MAX": 9000.0, "TRG_RATE": 5.0})
    stored = load_stored(path)
    assert stored.values == {"TRG_RATE": 5.0}
    assert len(stored.problems) == 2
    assert "OLD_THING" in " ".join(stored.problems)
    assert "9000" in " ".join(stored.problems)


def test_the_newest_values_win_in_the_thread(tmp_path: Path) -> None:
    path = tmp_path / "p"
    keeper = Keeper(path)
    for rate in range(1, 20):
        keeper.keep({"TRG_RATE": float(rate)})
    keeper.close()
    assert load_stored(path).values == {"TRG_RATE": 19.0}
    assert keeper.problems() == []


@given(st.decimals(min_value=-1000, max_value=1000, places=3, allow_nan=False))
def test_a_decimal_survives_the_way_through_a_32_bit_float(value: object) -> None:
    exact = float(value)  # type: ignore[arg-type]
    assert decimal32(float(np.float32(exact))) == exact


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_the_decimal_stands_for_the_same_float(value: float) -> None:
    assert np.float32(decimal32(value)) == np.float32(value)
