"""Records as JSON and back, with their JSON schema: one codec for every dataclass, built from its type hints.

Exact: floats are written with their shortest repr, non-finite ones as the strings ``NaN``, ``Infinity`` and
``-Infinity`` (JSON has no others), arrays as nested lists in their declared dtype, empty ones as ``{"shape": [...]}``.
"""

from __future__ import annotations

import base64
import dataclasses
import enum
import json
import math
import types
import typing
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class Codec:
    """How one type becomes plain JSON values, how it comes back, and the JSON schema of the plain form."""

    encode: Callable[[Any], Any]
    decode: Callable[[Any], Any]
    schema: dict[str, Any]


@cache
def codec_of(kind: Any) -> Codec:
    """Give the codec of a type hint; raise TypeError for a type that no record uses."""
    if dataclasses.is_dataclass(kind):
        return _of_dataclass(kind)
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        return _of_enum(kind)
    if kind in _SCALARS:
        return _SCALARS[kind]
    origin, arms = typing.get_origin(kind), typing.get_args(kind)
    if origin is np.ndarray:
        return _of_array(np.dtype(typing.get_args(arms[1])[0]))
    if origin is tuple:
        return _of_tuple(arms)
    if origin is dict:
        return _of_dict(arms[1])
    if origin in (types.UnionType, typing.Union) and types.NoneType in arms and len(arms) == 2:
        return _of_optional(codec_of(next(arm for arm in arms if arm is not types.NoneType)))
    raise TypeError(f"no JSON form for {kind!r}")


def plain_values(record: Any) -> Any:
    """A record as JSON values; numbers that are not finite stay numbers."""
    kind: Any = type(record)
    return codec_of(kind).encode(record)


def dumps(kind: type, record: Any) -> bytes:
    """Write a record as JSON."""
    plain = codec_of(kind).encode(record)
    try:
        return json.dumps(plain, allow_nan=False).encode()
    except ValueError:
        return json.dumps(_spelled(plain), allow_nan=False).encode()


def loads(kind: type, data: bytes) -> Any:
    """Give back what :func:`dumps` was given."""
    return codec_of(kind).decode(json.loads(data))


def _spelled(plain: Any) -> Any:
    """The same with non-finite numbers in words."""
    if isinstance(plain, dict):
        return {key: _spelled(value) for key, value in plain.items()}
    if isinstance(plain, list):
        return [_spelled(value) for value in plain]
    if isinstance(plain, float) and not math.isfinite(plain):
        return "NaN" if math.isnan(plain) else "Infinity" if plain > 0 else "-Infinity"
    return plain


_SCALARS = {
    int: Codec(int, int, {"type": "integer"}),
    float: Codec(float, float, {"type": "number"}),
    bool: Codec(bool, bool, {"type": "boolean"}),
    str: Codec(str, str, {"type": "string"}),
    bytes: Codec(
        lambda data: base64.b64encode(data).decode("ascii"),
        base64.b64decode,
        {"type": "string", "contentEncoding": "base64"},
    ),
}


def _of_enum(kind: type[enum.Enum]) -> Codec:
    integer = issubclass(kind, int)
    schema: dict[str, Any] = {"type": "integer" if integer else "string"}
    if not issubclass(kind, enum.Flag):
        schema["enum"] = [member.value for member in kind]
    return Codec(lambda member: member.value, kind, schema)


def _of_array(dtype: np.dtype[Any]) -> Codec:
    scalar = {"f": {"type": "number"}, "b": {"type": "boolean"}}.get(dtype.kind, {"type": "integer"})

    def encode(array: Any) -> Any:
        exact = np.asarray(array, dtype=dtype)
        return exact.tolist() if exact.size else {"shape": list(exact.shape)}

    def decode(plain: Any) -> Any:
        if isinstance(plain, dict):
            return np.zeros(plain["shape"], dtype=dtype)
        return np.array(plain, dtype=dtype)

    return Codec(encode, decode, {"type": "array", "items": {"anyOf": [scalar, {"type": "array"}]}})


def _of_tuple(arms: tuple[Any, ...]) -> Codec:
    if len(arms) == 2 and arms[1] is Ellipsis:
        item = codec_of(arms[0])
        return Codec(
            lambda values: [item.encode(value) for value in values],
            lambda plain: tuple(item.decode(value) for value in plain),
            {"type": "array", "items": item.schema},
        )
    items = [codec_of(arm) for arm in arms]
    return Codec(
        lambda values: [item.encode(value) for item, value in zip(items, values, strict=True)],
        lambda plain: tuple(item.decode(value) for item, value in zip(items, plain, strict=True)),
        {"type": "array", "items": items[0].schema},
    )


def _of_dict(kind: Any) -> Codec:
    item = codec_of(kind)
    return Codec(
        lambda table: {str(key): item.encode(value) for key, value in table.items()},
        lambda plain: {key: item.decode(value) for key, value in plain.items()},
        {"type": "object", "additionalProperties": item.schema},
    )


def _of_optional(item: Codec) -> Codec:
    return Codec(
        lambda value: None if value is None else item.encode(value),
        lambda plain: None if plain is None else item.decode(plain),
        {"anyOf": [item.schema, {"type": "null"}]},
    )


def _of_dataclass(kind: Any) -> Codec:
    hints = typing.get_type_hints(kind)
    fields = {entry.name: codec_of(hints[entry.name]) for entry in dataclasses.fields(kind)}
    encoders = [(name, codec.encode) for name, codec in fields.items()]

    def encode(record: Any) -> dict[str, Any]:
        return {name: encode_field(getattr(record, name)) for name, encode_field in encoders}

    def decode(plain: dict[str, Any]) -> Any:
        return kind(**{name: fields[name].decode(value) for name, value in plain.items() if name in fields})

    summary = (kind.__doc__ or "").strip().splitlines()[0]
    properties = {name: codec.schema for name, codec in fields.items()}
    return Codec(encode, decode, {"type": "object", "description": summary, "properties": properties})
