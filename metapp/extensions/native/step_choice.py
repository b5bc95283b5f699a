"""The fastest steps there are for a loss and a rule: in C, else by torch, compiled if that pays."""

from __future__ import annotations

import functools
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.fx.experimental.proxy_tensor import make_fx
from torch.utils._pytree import TreeSpec, tree_flatten, tree_unflatten

from metapp.extensions.native import c_steps
from metapp.learning.adjoint import Loss, RuleStep, Steps, UpdateRule, step_and_vjp, torch_steps
from metapp.learning.task import Params
from metapp.runs.reporter import say
from metapp.storage.cache_folders import cache_folder, code_folder

TORCH_CACHE_VARIABLE = "TORCHINDUCTOR_CACHE_DIR"  # where torch keeps code, which it loads again
NO_COMPILING_VARIABLE = "TORCH_COMPILE_DISABLE"  # of the environment, torch's own: 1 for no compiling


def choose_steps(rule: UpdateRule, loss: Loss, theta: Params, order: int, *, compiles: bool = False) -> Steps:
    """Steps in C if the loss and the rule are to be had there, else by torch.

    Args:
        rule, loss, theta, order: as of `torch_steps`.
        compiles: whether steps by torch are so many that compiling them pays; without a tool chain they are not.
    """
    found = c_steps.make_c_steps(rule, loss, theta, order)
    if found is None and compiles and can_compile():
        _say_compiling()
        found = make_compiled_steps(rule, loss, theta, order)
    return found or torch_steps(rule, loss, theta, order)


def make_compiled_steps(rule: UpdateRule, loss: Loss, theta: Params, order: int) -> Steps:
    """Steps by torch.compile, for the shapes of their first call: about twice as fast, after seconds of compiling."""
    step, vjp = _compiled(rule.step, loss, order)
    return torch_steps(rule, loss, theta, order)._replace(step=step, vjp=vjp)


def can_compile() -> bool:
    """Return whether torch compiles steps here; it never does where TORCH_COMPILE_DISABLE is 1."""
    return os.environ.get(NO_COMPILING_VARIABLE) != "1" and has_tool_chain()


@functools.cache
def has_tool_chain() -> bool:
    """Return whether torch.compile finds a whole C++ tool chain; without one, training is about half as fast."""
    if not any(shutil.which(name) for name in ("g++", "clang++")):
        return False
    try:
        # torch's default is a folder of /tmp that anybody can make first
        folder = os.environ.get(TORCH_CACHE_VARIABLE) or cache_folder() / "torch"
        os.environ[TORCH_CACHE_VARIABLE] = str(code_folder(Path(folder), TORCH_CACHE_VARIABLE))
        torch.compile(lambda x: x.sin() + 1)(torch.ones(8))
    except Exception:  # whatever a compiler that lacks a part raises
        return False
    return True


@functools.cache  # once, for all losses of a training
def _say_compiling() -> None:
    say("compiling steps of the rule by torch: a minute or two, the first time")


@functools.lru_cache(maxsize=32)  # compiling takes seconds
def _compiled(rule_step: RuleStep, loss: Loss, order: int) -> tuple[_Program, _Program]:
    step, vjp = step_and_vjp(rule_step, loss, order)
    return _Program(step), _Program(vjp)


Compilation = tuple[Callable[..., Sequence[Tensor]], TreeSpec]  # flat tensors -> flat tensors, and their tree


class _Program:
    """Trace a function of flat trees that calls autograd, for the shapes of its first call, and compile the trace."""

    def __init__(self, function: Callable[..., object]) -> None:
        self.function = function
        self.programs: dict[tuple[object, ...], Compilation] = {}

    def __call__(self, *trees: Params) -> Any:
        # contiguous, as the trace assumes: the key here stands for all that torch would check again at every call
        leaves = [value.contiguous() for tree in trees for value in tree.values()]
        key = (*map(tuple, trees), *((leaf.shape, leaf.dtype, leaf.device) for leaf in leaves))
        if key not in self.programs:
            self.programs[key] = self._compile([list(tree) for tree in trees], leaves)
        program, spec = self.programs[key]
        with torch.no_grad():
            return tree_unflatten(list(program(*leaves)), spec)

    def _compile(self, names: list[list[str]], leaves: list[Tensor]) -> Compilation:
        spec: TreeSpec

        def flat(*leaves: Tensor) -> list[Tensor]:
            nonlocal spec
            values = iter(leaves)
            result = self.function(*({name: next(values) for name in tree} for tree in names))
            outputs, spec = tree_flatten(result)
            return outputs

        flat(*leaves)  # fills caches, whose making a trace would take for a part of every step
        table = {torch.ops.aten.bmm.default: _narrow_bmm}
        program = make_fx(flat, decomposition_table=table)(*[leaf.detach() for leaf in leaves])
        unguarded = torch.compiler.skip_all_guards_unsafe
        return torch.compile(program, options={"guard_filter_fn": unguarded}), spec


def _narrow_bmm(left: Tensor, right: Tensor) -> Tensor:
    """A product that is a long sum for few results, as weight gradients are: on CPUs a loop beats the library's."""
    rows, inner, columns = *left.shape[1:], right.shape[2]
    if left.device.type != "cpu" or inner < 8 * max(rows, columns):
        result: Tensor = NotImplemented
        return result
    return (left[:, :, None, :] * right.mT[:, None, :, :]).sum(-1)
