"""Starts MAVProxy as ``mavproxy.py`` does, but without a screen: a graph prints its values in place of a window.

Everything else is MAVProxy's own: link, parameters, the graph module that reads messages and evaluates the expressions.
"""

from __future__ import annotations

import runpy
from typing import Any

from MAVProxy.modules.lib import live_graph


class PrintedGraph:
    """Takes what the graph's window would draw."""

    def __init__(self, fields: list[str], **_: Any) -> None:
        self._fields = fields

    def add_values(self, values: list[float | None]) -> None:
        print("graphed", dict(zip(self._fields, values, strict=True)), flush=True)

    def is_alive(self) -> bool:
        return True

    def close(self) -> None:
        """There is no window."""


if __name__ == "__main__":
    live_graph.LiveGraph = PrintedGraph
    runpy.run_module("MAVProxy.mavproxy", run_name="__main__")
