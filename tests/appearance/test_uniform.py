"""Inputs that are the same everywhere, and fits that collapsed; nothing is said of dark or plain materials."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from metapp.appearance.uniform import collapsed_fit_warnings, uniform_input_remarks

SEEDS = range(20)
BLACK, SAME = "the fit is black", "the fit is the same everywhere"


def varied(seed: int, scale: float = 1.0) -> Tensor:
    """Draw values [3, 256] of about two decades, times a scale."""
    rng = torch.Generator().manual_seed(seed)
    return scale * 10 ** (2 * torch.rand(3, 256, generator=rng) - 2)


def near(seed: int, scale: float) -> tuple[Tensor, Tensor]:
    """Draw an input and a fit of it."""
    given = varied(seed, scale)
    return given * (1 + 0.1 * torch.randn(given.shape, generator=torch.Generator().manual_seed(seed))).clamp_min(
        0
    ), given


def plain(seed: int, noise: float = 0.0) -> Tensor:
    """Draw one colour, with noise."""
    rng = torch.Generator().manual_seed(seed)
    return torch.rand(3, 1, generator=rng).clamp_min(0.01) * (1 + noise * torch.rand(3, 256, generator=rng))


SOUND: dict[str, Callable[[int], tuple[Tensor, Tensor]]] = {
    "a good fit": lambda seed: near(seed, 1.0),
    "a good fit of black velvet": lambda seed: near(seed, 1e-3),
    "a good fit of a mirror": lambda seed: near(seed, 1e5),
    "a plain fit of chalk": lambda seed: (plain(seed), plain(seed)),
    "a plain fit of noisy chalk": lambda seed: (plain(seed), plain(seed, 0.08)),
    "a dark fit of a bright material": lambda seed: (varied(seed, 0.01), varied(seed)),
    "black of black": lambda seed: (torch.zeros(3, 9), torch.zeros(3, 9)),
}
COLLAPSED: dict[str, tuple[Callable[[int], tuple[Tensor, Tensor]], str]] = {
    "black": (lambda seed: (torch.zeros(3, 256), varied(seed)), BLACK),
    "nearly black": (lambda seed: (varied(seed, 1e-5), varied(seed)), BLACK),
    "black of velvet": (lambda seed: (torch.zeros(3, 256), varied(seed, 1e-3)), BLACK),
    "black of chalk": (lambda seed: (torch.zeros(3, 256), plain(seed)), BLACK),
    "plain": (lambda seed: (plain(seed), varied(seed)), SAME),
    "plain of velvet": (lambda seed: (plain(seed), varied(seed, 1e-3)), SAME),
}


@pytest.mark.parametrize("name", SOUND)
def test_nothing_is_said_of_sound_fits(name: str) -> None:
    assert [collapsed_fit_warnings(*SOUND[name](seed)) for seed in SEEDS] == [[]] * len(SEEDS)


@pytest.mark.parametrize("name", COLLAPSED)
def test_a_collapsed_fit_is_said(name: str) -> None:
    make, said = COLLAPSED[name]
    for seed in SEEDS:
        (clause,) = collapsed_fit_warnings(*make(seed))
        assert clause.startswith(said)
        assert ";" not in clause  # which parts the clauses of a record


def test_an_input_of_one_value_is_a_fact() -> None:
    for seed in SEEDS:
        (clause,) = uniform_input_remarks(plain(seed).expand(3, 256), "reflectance in 1/sr")
        assert clause.startswith("the input is one reflectance in 1/sr everywhere: 0.")
        assert uniform_input_remarks(plain(seed, 0.02), "reflectance") == []
        assert uniform_input_remarks(varied(seed, 1e-4), "reflectance") == []
    assert uniform_input_remarks(torch.zeros(3, 9), "reflectance") == []  # which readers say
