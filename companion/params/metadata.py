"""The settings table for ground stations: ``apm.pdef.xml`` (MAVProxy, Mission Planner) and component metadata (JSON).

The XML has the shape that MAVProxy's ``param help`` reads: ``vehicles`` with names "Vehicle:NAME", and ``libraries``,
one for each prefix and none empty; the first prefix stands for the vehicle.
The JSON follows the MAVLink component metadata service, parameter metadata version 1.
"""

from __future__ import annotations

import json
import zlib
from typing import Any
from xml.etree import ElementTree

from companion.params.settings import Tunable, tunables

GENERAL_FILE, PARAMETER_FILE, PDEF_FILE = "/general.json", "/parameter.json", "/apm.pdef.xml"
_VEHICLE = "Spanwise"
_PARAMETER_TYPE = 1  # component information's COMP_METADATA_TYPE_PARAMETER (convention)
_GROUPS = {"SW": "Identity", "TRK": "Tracking", "TRG": "Triggering", "RNG": "Ranging", "OUT": "Outputs", "IMU": "Rates"}


def apm_pdef_xml() -> str:
    """The table as ArduPilot's parameter definition file (MAVProxy: ``param set_xml_filepath``)."""
    root = ElementTree.Element("paramfile")
    vehicles, libraries = ElementTree.SubElement(root, "vehicles"), ElementTree.SubElement(root, "libraries")
    groups: dict[str, list[Tunable]] = {}
    for row in tunables():
        groups.setdefault(row.name.partition("_")[0], []).append(row)
    for number, (prefix, rows) in enumerate(groups.items()):
        place, name, before = (libraries, f"{prefix}_", "") if number else (vehicles, _VEHICLE, f"{_VEHICLE}:")
        group = ElementTree.SubElement(place, "parameters", name=name)
        for row in rows:
            _xml_row(group, row, before)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _xml_row(parent: ElementTree.Element, row: Tunable, vehicle: str) -> None:
    title = row.doc.split(";")[0].split(" (")[0]
    entry = ElementTree.SubElement(
        parent, "param", humanName=title, name=f"{vehicle}{row.name}", documentation=row.doc, user="Standard"
    )
    if row.choices:
        values = ElementTree.SubElement(entry, "values")
        for code, choice in enumerate(row.choices):
            ElementTree.SubElement(values, "value", code=str(code)).text = choice
    fields = {"Range": f"{row.minimum:g} {row.maximum:g}", "Units": row.unit, "Default": f"{row.default:g}"}
    if not row.live:
        fields["RebootRequired"] = "True"
    for name, text in fields.items():
        if text:
            ElementTree.SubElement(entry, "field", name=name).text = text


def parameter_json() -> str:
    """Parameter metadata of the component metadata service."""
    return json.dumps({"version": 1, "parameters": [_json_row(row) for row in tunables()]}, separators=(",", ":"))


def _json_row(row: Tunable) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "name": row.name,
        "type": "Float",
        "group": _GROUPS.get(row.name.split("_")[0], "Other"),
        "category": "Standard",
        "shortDesc": row.doc,
        "units": row.unit,
        "min": row.minimum,
        "max": row.maximum,
        "default": row.default,
        "decimalPlaces": 0 if row.integer else 4,
        "rebootRequired": not row.live,
    }
    if row.choices:
        entry["values"] = [{"value": code, "description": choice} for code, choice in enumerate(row.choices)]
    return entry


def general_json(component_id: int) -> str:
    """The root of the component metadata: who we are, and where the parameter metadata lies."""
    document = {
        "version": 1,
        "vendorName": "Spanwise",
        "modelName": "Spanwise companion",
        "metadataTypes": [
            {
                "type": _PARAMETER_TYPE,
                "uri": metadata_uri(component_id, PARAMETER_FILE),
                "fileCrc": mavlink_crc32(parameter_json().encode()),
            }
        ],
    }
    return json.dumps(document, separators=(",", ":"))


def metadata_uri(component_id: int, path: str) -> str:
    """A file of ours in MAVLink FTP's spelling."""
    return f"mftp://[;comp={component_id}]{path}"


def metadata_files(component_id: int) -> dict[str, bytes]:
    """Every file that is served, by path."""
    return {
        GENERAL_FILE: general_json(component_id).encode(),
        PARAMETER_FILE: parameter_json().encode(),
        PDEF_FILE: apm_pdef_xml().encode(),
    }


def mavlink_crc32(data: bytes) -> int:
    """CRC-32 as MAVLink FTP computes it: the polynomial of zlib, started at 0 and not inverted at the end."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF
