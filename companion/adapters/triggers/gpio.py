"""A GPIO line through libgpiod 2: the edge leaves with the call, at the planned instant of the trigger process.

The ``gpiod`` package is needed only where a line is wired: it is imported when the line is opened.
"""

from __future__ import annotations

import time

from companion.errors import DeviceError, import_extra
from companion.records import Shot, TriggerPlan

_WIDTH_NS = 500_000  # chosen: long enough for an optocoupler or a camera's input filter, and it is spun through


class GpioTrigger:
    """Implements :class:`companion.ports.Trigger` on one line of a GPIO chip.

    ``chip`` is a device such as ``/dev/gpiochip0`` and ``line`` an offset on it; ``active_low`` gives cameras a falling
    edge.

    Raises
    ------
    DeviceError
        ``gpiod`` is not installed, or as version 1; there is no such chip or line, or somebody else has it.
    """

    def __init__(self, chip: str, line: int, *, active_low: bool = False) -> None:
        gpiod = import_extra("gpiod", "GPIO triggers", "gpio", DeviceError)
        if not hasattr(gpiod, "request_lines"):
            version = getattr(gpiod, "__version__", "1")
            raise DeviceError(f"GPIO triggers need gpiod 2, this is {version}: pip install 'spanwise[gpio]'")
        settings = gpiod.LineSettings(
            direction=gpiod.line.Direction.OUTPUT, active_low=active_low, output_value=gpiod.line.Value.INACTIVE
        )
        try:
            self._request = gpiod.request_lines(chip, consumer="spanwise", config={line: settings})
        except (OSError, ValueError) as error:
            raise DeviceError(f"cannot take line {line} of {chip}: {error}") from error
        self._line = line
        self._on, self._off = gpiod.line.Value.ACTIVE, gpiod.line.Value.INACTIVE

    def fire(self, plan: TriggerPlan) -> Shot:
        """Raise the line now, hold it for half a millisecond, lower it; the stamp is the middle of the raising call."""
        try:
            before_ns = time.monotonic_ns()
            self._request.set_value(self._line, self._on)
            after_ns = time.monotonic_ns()
            while time.monotonic_ns() < after_ns + _WIDTH_NS:
                pass
            self._request.set_value(self._line, self._off)
        except OSError as error:
            raise DeviceError(f"GPIO line {self._line}: {error}") from error
        return Shot(plan.plan_id, plan.command_host_ns, (before_ns + after_ns) // 2)

    def close(self) -> None:
        """Release the line."""
        self._request.release()
