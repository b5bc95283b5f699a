"""The choice of the fastest steps for a loss and a rule: in C, else by torch, compiled if that saves time.

All steps compute what `metapp.learning.adjoint.torch_steps` computes, to rounding. Learning calls :func:`choose_steps`
and need not know which of them it gets.
"""

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

from metapp.extensions.native import c_steps, meta_sgd
from metapp.learning.adjoint import Loss, RuleStep, Steps, UpdateRule, step_and_vjp, torch_steps
from metapp.learning.task import Params
from metapp.runs.reporter import say
from metapp.storage.cache_folders import TORCH_FOLDER, cache_folder, code_folder

# variables of the environment that torch reads itself
TORCH_CACHE_VARIABLE = "TORCHINDUCTOR_CACHE_DIR"  # the folder where torch keeps compiled code, which it loads again
NO_COMPILING_VARIABLE = "TORCH_COMPILE_DISABLE"  # 1 if torch shall not compile


def choose_steps(rule: UpdateRule, loss: Loss, theta: Params, order: int, *, compiles: bool = False) -> Steps:
    """Choose the fastest steps: in C if the loss and the rule have a form in C, else by torch.

    Args:
        rule: the rule, with its hyperparameters.
        loss: the loss that steps follow.
        theta: parameters [T, ...], whose names and shapes count.
        order: 2 if steps are differentiated through the gradient, else 1.
        compiles: whether so many steps follow that compiling steps by torch saves time; they are compiled only where
            there is a tool chain.
    """
    steps = c_steps.make_c_steps(rule, loss, theta, order) or meta_sgd.make_outer_steps(rule, loss, theta)
    if steps is None and compiles and can_compile():
        _say_compiling()
        steps = make_compiled_steps(rule, loss, theta, order)
    return steps or torch_steps(rule, loss, theta, order)


def make_compiled_steps(rule: UpdateRule, loss: Loss, theta: Params, order: int) -> Steps:
    """Make steps by torch.compile, for the shapes of their first call.

    They are about twice as fast as steps by torch, after seconds of compiling. See :func:`choose_steps`.
    """
    step, vjp = _make_programs(rule.step, loss, order)
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
        # torch's own choice is a folder below /tmp, which another user may have made before, with code in it
        folder = os.environ.get(TORCH_CACHE_VARIABLE) or cache_folder() / TORCH_FOLDER
        os.environ[TORCH_CACHE_VARIABLE] = str(code_folder(Path(folder), TORCH_CACHE_VARIABLE))
        torch.compile(lambda x: x.sin() + 1)(torch.ones(8))
    except Exception:  # whatever a compiler that lacks a part raises
        return False
    return True


@functools.cache  # once, for all losses of a training
def _say_compiling() -> None:
    say("compiling steps of the rule by torch: a minute or two, the first time")


@functools.lru_cache(maxsize=32)  # compiling takes seconds
def _make_programs(rule_step: RuleStep, loss: Loss, order: int) -> tuple[_Program, _Program]:
    step, vjp = step_and_vjp(rule_step, loss, order)
    return _Program(step), _Program(vjp)


# a compiled function of a list of tensors that returns a list of tensors, and the tree that its results belong in
Compilation = tuple[Callable[..., Sequence[Tensor]], TreeSpec]


class _Program:
    """A function of dictionaries of tensors that calls autograd, traced and compiled for the shapes of each first call.

    Args:
        function: the function, whose results may be any tree of tensors.
    """

    def __init__(self, function: Callable[..., object]) -> None:
        self.function = function
        self.programs: dict[tuple[object, ...], Compilation] = {}

    def __call__(self, *trees: Params) -> Any:
        # contiguous, as the trace assumes: torch's own checks at every call are left out, and this key stands for them
        leaves = [value.contiguous() for tree in trees for value in tree.values()]
        key = (*map(tuple, trees), *((leaf.shape, leaf.dtype, leaf.device) for leaf in leaves))
        if key not in self.programs:
            self.programs[key] = self._compile([list(tree) for tree in trees], leaves)
        program, spec = self.programs[key]
        with torch.no_grad():
            return tree_unflatten(list(program(*leaves)), spec)

    def _compile(self, names: list[list[str]], leaves: list[Tensor]) -> Compilation:
        spec: TreeSpec

        def call_flat(*leaves: Tensor) -> list[Tensor]:
            nonlocal spec
            values = iter(leaves)
            result = self.function(*({name: next(values) for name in tree} for tree in names))
            outputs, spec = tree_flatten(result)
            return outputs

        call_flat(*leaves)  # fills caches; a trace would take the filling for a part of every step
        table = {torch.ops.aten.bmm.default: _multiply_narrow}
        program = make_fx(call_flat, decomposition_table=table)(*[leaf.detach() for leaf in leaves])
        unguarded = torch.compiler.skip_all_guards_unsafe
        return torch.compile(program, options={"guard_filter_fn": unguarded}), spec


def _multiply_narrow(left: Tensor, right: Tensor) -> Tensor:
    """Multiply matrices whose product has few entries, each a long sum, as gradients of weights are.

    On CPUs a loop is faster at these than the library's product. Returns NotImplemented for other matrices.
    """
    rows, inner, columns = *left.shape[1:], right.shape[2]
    if left.device.type != "cpu" or inner < 8 * max(rows, columns):
        result: Tensor = NotImplemented
        return result
    return (left[:, :, None, :] * right.mT[:, None, :, :]).sum(-1)
