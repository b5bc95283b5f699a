"""Training on many processes, which `torchrun` starts: each has its part of every meta-batch, gradients are summed.

All ranks draw the same tasks and samples from the same seed and take the same outer steps; rank 0 alone writes.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from datetime import timedelta

import torch
from torch import Tensor
from torch import distributed as dist
from torch.utils._pytree import tree_leaves, tree_map

from metapp.learning.adjoint import AnyBatch, Loss
from metapp.learning.task import Params

WAITS = timedelta(minutes=30)  # for a rank that is slower, before it counts as lost


def number() -> int:
    """Which rank this process is; 0 where there is one alone."""
    return int(os.environ.get("RANK", "0"))


def count() -> int:
    """The number of ranks that `torchrun` has started; 1 without it."""
    return int(os.environ.get("WORLD_SIZE", "1"))


@contextlib.contextmanager
def joined(device: torch.device) -> Iterator[None]:
    """Connect the ranks for what is inside: by nccl on GPUs, one each, by gloo on CPUs."""
    if count() == 1:
        yield
        return
    if device.type == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    elif _on_one_machine() and (loopback := {"lo", "lo0"} & {name for _, name in socket.if_nameindex()}):
        # gloo warns of a machine that cannot resolve its own name, as in containers
        os.environ.setdefault("GLOO_SOCKET_IFNAME", loopback.pop())
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo", timeout=WAITS)
    try:
        yield
    finally:
        with contextlib.suppress(RuntimeError):  # of ranks that are gone
            dist.destroy_process_group()


def _on_one_machine() -> bool:
    address = os.environ.get("MASTER_ADDR", "")
    local = address in ("localhost", "::1") or address.startswith("127.")
    return local or os.environ.get("LOCAL_WORLD_SIZE") == os.environ["WORLD_SIZE"]


def wait() -> None:
    """Wait until all ranks are here.

    Raises:
        ConnectionError: one has ended.
    """
    if count() > 1:
        with _lost_ranks():
            dist.barrier()


@contextlib.contextmanager
def _lost_ranks() -> Iterator[None]:
    try:
        yield
    except RuntimeError as error:
        raise ConnectionError(
            f"rank {number()} of {count()}: another rank has ended; the same command goes on from the training "
            "checkpoint."
        ) from error


def require(tasks: int) -> None:
    """Refuse more ranks than an outer step has tasks.

    Raises:
        ValueError: says how many there may be.
    """
    if count() > tasks:
        raise ValueError(f"{count()} ranks: an outer step has {tasks} tasks, expected at most as many ranks.")


class SummedOverRanks(Loss):
    """A mean over tasks, each rank's part of which is differentiated there; the same on all ranks."""

    def gradient(self, theta: Params, batch: AnyBatch, learned: Params, *, graph: bool) -> tuple[Params, Tensor]:
        """The gradient of all tasks, and the loss of each, [T]."""
        total = next(leaf for leaf in tree_leaves(batch) if isinstance(leaf, Tensor)).shape[0]
        rows = range(number(), total, count())

        def part(leaf: object) -> object:
            if isinstance(leaf, Tensor) and leaf.shape[:1] == (total,):
                return leaf[rows.start : total : count()]
            return leaf

        grads, part_losses = super().gradient(theta, tree_map(part, batch), learned, graph=graph)
        losses = part_losses.new_zeros(total)
        losses[rows.start : total : count()] = part_losses
        flat = torch.cat([*(grad.flatten() * (len(rows) / total) for grad in grads.values()), losses])
        with _lost_ranks():
            dist.all_reduce(flat)
        *parts, losses = flat.split([*(grad.numel() for grad in grads.values()), total])
        return {key: part.view_as(grads[key]) for key, part in zip(grads, parts, strict=True)}, losses
