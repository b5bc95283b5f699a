"""An end within a second of a signal, also while native code keeps Python from seeing it.

Python calls its handlers of signals between two steps of its own, and compiling a scene in Mitsuba is one step of
minutes, in which no thread of Python runs either. So a small process waits beside the command, and kills it if a signal
came and the command still runs when its time is over.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time

_GRACE_SECONDS = 0.8  # for what a command does when it is interrupted, such as to keep the state of a training
_MESSAGE = b"interrupted within a computation that does not stop by itself, and killed; what was finished is kept.\n"
_ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def start_watchdog() -> None:
    """Start the process that kills this one soon after SIGINT or SIGTERM; do nothing where none can fork.

    To be called once, in the main thread, before there are other threads. The watchdog ends with this process, in
    whichever way that ends: then nobody holds the other end of its pipe.
    """
    if not hasattr(os, "fork"):
        return
    reading, writing = os.pipe()
    process = os.getpid()
    if os.fork():
        os.close(reading)
        os.set_blocking(writing, False)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)  # Python's own C code writes signals' numbers there
        os.register_at_fork(after_in_child=lambda: _leave(writing))
        return
    try:
        for number in (*_ENDING_SIGNALS, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)  # a terminal and clusters signal all processes of a command
        os.close(writing)
        _watch(process, reading)
    finally:
        os._exit(0)


def _leave(writing: int) -> None:
    """Have a forked process, such as a worker of torch, write its own signals nowhere."""
    signal.set_wakeup_fd(-1)
    os.close(writing)


def _watch(process: int, reading: int) -> None:
    """Wait for the number of an ending signal in a pipe, and kill a process unless the pipe is closed in time."""
    for number in (0, 1):
        with contextlib.suppress(OSError):
            os.close(number)  # readers of its output wait until all writers are gone
    while content := os.read(reading, 1024):
        if not set(content) & set(_ENDING_SIGNALS):
            continue
        end = time.monotonic() + _GRACE_SECONDS
        while select.select([reading], [], [], max(0.0, end - time.monotonic()))[0]:
            if not os.read(reading, 1024):
                return
        with contextlib.suppress(OSError):
            os.write(2, _MESSAGE)
        os.kill(process, signal.SIGKILL)
