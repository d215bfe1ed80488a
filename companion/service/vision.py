"""The vision process: cameras in, matches out. It may be slow or die; the inertial process goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from companion.core.pipeline import VisionState, vision_step
from companion.errors import DeviceError
from companion.lifetime import StopFlag
from companion.ports import CameraPair, Clock, Recorder
from companion.records import ClockName, Frame, MatchSet, ParameterChange, Record, Reject, Rejected, TriggerPlan
from companion.service.pace import Overload, VisionPace

_POLL_S = 0.05  # chosen: settings and the end are seen within it, frames at once


def run(
    state: VisionState,
    cameras: CameraPair,
    clock: Clock,
    send: Callable[[Record | Overload], object],
    recorder: Recorder | None,
    stop: StopFlag,
    updates: Callable[[], Iterable[ParameterChange | TriggerPlan]] = tuple,
) -> None:
    """Match every pair as it comes until told to stop.

    ``recorder`` keeps the images where that is asked for; ``updates`` gives the messages of the inertial process since
    the last call: changed settings, and plans for cameras that run free. Where the machine cannot keep up, a
    :class:`Overload` is sent.

    Raises
    ------
    DeviceError
        A camera failed, or its images have another size than the airframe says.
    """
    pace = VisionPace()
    try:
        while not stop.is_set():
            if (overload := pace.looked(clock.now_ns())) is not None:
                send(overload)
            frames = cameras.poll(_POLL_S)
            for word in updates():
                vision_step(state, word, clock.now_ns())
            for frame in frames:
                if stop.is_set():
                    break
                _check_size(frame, state)
                if recorder is not None:
                    recorder.write(frame)
                began_ns = clock.now_ns()
                said = vision_step(state, frame, began_ns)
                for record in said:
                    send(record)
                _note(pace, frame, said, began_ns, clock.now_ns())
    finally:
        cameras.close()


def _note(pace: VisionPace, frame: Frame, said: Sequence[Record], began_ns: int, ended_ns: int) -> None:
    pairs = sum(isinstance(record, MatchSet) for record in said)
    lost = sum(r.count for r in said if isinstance(r, Rejected) and r.reason is Reject.FRAME_LOST)
    waited_ns = ended_ns - frame.mid_exposure_ns if frame.clock is ClockName.HOST else 0
    pace.worked(ended_ns - began_ns, pairs, lost, waited_ns)


def _check_size(frame: Frame, state: VisionState) -> None:
    width, height = state.rig.camera(frame.side).lens.size_px
    if frame.image.shape != (height, width):
        rows, columns = frame.image.shape
        raise DeviceError(
            f"{frame.side.name.lower()} camera gives {columns}x{rows} images; "
            f"the airframe's calibration is for {width}x{height}: set the camera to that size, or calibrate at its own "
            "(spanwise calibrate stereo)"
        )
