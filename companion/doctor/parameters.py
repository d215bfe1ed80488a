"""Plausibility of the parameters that the vehicle reports."""

from __future__ import annotations

from collections.abc import Iterator

from companion.doctor.evidence import Evidence, Finding
from companion.params.vehicle import VEHICLE_PARAMETERS, implausible


def check_parameters(evidence: Evidence) -> Iterator[Finding]:
    """Every parameter whose value is outside the range in which the service believes it."""
    for name in sorted(VEHICLE_PARAMETERS.keys() & evidence.parameters.keys()):
        why = implausible(name, evidence.parameters[name])
        if why is not None:
            yield Finding.fix("parameter", f"{why}; correct it on the vehicle")
