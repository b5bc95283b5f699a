"""The settings of torch that fits work by, whatever the program around them has set."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import torch

# their precision may be lowered, as by torch.set_float32_matmul_precision
_MKLDNN: Any = torch.backends.mkldnn  # whose members are made at its import
_PRODUCTS = (_MKLDNN.matmul, _MKLDNN.conv, torch.backends.cuda.matmul)


@contextlib.contextmanager
def threads(count: int | None) -> Iterator[None]:
    """Have torch work with so many threads and by its own defaults; afterwards by the program's.

    Autocast, default dtype and device, precision of products and modes without gradients are put aside.

    Threads, dtype and precision are torch's for the whole process. Python threads that fit at the same time therefore
    share them: a fit may work with the count of another, by which figures of several threads differ by rounding, and
    the last that ends decides what is left. A process that was forked after work by several threads waits without end
    in torch: start processes by `spawn` or `forkserver`, or set one thread before.

    Args:
        count: of threads; None: as many as torch has.
    """
    count_around, dtype = torch.get_num_threads(), torch.get_default_dtype()
    precisions = [product.fp32_precision for product in _PRODUCTS]
    with contextlib.ExitStack() as aside:
        aside.callback(_set, count_around, dtype, precisions)
        _set(count or count_around, torch.float32, ["ieee"] * len(_PRODUCTS))
        for kind in ("cpu", "cuda"):
            if torch.is_autocast_enabled(kind):
                aside.enter_context(torch.autocast(kind, enabled=False))
        if torch.get_default_device().type != "cpu":
            aside.enter_context(torch.device("cpu"))
        aside.enter_context(torch.inference_mode(False))
        aside.enter_context(torch.enable_grad())
        yield


def _set(count: int, dtype: torch.dtype, precisions: list[str]) -> None:
    torch.set_num_threads(count)
    torch.set_default_dtype(dtype)
    for product, precision in zip(_PRODUCTS, precisions, strict=True):
        product.fp32_precision = "none"  # as that of all products
        if product.fp32_precision != precision:
            product.fp32_precision = precision
