"""Airframe files: TOML in and out of :mod:`companion.params.airframe`, with errors that name the key."""

from __future__ import annotations

import dataclasses
import enum
import types
import typing
from collections.abc import Mapping
from typing import Any

from companion.errors import ConfigError, UnknownAirframe
from companion.params.airframe import Airframe, Uncertain
from companion.params.plausible import problems
from companion.params.shipped import read_shipped, shipped_names
from companion.params.toml import LARGEST, parse_toml, quoted


def shipped_airframes() -> list[str]:
    """Names of the airframes that travel with Spanwise."""
    return shipped_names("airframes")


def load_airframe(name_or_path: str) -> Airframe:
    """Read an airframe by name, or from the path of a ``.toml`` file.

    Raises
    ------
    UnknownAirframe
        No such name or file.
    ConfigError
        A missing, unknown or ill-typed key, or a value that cannot be; the message names file, key, value and range.
    """
    shipped_file = read_shipped("airframes", name_or_path)
    if shipped_file is None:
        raise UnknownAirframe(name_or_path, shipped_airframes())
    return parse_airframe(*shipped_file)


def parse_airframe(text: str, origin: str) -> Airframe:
    """Parse the text of an airframe file; ``origin`` is named in errors.

    Raises
    ------
    ConfigError
        As :func:`load_airframe`; and for what no aircraft can be, see :mod:`companion.params.plausible`.
    """
    airframe: Airframe = _build(Airframe, parse_toml(text, origin), origin, "")
    for problem in problems(airframe):
        raise ConfigError(f"{origin}: {problem}")
    return airframe


def dump_airframe(airframe: Airframe) -> str:
    """Write an airframe as TOML; :func:`parse_airframe` gives it back equal."""
    return "\n".join(_emit(airframe, "")).lstrip("\n") + "\n"


# ------------------------------------------------------------------------------------------------ reading


def _build(kind: Any, value: Any, origin: str, where: str) -> Any:
    if kind is Uncertain:
        return _uncertain(value, origin, where)
    if dataclasses.is_dataclass(kind):
        return _record(kind, value, origin, where)
    shape = typing.get_origin(kind)
    if shape in (types.UnionType, typing.Union):
        (inner,) = [arm for arm in typing.get_args(kind) if arm is not type(None)]
        return _build(inner, value, origin, where)
    if shape is tuple:
        return _tuple(kind, value, origin, where)
    if shape is dict:
        _expect(isinstance(value, Mapping), origin, where, "a table", value)
        return {key: _number(entry, origin, f"{where}.{key}") for key, entry in value.items()}
    return _scalar(kind, value, origin, where)


def _record(kind: Any, value: Any, origin: str, where: str) -> Any:
    _expect(isinstance(value, Mapping), origin, where, "a table", value)
    hints = typing.get_type_hints(kind)
    fields = {entry.name: entry for entry in dataclasses.fields(kind)}
    for key in value:
        if key not in fields:
            raise ConfigError(f"{origin}: unknown key '{_join(where, key)}'; known here: {', '.join(fields)}")
    for key, entry in fields.items():
        required = entry.default is dataclasses.MISSING and entry.default_factory is dataclasses.MISSING
        if required and key not in value:
            raise ConfigError(f"{origin}: key '{_join(where, key)}' is missing")
    return kind(**{key: _build(hints[key], entry, origin, _join(where, key)) for key, entry in value.items()})


def _uncertain(value: Any, origin: str, where: str) -> Uncertain:
    if isinstance(value, Mapping):
        extra = set(value) - {"value", "sigma"}
        if extra or "value" not in value:
            raise ConfigError(f"{origin}: '{where}' takes {{ value = ..., sigma = ... }}")
        sigma = _number(value.get("sigma", 0.0), origin, f"{where}.sigma")
        _expect(sigma >= 0, origin, f"{where}.sigma", "a sigma >= 0", sigma)
        return Uncertain(_number(value["value"], origin, f"{where}.value"), sigma)
    return Uncertain(_number(value, origin, where))


def _tuple(kind: Any, value: Any, origin: str, where: str) -> tuple[Any, ...]:
    _expect(isinstance(value, list), origin, where, "an array", value)
    arms = typing.get_args(kind)
    if len(arms) == 2 and arms[1] is Ellipsis:
        arms = (arms[0],) * len(value)
    _expect(len(value) == len(arms), origin, where, f"{len(arms)} entries", value)
    return tuple(
        _build(arm, entry, origin, f"{where}[{i}]") for i, (arm, entry) in enumerate(zip(arms, value, strict=True))
    )


def _scalar(kind: Any, value: Any, origin: str, where: str) -> Any:
    if kind is float:
        return _number(value, origin, where)
    if kind is int:
        good = isinstance(value, int) and not isinstance(value, bool) and abs(value) <= LARGEST
        _expect(good, origin, where, "a whole number", value)
        return value
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        allowed = [str(member.value) for member in kind]
        _expect(str(value) in allowed, origin, where, f"one of {', '.join(allowed)}", value)
        return kind(value)
    _expect(isinstance(value, kind), origin, where, f"a {kind.__name__}", value)
    return value


def _number(value: Any, origin: str, where: str) -> float:
    good = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST
    _expect(good, origin, where, "a finite number", value)
    return float(value)


def _expect(good: bool, origin: str, where: str, expected: str, value: Any) -> None:
    if not good:
        raise ConfigError(f"{origin}: '{where}' must be {expected}, not {value!r:.80}")


def _join(where: str, key: str) -> str:
    return f"{where}.{key}" if where else key


# ------------------------------------------------------------------------------------------------ writing


def _emit(record: Any, where: str) -> list[str]:
    lines: list[str] = [f"\n[{where}]"] if where else []
    tables: list[str] = []
    for entry in dataclasses.fields(record):
        value = getattr(record, entry.name)
        if value is None:
            continue
        path = _join(where, entry.name)
        if isinstance(value, tuple) and value and dataclasses.is_dataclass(value[0]):
            for item in value:
                tables += [f"\n[[{path}]]", *_emit(item, path)[1:]]
        elif dataclasses.is_dataclass(value) and not isinstance(value, Uncertain):
            tables += _emit(value, path)
        else:
            lines.append(f"{entry.name} = {_literal(value)}")
    return lines + tables


def _literal(value: Any) -> str:
    if isinstance(value, Uncertain):
        number, sigma = float(value.value), float(value.sigma)  # numpy's own floats do not print as numbers
        return f"{{ value = {number!r}, sigma = {sigma!r} }}" if sigma else repr(number)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_literal(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, tuple):
        return "[" + ", ".join(_literal(entry) for entry in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return quoted(str(value))
    return repr(value)
