"""The settings of torch that fits work by, whatever the program around them has set."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from typing import Any

import torch

from metapp.runs.reporter import say


@contextlib.contextmanager
def threads(count: int | None) -> Iterator[None]:
    """Have torch work with so many threads and by its own defaults; afterwards by the program's.

    Figures of some applications depend on the count of threads, which is the process's: work that needs another count
    waits until that which runs is done. Autocast, default dtype and device, precision of products and modes without
    gradients are put aside.

    Args:
        count: of threads; None: as many as torch has where nothing of metapp runs. In a process that was forked after
            work by several threads, for which torch would wait without end there, it is 1.
    """
    with _STATE.held(count), contextlib.ExitStack() as aside:
        for kind in ("cpu", "cuda"):
            if torch.is_autocast_enabled(kind):
                aside.enter_context(torch.autocast(kind, enabled=False))
        if torch.get_default_device().type != "cpu":
            aside.enter_context(torch.device("cpu"))
        aside.enter_context(torch.inference_mode(False))
        aside.enter_context(torch.enable_grad())
        yield


# their precision may be lowered, as by torch.set_float32_matmul_precision
_MKLDNN: Any = torch.backends.mkldnn  # whose members are made at its import
_PRODUCTS = (_MKLDNN.matmul, _MKLDNN.conv, torch.backends.cuda.matmul)
_OURS = (torch.float32, ["ieee"] * len(_PRODUCTS))


def _set_numbers(dtype: torch.dtype, precisions: list[str]) -> None:
    torch.set_default_dtype(dtype)
    for product, precision in zip(_PRODUCTS, precisions, strict=True):
        product.fp32_precision = "none"  # as that of all products
        if product.fp32_precision != precision:
            product.fp32_precision = precision


class _State:
    """What all threads of a process share: the count of threads, the default dtype and the precision of products.

    Work that agrees on the count runs at the same time; the first sets all three, the last the program's again.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._holders: list[int] = []  # threads that work
        self._count = self._outside = self._most = 1
        self._program = _OURS
        self._forked = False

    @contextlib.contextmanager
    def held(self, count: int | None) -> Iterator[None]:
        """Hold the state with a count of threads; work within work has its own count at once."""
        around = self._take(count)
        try:
            yield
        finally:
            self._leave(around)

    def _take(self, count: int | None) -> int:
        """Wait for the state; the count around this work."""
        me = threading.get_ident()
        with self._changed:
            if not self._holders:
                self._outside = torch.get_num_threads()
                self._program = torch.get_default_dtype(), [product.fp32_precision for product in _PRODUCTS]
            nested = me in self._holders
            around = self._count if nested else self._outside
            wanted = count or around
            if self._forked and wanted > 1:
                say("warning: forked after work by several threads: fits use one, by which figures may differ.")
                wanted = 1
            self._changed.wait_for(lambda: nested or not self._holders or wanted == self._count)
            if not self._holders:
                _set_numbers(*_OURS)
            self._holders.append(me)
            self._set(wanted)
            return around

    def _leave(self, around: int) -> None:
        me = threading.get_ident()
        with self._changed:
            self._holders.remove(me)
            if not self._holders:
                _set_numbers(*self._program)
            if not self._holders or me in self._holders:  # or the count would change under others that still work
                self._set(around)
            self._changed.notify_all()

    def _set(self, count: int) -> None:
        torch.set_num_threads(count)
        self._count, self._most = count, max(self._most, count)

    def after_fork(self) -> None:
        """Go on in a forked process, of which other threads are gone."""
        self._changed = threading.Condition()
        self._forked = self._most > 1
        others = [holder for holder in self._holders if holder != threading.get_ident()]
        self._holders = [holder for holder in self._holders if holder not in others]
        if others and not self._holders:
            _set_numbers(*self._program)


_STATE = _State()
os.register_at_fork(after_in_child=lambda: _STATE.after_fork())
