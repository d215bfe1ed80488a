"""Ends of processes: none outlives the one that started it, however that one ends, and a flag tells all to end."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import threading
import time
from typing import Any

_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_LOOK_S = 0.2  # chosen: five looks a second cost nothing, and a port is free again at once
_GRACE_S = 0.6  # chosen: an orderly end takes milliseconds; after it nothing is waited for


class StopFlag:
    """A byte that all processes of a service look at, and that tells them to end; for processes that are spawned.

    It has no lock, as multiprocessing's events do: a process that is killed while it looks would hold that for good,
    and everybody who looks, or sets it, would wait for ever.
    """

    def __init__(self) -> None:
        self._byte: Any = multiprocessing.get_context("spawn").RawValue(ctypes.c_uint8, 0)

    def set(self) -> None:
        """Tell all to end."""
        self._byte.value = 1

    def is_set(self) -> bool:
        """Whether all are to end."""
        return bool(self._byte.value)


class WatchedStopFlag(StopFlag):
    """A stop flag as one process has it, whose looks are counted: a process that looks no more hangs."""

    def __init__(self, flag: StopFlag) -> None:
        self._byte = flag._byte
        self._looks: Any = multiprocessing.get_context("spawn").RawValue(ctypes.c_uint32, 0)

    @property
    def looks(self) -> int:
        """How often the process has looked, modulo 2^32."""
        return int(self._looks.value)

    def is_set(self) -> bool:
        """Whether all are to end; a sign of life too."""
        self._looks.value += 1
        return super().is_set()

    def is_set_while_idle(self) -> bool:
        """The same without a sign of life: a process that only waits for its turn is not watched."""
        return super().is_set()


class SharedCount:
    """A count that outlives the processes that count, one after the other."""

    def __init__(self) -> None:
        self._value: Any = multiprocessing.get_context("spawn").RawValue(ctypes.c_uint32, 0)

    def next(self) -> int:
        """Count one; gives 1 at first."""
        self._value.value += 1
        return int(self._value.value)


def die_with_parent(*, watch: bool = True) -> None:
    """End this process by SIGTERM when its parent dies; Ctrl-C and a terminal that closes are the parent's to handle.

    The kernel sends the signal where it can. With ``watch`` a thread looks too, five times a second, for other systems,
    for a parent that died before the kernel was asked, and for a process that does not obey. A process that
    multiprocessing did not start is left alone.
    """
    parent = multiprocessing.parent_process()
    if parent is None or parent.pid is None:
        return
    for number in (signal.SIGINT, signal.SIGHUP):  # reach the whole group
        signal.signal(number, signal.SIG_IGN)
    process_control(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if watch:
        threading.Thread(target=_watch, args=(parent.pid,), name="parent-watch", daemon=True).start()


def process_control(option: int, value: int) -> bool:
    """``prctl(option, value)``; False where the system has none or refuses."""
    try:
        return bool(ctypes.CDLL(None).prctl(option, ctypes.c_ulong(value), 0, 0, 0) == 0)
    except (OSError, AttributeError):
        return False


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_GRACE_S)
    os._exit(1)
