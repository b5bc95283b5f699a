"""Whether a checkpoint that a file holds is one of this application's network and rule: anybody may have written it."""

from __future__ import annotations

from pathlib import Path

from torch import Generator, Tensor

from metapp.learning.learn import MetaParameters
from metapp.learning.rules import rule_of
from metapp.learning.task import Params
from metapp.networks.field import regridded
from metapp.paradigms.quickft import TUNED
from metapp.runs.plan import Plan


def on_own_grid(plan: Plan, prepared: MetaParameters) -> MetaParameters:
    """A checkpoint of Meta whose hyperparameters on a grid, [K, channels, rows, columns], are on the application's own.

    They may have been learned on a coarser one: those of another recipe of the same network.
    """
    if plan.paradigm.name != "meta":
        return prepared
    wanted = _fresh_alpha(plan)
    alpha = {
        key: regridded(value, *wanted[key].shape[2:], periodic=plan.app.traits.periodic)
        if key in wanted and _is_on_a_grid(value, wanted[key])
        else value
        for key, value in prepared.alpha.items()
    }
    return prepared._replace(alpha=alpha)


def _is_on_a_grid(value: Tensor, wanted: Tensor) -> bool:
    return value.ndim == wanted.ndim == 4 and value.shape[1] == wanted.shape[1] and min(value.shape) > 0


def _fresh_alpha(plan: Plan) -> Params:
    """The rule's hyperparameters before training, of the shapes that a checkpoint's must have."""
    recipe = plan.job.recipe
    network = {key: value[0] for key, value in plan.app.init(Generator().manual_seed(0), 1).items()}
    first = recipe.training(plan.job.rule).first
    return rule_of(plan.job.rule).alpha(plan.app, network, recipe.steps, first)


def require_fit(path: Path, plan: Plan, prepared: MetaParameters) -> None:
    """Refuse tensors that are not this application's, or not this rule's.

    Raises:
        ValueError: a tensor is missing or has another shape; names it.
    """
    app, rng = plan.app, Generator().manual_seed(0)
    network = {key: value[0] for key, value in app.init(rng, 1).items()}
    if plan.paradigm.name == "meta":
        _require(path, "alpha", prepared.alpha, _fresh_alpha(plan), steps=True)
    else:
        _require(path, "alpha", prepared.alpha, {})
    if prepared.encoder or plan.paradigm.name != "meta":
        _require(path, "encoder", prepared.encoder, app.init_encoder(rng))
    else:
        _require(path, "theta", prepared.theta, network)


def require_tuned(path: Path, prepared: MetaParameters) -> None:
    """Refuse what are not the settings of one Adam.

    Raises:
        ValueError: one is missing, or no number.
    """
    if set(prepared.alpha) != set(TUNED) or any(value.numel() != 1 for value in prepared.alpha.values()):
        raise ValueError(
            f"{path}: holds {', '.join(sorted(prepared.alpha)) or 'no settings'}, expected one number each for "
            f"{', '.join(TUNED)}; tune again with metapp quickft --train."
        )


def _require(path: Path, part: str, found: Params, expected: Params, *, steps: bool = False) -> None:
    """Refuse a part of a checkpoint that lacks a tensor or has another; `steps`: the first axis may have any length."""
    remedy = "give a checkpoint of this application, rule and recipe, or train one with --train"
    for key in sorted(expected | found, key=lambda key: key not in expected):
        shapes: list[tuple[int | str, ...] | None] = [
            tuple(of[key].shape) if key in of else None for of in (found, expected)
        ]
        if steps and all(shapes):
            shapes = [shape and ("steps", *shape[1:]) for shape in shapes]
        if shapes[0] != shapes[1]:
            has, wants = (_said(shape) for shape in shapes)
            raise ValueError(f"{path}: {part} {key} is {has}, expected {wants}; {remedy}.")


def _said(shape: tuple[int | str, ...] | None) -> str:
    return "missing" if shape is None else f"({', '.join(map(str, shape))})"
