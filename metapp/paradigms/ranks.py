"""Training by several processes, called ranks, that `torchrun` starts; each differentiates its part of a meta-batch.

All ranks draw the same tasks and samples from the same seed and take the same outer steps. Rank 0 alone writes files.
"""

from __future__ import annotations

import contextlib
import functools
import os
import sys
from collections.abc import Callable, Iterator
from datetime import timedelta
from typing import ParamSpec

import torch
from torch import Tensor
from torch import distributed as dist
from torch.utils._pytree import tree_leaves, tree_map
from typing_extensions import override

from metapp.learning.adjoint import AnyBatch, Loss
from metapp.learning.task import Params

Arguments = ParamSpec("Arguments")

RANK_TIMEOUT = timedelta(minutes=30)  # the time that ranks wait for a slower one before it counts as lost
# names of the network interface for connections within a machine, by `sys.platform`
LOOPBACK_INTERFACES = {"linux": "lo", "darwin": "lo0"}


def rank_number() -> int:
    """Return the number of this process among the ranks, 0 if there is only one."""
    return int(os.environ.get("RANK", "0"))


def rank_count() -> int:
    """Return the number of ranks, 1 without `torchrun`."""
    return int(os.environ.get("WORLD_SIZE", "1"))


@contextlib.contextmanager
def connect_ranks(device: torch.device) -> Iterator[None]:
    """Connect the ranks within a context: by nccl on GPUs, one GPU a rank, and by gloo on CPUs.

    Raises:
        SystemExit: at the end of the context, in all ranks but rank 0, which goes on alone; the exit code is 0.
    """
    if rank_count() == 1:
        yield
        return
    if device.type == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    elif sys.platform in LOOPBACK_INTERFACES and os.environ.get("LOCAL_WORLD_SIZE") == os.environ["WORLD_SIZE"]:
        # all ranks are on one machine; gloo would warn if the machine cannot resolve its own name, as in containers
        os.environ.setdefault("GLOO_SOCKET_IFNAME", LOOPBACK_INTERFACES[sys.platform])
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo", timeout=RANK_TIMEOUT)
    try:
        yield
    finally:
        with contextlib.suppress(RuntimeError):  # other ranks may have ended
            dist.destroy_process_group()
    end_other_ranks()


def end_other_ranks() -> None:
    """End the process, with exit code 0, in all ranks but rank 0."""
    if rank_number() > 0:
        raise SystemExit(0)


@contextlib.contextmanager
def rank_zero_first() -> Iterator[None]:
    """Let rank 0 pass through a context before the other ranks enter it, and all leave it together.

    Raises:
        ConnectionError: another rank has ended.
    """
    if rank_number() > 0:
        wait_for_ranks()
    yield
    if rank_number() == 0:
        wait_for_ranks()
    wait_for_ranks()


def on_rank_zero(function: Callable[Arguments, None]) -> Callable[Arguments, None]:
    """Return a function that does nothing in other ranks than rank 0."""

    @functools.wraps(function)
    def run(*arguments: Arguments.args, **keywords: Arguments.kwargs) -> None:
        if rank_number() == 0:
            function(*arguments, **keywords)

    return run


def wait_for_ranks() -> None:
    """Wait until all ranks have come to this call.

    Raises:
        ConnectionError: another rank has ended.
    """
    if rank_count() > 1:
        _sum_over_ranks(torch.zeros(1, device="cuda" if dist.get_backend() == "nccl" else "cpu")).tolist()


def _sum_over_ranks(value: Tensor) -> Tensor:
    """Sum a tensor over all ranks, in place, and return it.

    Raises:
        ConnectionError: another rank has ended.
    """
    try:
        dist.all_reduce(value)
    except RuntimeError as error:
        ended = f"rank {rank_number()} of {rank_count()}: another rank has ended"
        raise ConnectionError(
            f"{ended}; run the same command again to continue from the training checkpoint."
        ) from error
    return value


class LossOverRanks(Loss):
    """A loss that all tasks share, of which each rank differentiates its part of the tasks."""

    @override
    def gradient(
        self, theta: Params, batch: AnyBatch, loss_parameters: Params, *, graph: bool
    ) -> tuple[Params, Tensor]:
        """Return the gradient over the tasks of all ranks, and the loss of each task, [T]; equal on all ranks.

        Raises:
            ValueError: there are more ranks than tasks.
        """
        tasks = next(leaf for leaf in tree_leaves(batch) if isinstance(leaf, Tensor)).shape[0]
        if rank_count() > tasks:
            raise ValueError(f"{rank_count()} ranks: an outer step has {tasks} tasks, expected at most as many ranks.")
        rows = slice(rank_number(), tasks, rank_count())

        def select_rows(leaf: object) -> object:
            return leaf[rows] if isinstance(leaf, Tensor) and leaf.shape[:1] == (tasks,) else leaf

        grads, own_losses = super().gradient(theta, tree_map(select_rows, batch), loss_parameters, graph=graph)
        losses = own_losses.new_zeros(tasks)
        losses[rows] = own_losses
        return {key: _sum_over_ranks(grad * (len(own_losses) / tasks)) for key, grad in grads.items()}, _sum_over_ranks(
            losses
        )
