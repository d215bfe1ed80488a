"""Requests to Linux for real-time scheduling and locked memory; what is refused is reported."""

from __future__ import annotations

import ctypes
import gc
import os

from companion.adapters.triggers.wire import Realtime
from companion.lifetime import process_control

_PRIORITY = 50  # SCHED_FIFO, 1 to 99: the middle (choice)
_PR_SET_TIMERSLACK = 29  # linux/prctl.h
_MCL_CURRENT = 1  # not MCL_FUTURE: under a memlock limit that makes later allocations fail (by definition)


def become_realtime(fifo: bool = True) -> Realtime:
    """Take SCHED_FIFO, lock the memory, set the timer slack to 1 ns, and end garbage collection in this process."""
    gc.collect()
    gc.freeze()
    gc.disable()
    return Realtime(fifo and _fifo(), _locked(), process_control(_PR_SET_TIMERSLACK, 1))


def _fifo() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except (OSError, AttributeError):
        return False
    return True


def _locked() -> bool:
    try:
        return bool(ctypes.CDLL(None).mlockall(_MCL_CURRENT) == 0)
    except (OSError, AttributeError):
        return False
