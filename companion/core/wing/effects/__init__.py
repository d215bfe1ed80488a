"""The catalogue of named effects: one file each, by place of action, found by being here."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import pkgutil
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from companion.core.wing.effect import Effect
from companion.errors import ConfigError
from companion.params.airframe import Airframe, NamedEffect


@functools.cache
def catalogue() -> Mapping[str, type[Effect]]:
    """Every effect by its stable name, in alphabetical order."""
    kinds = [kind for module in pkgutil.walk_packages(__path__, f"{__name__}.") for kind in _effects_in(module.name)]
    return MappingProxyType({kind.name: kind for kind in sorted(kinds, key=lambda kind: kind.name)})


def make_effects(named: Iterable[NamedEffect]) -> tuple[Effect, ...]:
    """Build the effects that an airframe file lists.

    Raises
    ------
    ConfigError
        For a name that is not in the catalogue, or a parameter that the effect does not have.
    """
    return tuple(make_effect(entry) for entry in named)


def make_effect(named: NamedEffect) -> Effect:
    """Build one effect; errors as :func:`make_effects`."""
    kinds_by_name = catalogue()
    if named.name not in kinds_by_name:
        raise ConfigError(f"no effect '{named.name}'; known: {', '.join(kinds_by_name)}")
    return kinds_by_name[named.name].from_values(named.parameters)


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


def _effects_in(module_name: str) -> list[type[Effect]]:
    module = importlib.import_module(module_name)
    members = [entry for entry in vars(module).values() if isinstance(entry, type) and issubclass(entry, Effect)]
    return [entry for entry in members if entry.__module__ == module.__name__]
