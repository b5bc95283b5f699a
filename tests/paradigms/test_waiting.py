"""Steps read nothing back: on a GPU each such read would make the program wait for all that was asked for before."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from metapp.learning import learn as learning
from metapp.learning.app import stack
from metapp.learning.learn import check_finite, descend, final_item
from metapp.paradigms.meta import Meta
from metapp.registry import app_names, protocols_of
from tests.paradigms.small import KINDS, OWN_RULES, SMALL, prepared_for, rng, small_app, small_recipe

READS = ("item", "tolist", "cpu", "numpy", "__bool__", "__int__", "__float__", "__index__")
STEPS = 3
# stationary svBRDFs cut windows out whose places they draw: the only numbers that a fit reads at each step
KNOWN = {"svbrdf_stationary": ("tolist",)}


class Ops(TorchDispatchMode):
    """Refuse what waits by itself: numbers that are read, and masks, of which must be counted what they leave."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func.overloadpacket.__name__
        masks = name in ("index", "index_put", "index_put_") and any(
            each is not None and each.dtype == torch.bool for each in args[1]
        )
        if masks or name in ("_local_scalar_dense", "nonzero", "masked_select", "unique", "_unique2"):
            raise AssertionError(f"a step waits for {name}")
        return func(*args, **(kwargs or {}))


@contextmanager
def reading_nothing(allowed: tuple[str, ...]) -> Iterator[None]:
    """Fail where a number is read back in another way than those that are allowed."""

    def refuse(name: str) -> Any:
        def read(*args: Any, **kwargs: Any) -> Any:
            raise AssertionError(f"a step calls Tensor.{name}")

        return read

    with pytest.MonkeyPatch.context() as patch, Ops():
        for name in set(READS) - set(allowed):
            patch.setattr(Tensor, name, refuse(name))
        yield


@pytest.mark.usefixtures("scene")
@pytest.mark.parametrize(
    ("kind", "protocol"),
    [(kind, protocol) for kind in KINDS for protocol in (kind in app_names() and protocols_of(kind)) or [""]],
)
def test_steps_of_fits_read_nothing_back(kind: str, protocol: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for the check that the first loss is finite."""
    app = replace(small_app(kind), protocol=protocol)
    meta = Meta(app, small_recipe(app), OWN_RULES[kind])
    tasks = stack(app, SMALL[app.name].tasks()[:2])
    prepared = prepared_for(meta)
    loss = meta.loss

    def fit(where: AbstractContextManager[None]) -> None:
        theta = meta.initialisation(prepared, tasks, rng())
        rule, draws = meta.rule(prepared, theta, STEPS), rng()
        with where:
            final_item(check_finite(descend(theta, rule, tasks, loss, steps=STEPS, rng=draws), every=0))

    fit(nullcontext())  # constants are made at their first use
    monkeypatch.setattr(learning, "_require_finite", lambda *args: None)
    fit(reading_nothing(KNOWN.get(kind, ())))
