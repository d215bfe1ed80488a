"""Refuse in the command itself an airframe that the service's processes would refuse."""

from __future__ import annotations

from companion.adapters.mavlink.decode.source_map import build_mapping
from companion.core.pipeline_state import start
from companion.params.airframe import Airframe
from companion.params.settings import Settings


def check_airframe(airframe: Airframe, settings: Settings) -> None:
    """Do once what every process begins with: there a refusal would be a traceback, again and again.

    Raises
    ------
    ConfigError
        Sources of samples that cannot be told apart, or cameras that cannot measure along the orientation.
    """
    build_mapping(airframe)
    start(airframe, settings)
