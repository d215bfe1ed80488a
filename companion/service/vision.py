"""The vision process: cameras in, matches out. It may be slow or die; the inertial process goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from multiprocessing.synchronize import Event

from companion.core.pipeline import VisionState, vision_step
from companion.errors import DeviceError
from companion.ports import CameraPair, Clock, Recorder
from companion.records import Frame, ParameterChange, Record, TriggerPlan

_POLL_S = 0.05


def run(
    state: VisionState,
    cameras: CameraPair,
    clock: Clock,
    send: Callable[[Record], object],
    recorder: Recorder | None,
    stop: Event,
    told: Callable[[], Iterable[ParameterChange | TriggerPlan]] = tuple,
) -> None:
    """Match every pair as it comes until told to stop.

    ``recorder`` keeps the images where that is asked for; ``told`` gives what the inertial process has said since the
    last call: changed settings, and plans for cameras that run free.

    Raises
    ------
    DeviceError
        A camera failed, or its images have another size than the airframe says.
    """
    try:
        while not stop.is_set():
            frames = cameras.poll(_POLL_S)
            for word in told():
                vision_step(state, word, clock.now_ns())
            for frame in frames:
                _check_size(frame, state)
                if recorder is not None:
                    recorder.write(frame)
                for record in vision_step(state, frame, clock.now_ns()):
                    send(record)
    finally:
        cameras.close()


def _check_size(frame: Frame, state: VisionState) -> None:
    width, height = state.rig.camera(frame.side).lens.size_px
    if frame.image.shape != (height, width):
        rows, columns = frame.image.shape
        raise DeviceError(
            f"{frame.side.name.lower()} camera gives {columns}x{rows} images; "
            f"the airframe's calibration is for {width}x{height}"
        )
