"""What a task's tensors must be."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from metapp.learning.task import Task, TensorSpec, problems_of

HOLDS = {
    "image": TensorSpec((3, "h", "w"), "uint8"),
    "map": TensorSpec(("h", "w"), low=0.0, high=1.0),
    "more": TensorSpec(("n",), optional=True),
}


def whole() -> dict[str, Tensor]:
    """Tensors as they must be, at the ends of their range."""
    return {"image": torch.zeros(3, 4, 5, dtype=torch.uint8), "map": torch.tensor([0.0, 1.0]).repeat(10).reshape(4, 5)}


@pytest.mark.parametrize(
    "further",
    [
        {},
        {"more": torch.tensor([-1e30])},
        {"map": torch.ones(4, 5, dtype=torch.float16)},
        {"map": torch.zeros(4, 5, dtype=torch.float64)},
        {"unknown": torch.ones(2, dtype=torch.int64)},
    ],
)
def test_nothing_is_wrong_with_what_is_as_it_must_be(further: dict[str, Tensor]) -> None:
    assert problems_of(Task("a", whole() | further), HOLDS) == []


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"image": None}, "tensor 'image' is missing"),
        ({"map": torch.ones(4, 6)}, "'map' is float32 [4, 6], expected float [h, w]"),  # h and w are the image's
        ({"map": torch.ones(4)}, "'map' is float32 [4], expected float [h, w]"),
        ({"image": torch.zeros(4, 4, 5, dtype=torch.uint8)}, "'image' is uint8 [4, 4, 5], expected uint8 [3, h, w]"),
        ({"image": torch.zeros(3, 4, 5)}, "'image' is float32 [3, 4, 5], expected uint8 [3, h, w]"),
        ({"more": torch.zeros(0)}, "'more' is float32 [0], expected float [n]"),
        ({"unknown": torch.zeros(2, dtype=torch.bfloat16)}, "'unknown' is bfloat16 [2], expected floats of 16"),
        ({"unknown": torch.tensor([0.0, math.nan])}, "'unknown' holds NaN or infinite values"),
        ({"kind": torch.tensor([0.0])}, "'kind' is float32 [1], expected uint8 [1]"),
        ({"map": torch.full((4, 5), 1.5)}, "'map' holds 1.5 to 1.5, expected 0 to 1"),
    ],
)
def test_what_is_wrong_is_one_line(wrong: dict[str, Tensor | None], said: str) -> None:
    data = {key: value for key, value in (whole() | wrong).items() if value is not None}
    (problem,) = problems_of(Task("a", data), HOLDS)
    assert said in problem
    assert problem.startswith("tensor '")
