"""DepthAI's software trigger without a device: our words and our script, on the library's own queues and host nodes.

The library refuses device scripts on a pipeline without a device, so that a host node runs the same text: its ``GPIO``
is a stand-in whose rising edges make frames. Sockets, queues, messages and frames are the real ones.
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.adapters.cameras.oak import OakTiming, QueuePair
from companion.adapters.cameras.oak_soft import SoftTriggerReceiver, fire_queue, fire_script
from companion.adapters.triggers.oak import OakTrigger, SoftLine
from companion.core.stereo.pairing import FramePairer
from companion.errors import DeviceError
from companion.records import Firing, Frame, TriggerPlan

dai = pytest.importorskip("depthai")
PATIENCE_S = 20.0


def _line(name: str) -> SoftLine:
    return SoftLine(pins=(41, 38), name=f"spanwise-test-{name}-{time.monotonic_ns()}")


def _plan(plan_id: int) -> TriggerPlan:
    now_ns = time.monotonic_ns()
    return TriggerPlan(plan_id, Firing.PEAK, now_ns, now_ns, 0, 0.0, now_ns + 10**9, now_ns)


class Pins:
    """The device's GPIO module: remembers what was done and calls back at rising edges."""

    OUT, PULL_DOWN = "out", "down"

    def __init__(self, rising: Callable[[int], None]) -> None:
        self.level: dict[int, bool] = {}
        self.outputs: list[int] = []
        self._rising = rising

    def setup(self, pin: int, direction: str, pull: str = "") -> None:
        assert direction == self.OUT
        self.outputs.append(pin)

    def write(self, pin: int, value: bool) -> None:
        assert pin in self.outputs
        if value and not self.level.get(pin, False):
            self._rising(pin)
        self.level[pin] = bool(value)


# ------------------------------------------------------------------------------------------------ the script


def test_the_script_pulls_the_first_pin_once_for_every_message_and_holds_the_others() -> None:
    edges: list[tuple[int, int]] = []
    messages = iter(range(3))
    taken: list[int] = []

    def get() -> int:
        taken.append(next(messages))  # StopIteration ends the endless script
        return taken[-1]

    pins = Pins(lambda pin: edges.append((pin, len(taken))))
    node = SimpleNamespace(inputs={"fire": SimpleNamespace(get=get)})
    with _module("GPIO", pins), pytest.raises(StopIteration):
        exec(fire_script(SoftLine(pins=(41, 38))), {"node": node})
    assert edges == [(38, 0), (41, 1), (41, 2), (41, 3)]
    assert pins.level == {41: False, 38: True}


@contextlib.contextmanager
def _module(name: str, module: Any) -> Iterator[None]:
    before = sys.modules.get(name)
    sys.modules[name] = module
    try:
        yield
    finally:
        sys.modules.pop(name)
        if before is not None:
            sys.modules[name] = before


def test_the_script_goes_onto_the_processor_that_has_the_pins() -> None:
    asked: dict[str, Any] = {}
    fire = SimpleNamespace(createInputQueue=lambda **how: ("queue", how))
    script = SimpleNamespace(
        setProcessor=lambda which: asked.update(processor=which),
        setScript=lambda text: asked.update(script=text),
        inputs={"fire": fire},
    )

    def create(kind: Any) -> Any:
        asked["kind"] = kind
        return script

    line = SoftLine(pins=(40,))
    queue, how = fire_queue(SimpleNamespace(create=create), line, dai)
    assert queue == "queue"
    assert how["blocking"] is False
    assert asked == {
        "kind": dai.node.Script, "processor": dai.ProcessorType.LEON_CSS, "script": fire_script(line)
    }  # fmt: skip


# ------------------------------------------------------------------------------------------------ word to frame


class HostDevice(dai.node.ThreadedHostNode):  # type: ignore[misc, name-defined]
    """Runs our script on the host; both sensors expose at its edges. The right one's images are brighter."""

    def __init__(self) -> None:
        super().__init__()
        self.fire = self.createInput()
        self.left, self.right = self.createOutput(), self.createOutput()
        self._shot = 0

    def run(self) -> None:
        node = SimpleNamespace(inputs={"fire": self.fire})
        with _module("GPIO", Pins(self._edge)), contextlib.suppress(dai.MessageQueue.QueueException):
            exec(fire_script(SoftLine(pins=(41, 38))), {"node": node})

    def _edge(self, pin: int) -> None:
        if pin != 41:
            return
        now = dai.Clock.now()
        for output, grey in ((self.left, 10), (self.right, 110)):
            image = dai.ImgFrame()
            image.setCvFrame(np.full((4, 6), grey + self._shot, np.uint8), dai.ImgFrame.Type.GRAY8)
            image.setSequenceNum(self._shot)
            image.setTimestamp(now)
            output.send(image)
        self._shot += 1


class HostPair(QueuePair):
    """:class:`OakPair` as with a device, with the host node in its place."""

    def __init__(self, line: SoftLine) -> None:
        super().__init__(OakTiming(external=True))
        pipeline = dai.Pipeline(createImplicitDevice=False)
        device = pipeline.create(HostDevice)
        self._pipelines["host"] = pipeline
        self._queues = [out.createOutputQueue(maxSize=8, blocking=False) for out in (device.left, device.right)]
        fire = device.fire.createInputQueue(maxSize=1, blocking=False)
        self._start()
        self._receiver = SoftTriggerReceiver(line, [fire], dai)

    def close(self) -> None:
        self._receiver.close()
        super().close()
        self._pipelines["host"].wait()  # a node's thread must not outlive the interpreter


@pytest.mark.slow
def test_a_shot_becomes_a_pair_whose_exposure_follows_it() -> None:
    """Trigger process's end to paired frames; every shot gives its pair, in order, none without a shot."""
    line = _line("frames")
    pair, trigger = HostPair(line), OakTrigger(line)
    pairer, made, shots = FramePairer(), [], []
    try:
        assert pair.poll(0.2) == []
        for plan_id in range(4):
            shots.append(trigger.fire(_plan(plan_id)))
            for frame in _frames(pair, 2):
                made += pairer.add(frame)[0]
    finally:
        trigger.close()
        pair.close()
    assert [shot.plan_id for shot in shots] == [0, 1, 2, 3]
    assert (
        [frame_pair.left.sequence for frame_pair in made]
        == [frame_pair.right.sequence for frame_pair in made]
        == [0, 1, 2, 3]
    )
    assert [int(frame_pair.right.image[0, 0]) - int(frame_pair.left.image[0, 0]) for frame_pair in made] == [100] * 4
    latency_s = [
        1e-9 * (frame_pair.left.mid_exposure_ns - shot.fired_host_ns)
        for frame_pair, shot in zip(made, shots, strict=True)
    ]
    assert all(0.0 < late < PATIENCE_S for late in latency_s)


def _frames(pair: QueuePair, count: int) -> list[Frame]:
    frames: list[Frame] = []
    until = time.monotonic() + PATIENCE_S
    while len(frames) < count and time.monotonic() < until:
        frames += pair.poll(0.1)
    assert len(frames) == count
    return frames


def test_without_a_camera_that_listens_the_shot_fails_and_says_so() -> None:
    trigger = OakTrigger(_line("nobody"))
    with pytest.raises(DeviceError, match="no DepthAI camera listens"):
        trigger.fire(_plan(1))
    trigger.close()


def test_two_services_cannot_hold_one_line_and_a_closed_one_is_free_again() -> None:
    line = _line("twice")
    first = SoftTriggerReceiver(line, [], dai)
    with pytest.raises(DeviceError, match=line.name):
        SoftTriggerReceiver(line, [], dai)
    first.close()
    SoftTriggerReceiver(line, [], dai).close()


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("lost", [RuntimeError, dai.MessageQueue.QueueException])
def test_what_is_no_word_fires_nothing_and_a_lost_device_ends_the_listening(lost: type[Exception]) -> None:
    line, heard = _line("words"), []

    def send(message: Any) -> None:
        heard.append(message)
        if len(heard) == 2:
            raise lost("device is gone")

    ear, trigger = SoftTriggerReceiver(line, [SimpleNamespace(send=send)], dai), OakTrigger(line)
    trigger._socket.sendto(b"too short", line.address)
    trigger._socket.sendto(b"9 bytes..", line.address)
    for plan_id in (1, 2, 3):
        trigger.fire(_plan(plan_id))
    until = time.monotonic() + PATIENCE_S
    while ear._thread.is_alive() and time.monotonic() < until:
        time.sleep(0.01)
    assert len(heard) == 2
    assert all(isinstance(message, dai.Buffer) for message in heard)
    trigger.close()
    ear.close()
