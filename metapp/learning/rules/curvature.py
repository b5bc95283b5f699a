"""Learned matrices that mix the directions of a layer's weights (Meta-Curvature, Park & Oliva 2019)."""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.part import Part
from metapp.learning.task import Params


class Curvature(Part):
    """Matrices per step on both sides of each parameter of two axes: `left.<parameter>`, `right.<parameter>`."""

    name = "curvature"

    def refusal(self, app: App, theta: Params) -> str:
        """It needs a matrix."""
        return "" if any(_sides(value) for value in theta.values()) else "no parameter has two axes"

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The identity, [steps, size, size], for each axis of more than one entry."""
        return {
            f"{side}.{key}": torch.eye(size).repeat(steps, 1, 1)
            for key, value in theta.items()
            for side, size in _sides(value).items()
        }

    def directions(self, alpha: Params, directions: Params, state: Params) -> tuple[Params, Params]:
        """Left matrix times direction times right matrix."""
        return {key: _mixed(alpha, key, direction) for key, direction in directions.items()}, {}


def _sides(value: Tensor) -> dict[str, int]:
    """The sizes of a parameter's matrices, of one task."""
    sides = zip(("left", "right"), value.shape, strict=True) if value.ndim == 2 else ()
    return {side: size for side, size in sides if size > 1}


def _mixed(alpha: Params, key: str, direction: Tensor) -> Tensor:
    if f"left.{key}" in alpha:
        direction = alpha[f"left.{key}"] @ direction
    if f"right.{key}" in alpha:
        direction = direction @ alpha[f"right.{key}"]
    return direction
