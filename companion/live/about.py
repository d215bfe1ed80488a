"""Facts that the page needs once: the airframe as far as it is drawn, and the table of parameters."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

from companion.adapters.recordings.mcap.writer import software_version
from companion.params.airframe import Airframe, Camera, Mode
from companion.params.settings import tunables
from companion.records import Reject


class ViewKind(StrEnum):
    """Kind of what a live view shows; the page says it beside its dot."""

    LIVE = "live"
    DEMO = "demo"
    REPLAY = "replay"


ENDINGS: dict[ViewKind, str] = {
    ViewKind.LIVE: "the service was stopped",
    ViewKind.DEMO: "the demo flight has ended",
    ViewKind.REPLAY: "the recording has ended",
}
"""Sentences that say that nothing more comes."""
INTERRUPTIONS: dict[ViewKind, str] = {
    ViewKind.LIVE: "the service was stopped",
    ViewKind.DEMO: "the demo was stopped",
    ViewKind.REPLAY: "the replay was stopped",
}
"""The same, before the end."""


def facts(airframe: Airframe, title: str) -> dict[str, Any]:
    """Facts of an airframe, as JSON."""
    wing = airframe.wing
    return {
        "title": title,
        "software": software_version(),
        "airframe": airframe.name,
        "semispan_m": wing.semispan_m,
        "orientation": airframe.orientation,
        "modes": [_mode(wing.symmetric), _mode(wing.antisymmetric)],
        "cameras": [_camera(airframe.left_camera), _camera(airframe.right_camera)],
        "reasons": [str(reason) for reason in Reject],
        "sensors": {
            name: {"rate_hz": sensor.rate_hz, "axes": sensor.sends, "clock": str(sensor.source.clock)}
            for name, sensor in (("root", airframe.root), ("left", airframe.left), ("right", airframe.right))
        },
    }


def parameter_table(values: dict[str, float]) -> list[dict[str, Any]]:
    """Rows of the parameters with the values in force, by MAVLink name."""
    return [
        {
            "name": row.name,
            "value": values[row.name],
            "unit": row.unit,
            "minimum": row.minimum,
            "maximum": row.maximum,
            "default": row.default,
            "text": row.doc,
            "live": row.live,
            "integer": row.integer,
            "choices": list(row.choices),
        }
        for row in tunables()
    ]


def _mode(mode: Mode) -> dict[str, float]:
    return {"frequency_hz": mode.frequency_hz.value, "slope_factor_radpm": mode.slope_factor_radpm.value}


def _camera(camera: Camera | None) -> dict[str, Any] | None:
    if camera is None:
        return None
    return {
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "focal_px": camera.focal_px.value,
        "position_m": list(camera.position_m),
    }
