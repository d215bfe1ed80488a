"""Processes that do not outlive the one that started them, however that one ends."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import threading
import time

_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_LOOK_S = 0.2  # chosen: five looks a second cost nothing, and a port is free again at once
_GRACE_S = 0.6  # chosen: an orderly end takes milliseconds; after it nothing is waited for


def die_with_parent(*, watch: bool = True) -> None:
    """End this process by SIGTERM when its parent dies; Ctrl-C, which reaches all of them, is the parent's to handle.

    The kernel sends the signal where it can. With ``watch`` a thread looks too, five times a second, for other systems,
    for a parent that died before the kernel was asked, and for a process that does not obey. A process that
    multiprocessing did not start is left alone.
    """
    parent = multiprocessing.parent_process()
    if parent is None or parent.pid is None:
        return
    signal.signal(signal.SIGINT, signal.SIG_IGN)
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
