"""The catalogue of named effects: one file each, by place of action, found by being here."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import pkgutil
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from companion.core.wing.effect import Effect, Group
from companion.errors import ConfigError
from companion.params.airframe import Airframe, NamedEffect

_MOST_SIGMAS = 1e6  # chosen: an instant of 20 s prior sigma reaches over the longest recording; sums stay finite


@functools.cache
def catalogue() -> Mapping[str, type[Effect]]:
    """Every effect by its stable name, in alphabetical order.

    Raises
    ------
    ConfigError
        For a class without a name, a group or declared parameters, or a name that another class has already.
    """
    kinds: dict[str, type[Effect]] = {}
    for module in pkgutil.walk_packages(__path__, f"{__name__}."):
        for kind in _effects_in(module.name):
            _check(kind)
            if kind.name in kinds:
                raise ConfigError(f"{_place(kind)}: {_place(kinds[kind.name])} is named '{kind.name}' already")
            kinds[kind.name] = kind
    return MappingProxyType(dict(sorted(kinds.items())))


def make_effects(named: Iterable[NamedEffect]) -> tuple[Effect, ...]:
    """Build the effects that an airframe file lists.

    Raises
    ------
    ConfigError
        For a name that is not in the catalogue, a parameter that the effect does not have, or a value that nothing has.
    """
    return tuple(make_effect(entry) for entry in named)


def make_effect(named: NamedEffect) -> Effect:
    """Build one effect; errors as :func:`make_effects`."""
    kinds_by_name = catalogue()
    if named.name not in kinds_by_name:
        raise ConfigError(f"no effect '{named.name}'; known: {', '.join(kinds_by_name)}")
    effect = kinds_by_name[named.name].from_values(named.parameters)
    for entry in effect.parameters():
        value = named.parameters.get(entry.name, entry.default)
        unit = f" {entry.unit}" if entry.unit else ""
        if not (value > entry.above or value == entry.default):
            raise ConfigError(
                f"effect '{named.name}': {entry.name} is {value:g}{unit}, and must be above {entry.above:g}"
            )
        if abs(value - entry.default) > _MOST_SIGMAS * entry.sigma:
            limit = f"{_MOST_SIGMAS * entry.sigma:g}{unit} from {entry.default:g}"
            raise ConfigError(f"effect '{named.name}': {entry.name} is {value:g}{unit}, and must be within {limit}")
    return effect


def apply_to_airframe(airframe: Airframe) -> Airframe:
    """The airframe with as many of its named effects as possible turned into values.

    The simulator takes effects as they are. Tracker, trigger and ranging know the airframe alone: for them an effect
    becomes airframe values where it can; what cannot (friction, a nonlinear sensor) stays in the list. Errors as
    :func:`make_effects`.
    """
    remaining: list[NamedEffect] = []
    for named in airframe.effects:
        changed = make_effect(named).apply_to_airframe(airframe)
        if changed is None:
            remaining.append(named)
        else:
            airframe = changed
    return dataclasses.replace(airframe, effects=tuple(remaining))


def _check(kind: type[Effect]) -> None:
    """Raise :class:`ConfigError` where a class does not declare what every effect declares."""
    if not isinstance(getattr(kind, "name", None), str):
        raise ConfigError(f'{_place(kind)} has no name: it needs `name: ClassVar[str] = "..."`')
    if not isinstance(getattr(kind, "group", None), Group):
        raise ConfigError(f"{_place(kind)} has no group: it needs `group: ClassVar[Group] = Group....`")
    undeclared = [entry.name for entry in dataclasses.fields(kind) if "unit" not in entry.metadata]
    if undeclared:
        raise ConfigError(f"{_place(kind)}: declare '{undeclared[0]}' with parameter(unit, sigma, doc)")
    if not dataclasses.fields(kind):
        raise ConfigError(f"{_place(kind)} has no parameter: it needs @dataclass and a field by parameter()")


def _place(kind: type[Effect]) -> str:
    """Class and file of an effect."""
    return f"effect {kind.__name__} in {kind.__module__.removeprefix(f'{__name__}.').replace('.', '/')}.py"


def _effects_in(module_name: str) -> list[type[Effect]]:
    module = importlib.import_module(module_name)
    members = [entry for entry in vars(module).values() if isinstance(entry, type) and issubclass(entry, Effect)]
    return [entry for entry in members if entry.__module__ == module.__name__]
