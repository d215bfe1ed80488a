"""The layout for Foxglove and Lichtblick names topics, message paths and panels that exist."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.adapters.recordings.mcap.channels import CAMERA_TOPICS, CHANNELS, IMAGE_SCHEMA
from companion.adapters.recordings.mcap.messages import form_of, image_form

LAYOUT = Path(__file__).resolve().parents[2] / "config" / "live" / "spanwise.json"
PATH = re.compile(r"(/[\w/]+)((?:\.\w+)*)")


def layout() -> dict[str, Any]:
    return dict(json.loads(LAYOUT.read_text()))


def paths() -> Iterator[tuple[str, str]]:
    """Panel and message path of everything that is drawn."""
    for panel, config in layout()["configById"].items():
        for entry in config.get("paths", []):
            yield panel, entry["value"]
        if "topicPath" in config:
            yield panel, config["topicPath"]


def schemas() -> dict[str, dict[str, Any]]:
    """JSON schemas by topic, as they are published."""
    forms = {channel.topic: form_of(channel) for channel in CHANNELS.values()}
    return {topic: json.loads(form.schema) for topic, form in forms.items() if form.schema_encoding == "jsonschema"}


def type_at(schema: dict[str, Any], fields: list[str]) -> Any:
    """Type of the value to which the field names lead."""
    for field in fields:
        assert field in schema["properties"], f"{field} is not among {sorted(schema['properties'])}"
        schema = schema["properties"][field]
    return schema.get("type")


@pytest.mark.parametrize(("panel", "path"), sorted(paths()))
def test_a_message_path_leads_to_what_its_panel_can_draw(panel: str, path: str) -> None:
    match = PATH.fullmatch(path)
    assert match is not None, path
    topic, fields = match[1], [name for name in match[2].split(".") if name]
    assert topic in schemas(), f"{panel}: nothing is published as {topic}"
    kind = type_at(schemas()[topic], fields)
    wanted = ("number", "integer") if panel.startswith("Plot!") else ("object",)
    kinds = kind if isinstance(kind, list) else [kind]
    assert set(kinds) - {"null"} <= set(wanted), f"{panel}: {path} is {kind}"


def test_a_wrong_field_would_be_seen() -> None:
    with pytest.raises(AssertionError, match="amplitude_mm is not among"):
        type_at(schemas()["/wing/mode"], ["symmetric", "amplitude_mm"])


def test_the_images_panels_show_both_cameras_in_the_form_that_they_read() -> None:
    shown = [config["imageMode"]["imageTopic"] for config in layout()["configById"].values() if "imageMode" in config]
    assert sorted(shown) == sorted(CAMERA_TOPICS)
    assert image_form().schema_name == IMAGE_SCHEMA == "foxglove.CompressedImage"


def test_every_panel_is_placed_once_and_every_place_has_its_panel() -> None:
    def placed(node: Any) -> Iterator[str]:
        if isinstance(node, str):
            yield node
        else:
            yield from placed(node["first"])
            yield from placed(node["second"])

    assert sorted(placed(layout()["layout"])) == sorted(layout()["configById"])
