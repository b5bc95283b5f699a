"""Training by several processes, ranks, that `torchrun` starts: each differentiates its part of every meta-batch.

All ranks draw the same tasks and samples from the same seed and take the same outer steps; rank 0 alone writes.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from datetime import timedelta

import torch
from torch import Tensor
from torch import distributed as dist
from torch.utils._pytree import tree_leaves, tree_map

from metapp.learning.adjoint import AnyBatch, Loss
from metapp.learning.task import Params

RANK_TIMEOUT = timedelta(minutes=30)  # for a slower rank, before it counts as lost
LOOPBACK_INTERFACES = {"linux": "lo", "darwin": "lo0"}


def rank_number() -> int:
    """The rank of this process; 0 of a single one."""
    return int(os.environ.get("RANK", "0"))


def rank_count() -> int:
    """The number of ranks; 1 without `torchrun`."""
    return int(os.environ.get("WORLD_SIZE", "1"))


@contextlib.contextmanager
def connect_ranks(device: torch.device) -> Iterator[None]:
    """The connection of the ranks: by nccl on GPUs, one each, by gloo on CPUs."""
    if rank_count() == 1:
        yield
        return
    if device.type == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    elif sys.platform in LOOPBACK_INTERFACES and os.environ.get("LOCAL_WORLD_SIZE") == os.environ["WORLD_SIZE"]:
        # on one machine; gloo warns of one that cannot resolve its own name, as in containers
        os.environ.setdefault("GLOO_SOCKET_IFNAME", LOOPBACK_INTERFACES[sys.platform])
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo", timeout=RANK_TIMEOUT)
    try:
        yield
    finally:
        with contextlib.suppress(RuntimeError):  # of ranks that are gone
            dist.destroy_process_group()


def wait_for_ranks() -> None:
    """Wait for all ranks.

    Raises:
        ConnectionError: one has ended.
    """
    if rank_count() > 1:
        _summed(torch.zeros(1, device="cuda" if dist.get_backend() == "nccl" else "cpu")).tolist()


def _summed(value: Tensor) -> Tensor:
    """The sum of a tensor over all ranks, in its place."""
    try:
        dist.all_reduce(value)
    except RuntimeError as error:
        ended = f"rank {rank_number()} of {rank_count()}: another rank has ended"
        raise ConnectionError(f"{ended}; the same command goes on from the training checkpoint.") from error
    return value


class LossOverRanks(Loss):
    """A mean over tasks, each rank's part of which is differentiated there; the same on all ranks."""

    def gradient(self, theta: Params, batch: AnyBatch, learned: Params, *, graph: bool) -> tuple[Params, Tensor]:
        """The gradient of all tasks, and the loss of each, [T].

        Raises:
            ValueError: there are more ranks than tasks.
        """
        tasks = next(leaf for leaf in tree_leaves(batch) if isinstance(leaf, Tensor)).shape[0]
        if rank_count() > tasks:
            raise ValueError(f"{rank_count()} ranks: an outer step has {tasks} tasks, expected at most as many ranks.")
        rows = slice(rank_number(), tasks, rank_count())

        def part(leaf: object) -> object:
            return leaf[rows] if isinstance(leaf, Tensor) and leaf.shape[:1] == (tasks,) else leaf

        grads, part_losses = super().gradient(theta, tree_map(part, batch), learned, graph=graph)
        losses = part_losses.new_zeros(tasks)
        losses[rows] = part_losses
        return {key: _summed(grad * (len(part_losses) / tasks)) for key, grad in grads.items()}, _summed(losses)
