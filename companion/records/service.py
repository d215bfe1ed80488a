"""Refusals, sentences for the operator, and the health of the service."""

from __future__ import annotations

from dataclasses import dataclass, field

from companion.records.vocabulary import Health, Reject


@dataclass(frozen=True, slots=True)
class Rejected:
    """A refusal, with what it befell."""

    reason: Reject
    what: str
    at_host_ns: int
    count: int = 1


OVERLOADED = "this machine cannot keep up"
"""How the notice of an overload begins: what judges a recording knows it by this."""


@dataclass(frozen=True, slots=True)
class Notice:
    """A sentence for the operator; ``severity`` as in MAV_SEVERITY (3 error, 4 warning, 6 info)."""

    severity: int
    text: str
    at_host_ns: int


@dataclass(frozen=True, slots=True)
class ServiceStatus:
    """The service's health and counters, once a second."""

    at_host_ns: int
    health: Health
    reason: str
    counters: dict[str, int] = field(default_factory=dict)
