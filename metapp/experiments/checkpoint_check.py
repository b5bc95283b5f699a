"""Whether a checkpoint that a file holds is one of this application's network and rule: anybody may have written it."""

from __future__ import annotations

from pathlib import Path

from torch import Generator

from metapp.experiments.session import Options
from metapp.learning.learn import MetaParameters
from metapp.learning.rules import rule_of
from metapp.learning.task import Params
from metapp.paradigms import Paradigm
from metapp.paradigms.quickft import TUNED


def require_fit(path: Path, options: Options, paradigm: Paradigm, prepared: MetaParameters) -> None:
    """Refuse tensors that are not this application's, or not this rule's.

    Raises:
        ValueError: a tensor is missing or has another shape; names it.
    """
    app, recipe, rng = options.app, options.job.recipe, Generator().manual_seed(0)
    network = {key: value[0] for key, value in app.init(rng, 1).items()}
    if paradigm.name == "meta":
        alpha = rule_of(options.rule).alpha(app, network, recipe.steps, recipe.meta_training(options.rule).first)
        _require(path, "alpha", prepared.alpha, alpha, steps=True)
    else:
        _require(path, "alpha", prepared.alpha, {})
    if prepared.encoder or paradigm.name != "meta":
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
