"""DepthAI software trigger, the camera's end: words from the trigger process become pulses on the device's FSYNC line.

The device runs a script that waits for a message and pulls its own FSYNC pin; sensors in snapshot mode expose at that
edge. The message is sent by a thread of the process that holds the device.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Sequence
from typing import Any

from companion.adapters.triggers.oak import WORD, SoftLine
from companion.errors import DeviceError

_WAIT_S = 0.1  # chosen: how long the end of the process may go unnoticed
_SCRIPT = """
import time
import GPIO

fire, *joined = {pins}
GPIO.setup(fire, GPIO.OUT, GPIO.PULL_DOWN)
GPIO.write(fire, False)
for pin in joined:
    GPIO.setup(pin, GPIO.OUT)
    GPIO.write(pin, True)
while True:
    node.inputs['fire'].get()
    GPIO.write(fire, True)
    time.sleep(0.001)
    GPIO.write(fire, False)
"""


def fire_script(line: SoftLine) -> str:
    """Script that the device runs: Python with the device's own ``GPIO`` module and ``node``."""
    return _SCRIPT.format(pins=line.pins)


def fire_queue(pipeline: Any, line: SoftLine, dai: Any) -> Any:
    """Put the script on a device's pipeline; a message sent to the queue that is returned fires its sensors."""
    node = pipeline.create(dai.node.Script)
    node.setProcessor(dai.ProcessorType.LEON_CSS)  # the processor that has the pins
    node.setScript(fire_script(line))
    return node.inputs["fire"].createInputQueue(maxSize=1, blocking=False)


class SoftTriggerReceiver:
    """Receives the trigger process's messages and fires every device's queue, left first.

    ``queues`` are the input queues of the devices, ``dai`` is the DepthAI module.

    Raises
    ------
    DeviceError
        Another service listens to a line of that name.
    """

    def __init__(self, line: SoftLine, queues: Sequence[Any], dai: Any) -> None:
        self._queues, self._dai = tuple(queues), dai
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.settimeout(_WAIT_S)
        try:
            self._socket.bind(line.address)
        except OSError as error:
            self._socket.close()
            raise DeviceError(f"another service fires DepthAI cameras as '{line.name}': {error}") from error
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="oak-trigger", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Fall silent."""
        self._closing.set()
        self._thread.join()
        self._socket.close()

    def _listen(self) -> None:
        while not self._closing.is_set():
            try:
                word = self._socket.recv(WORD.size + 1)
            except TimeoutError:
                continue
            if len(word) == WORD.size and not self._fired():
                return

    def _fired(self) -> bool:
        """Send to every device; False when one is gone: then whoever polls its frames hears of it."""
        try:
            for queue in self._queues:
                queue.send(self._dai.Buffer())
        except (RuntimeError, self._dai.MessageQueue.QueueException):
            return False
        return True
