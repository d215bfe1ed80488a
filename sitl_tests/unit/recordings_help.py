"""Records of every kind for the recording tests, built from their type hints by hypothesis, and exact comparison."""

from __future__ import annotations

import dataclasses
import types
import typing
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from companion.records import Axis, Flow, FramePair, ImuBatch, MatchSet, Side

_INT64 = st.integers(-(2**63), 2**63 - 1)
_NS = st.integers(0, 2**62)
_FLOAT = st.floats(allow_nan=True, allow_infinity=True).map(lambda value: float("nan") if value != value else value)


def record_of(kind: type) -> st.SearchStrategy[Any]:
    """Any record of this class; NaN only as the usual NaN (its sign and payload mean nothing)."""
    if kind is ImuBatch:
        return st.integers(0, 5).flatmap(lambda n: _fields(kind, {"t_ns": (n,), "values": (n, 6)})).map(_only_sent)
    if kind is MatchSet:
        return st.integers(0, 5).flatmap(
            lambda n: _fields(kind, {"left_px": (n, 2), "right_px": (n, 2), "sigma_px": (n,), "mid_exposure_ns": (2,)})
        )
    if kind is FramePair:
        return _fields(kind, {}).map(
            lambda pair: FramePair(
                pair.pair_id,
                dataclasses.replace(pair.left, side=Side.LEFT),
                dataclasses.replace(pair.right, side=Side.RIGHT),
            )
        )
    return _fields(kind, {})


def _only_sent(batch: ImuBatch) -> ImuBatch:
    values = np.where([bool(batch.axes >> i & 1) for i in range(6)], batch.values, 0.0)
    return dataclasses.replace(batch, values=values)


def _flow() -> st.SearchStrategy[Any]:
    return st.integers(0, 4).flatmap(lambda n: _fields(Flow, {"index": (n,), "earlier_px": (n, 2), "sigma_px": (n,)}))


def _fields(kind: type, shapes: dict[str, tuple[int, ...]]) -> st.SearchStrategy[Any]:
    hints = typing.get_type_hints(kind)
    names = [entry.name for entry in dataclasses.fields(kind)]
    return st.builds(kind, **{name: _value(hints[name], name, shapes.get(name, (3, 2))) for name in names})


def _value(hint: Any, name: str, shape: tuple[int, ...]) -> st.SearchStrategy[Any]:
    origin, arms = typing.get_origin(hint), typing.get_args(hint)
    if origin is np.ndarray:
        return _array(np.dtype(typing.get_args(arms[1])[0]), shape)
    if origin is tuple:
        if arms[-1] is Ellipsis:
            return st.lists(_value(arms[0], name, shape), max_size=3).map(tuple)
        return st.tuples(*(_value(arm, name, shape) for arm in arms))
    if origin is dict:
        return st.dictionaries(st.text(max_size=5), st.integers(-(2**53), 2**53), max_size=3)
    if origin in (types.UnionType, typing.Union):
        return st.none() | _value(arms[0], name, shape)
    if hint is Flow:
        return _flow()
    if dataclasses.is_dataclass(hint):
        return record_of(typing.cast(type, hint))
    if hint is Axis:
        return st.integers(0, 63).map(Axis)
    if hint is int:
        if name == "link":
            return st.integers(-(2**31), 2**31 - 1)
        return _NS if name.endswith("host_ns") else _INT64
    plain = {float: _FLOAT, bool: st.booleans(), str: st.text(max_size=20), bytes: st.binary(max_size=40)}
    return plain[hint] if hint in plain else st.sampled_from(list(hint))


def _array(dtype: np.dtype[Any], shape: tuple[int, ...]) -> st.SearchStrategy[Any]:
    if dtype.kind == "f":
        return arrays.arrays(dtype, shape, elements=_FLOAT)
    return arrays.arrays(dtype, shape)


def assert_equal(first: Any, other: Any) -> None:
    """Same class, same values, arrays bit for bit."""
    assert type(first) is type(other)
    if dataclasses.is_dataclass(first):
        for entry in dataclasses.fields(first):
            assert_equal(getattr(first, entry.name), getattr(other, entry.name))
    elif isinstance(first, np.ndarray):
        assert first.dtype == other.dtype
        assert first.shape == other.shape
        assert first.tobytes() == other.tobytes()
    elif isinstance(first, tuple):
        assert len(first) == len(other)
        for left, right in zip(first, other, strict=True):
            assert_equal(left, right)
    elif isinstance(first, float):
        assert np.float64(first).tobytes() == np.float64(other).tobytes()
    else:
        assert first == other
