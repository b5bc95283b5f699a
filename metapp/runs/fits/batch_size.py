"""The number of tasks that are fitted side by side: as asked for, or what proves to be quick and fits in the memory."""

from __future__ import annotations

import contextlib
import os
import resource
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import torch

from metapp.learning.task import Task
from metapp.runs import BadOption

Item = TypeVar("Item")
AUTO = "auto"
MOST = 256
PAYS = 0.9  # of the seconds a task: what twice as many must save at least
SHARE = 0.5  # of the memory that is left: what twice as many may take


def check_batch(text: str) -> int | None:
    """The number of a batch; None of auto and of "".

    Raises:
        BadOption: it is neither.
    """
    if text in ("", AUTO):
        return None
    if not (text.isascii() and text.isdigit() and 1 <= int(text[:9]) <= 100_000):
        raise BadOption(f"--batch '{text}': expected a number of tasks from 1 on, or auto.")
    return int(text)


class BatchSize:
    """The number of tasks in the next batch.

    Without a fixed number batches grow from 1: twice as many are tried as long as that saves a tenth of the time a
    task, and as long as what they would take, by what the last ones took, is at most half of the memory that is left.

    Attributes:
        now: of the next batch.
    """

    def __init__(self, fixed: int | None, device: torch.device) -> None:
        self.now, self._device = fixed or 1, device
        self._settled = fixed is not None
        self._best = float("inf")
        self._peak = peak_bytes(device)

    def note(self, count: int, seconds: float) -> None:
        """Take note of what a batch took; choose the next number."""
        peak = peak_bytes(self._device)
        grown, self._peak = max(0, peak - self._peak), peak
        if self._settled or count < self.now:
            return
        seconds_a_task = seconds / count
        pays, self._best = seconds_a_task < PAYS * self._best, min(seconds_a_task, self._best)
        room = 2 * grown <= SHARE * bytes_left(self._device)
        if pays and room and 2 * self.now <= MOST:
            self.now *= 2
            return
        self._settled = True
        if seconds_a_task > self._best:  # half as many were quicker
            self.now = max(1, self.now // 2)

    def failed(self) -> None:
        """A batch was too large for the memory: half as many from now on."""
        self.now, self._settled = max(1, self.now // 2), True


def peak_bytes(device: torch.device) -> int:
    """The most memory that this program has used so far, of the device."""
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated(device)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else 1024 * most


def bytes_left(device: torch.device) -> int:
    """Memory of the device that can be had, about."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    free = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 4  # where the system does not say it
    with contextlib.suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        free = 1024 * int(next(line for line in lines if line.startswith("MemAvailable")).split()[1])
    with contextlib.suppress(OSError, ValueError):  # of a container; "max" where it has no limit
        group = Path("/sys/fs/cgroup")
        limit = int((group / "memory.max").read_text(encoding="ascii"))
        free = min(free, limit - int((group / "memory.current").read_text(encoding="ascii")))
    return free


def alike(pairs: Iterable[tuple[Item, Task]]) -> list[list[tuple[Item, Task]]]:
    """Groups of tasks whose tensors are of the same sizes, which can be fitted side by side."""
    groups: dict[tuple[tuple[str, torch.Size], ...], list[tuple[Item, Task]]] = {}
    for source, task in pairs:
        sizes = tuple((key, task.data[key].shape) for key in sorted(task.data))
        groups.setdefault(sizes, []).append((source, task))
    return list(groups.values())
