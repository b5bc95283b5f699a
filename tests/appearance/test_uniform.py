"""Detection of inputs that are alike everywhere and of collapsed fits; dark or plain materials cause no warning."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from metapp.appearance.uniform import collapsed_fit_warnings, uniform_input_remarks

SEEDS = range(20)
BLACK, SAME = "the fit is black", "the fit is the same everywhere"


def draw_varied(seed: int, scale: float = 1.0) -> Tensor:
    """Draw values [3, 256] of about two decades, times a scale."""
    rng = torch.Generator().manual_seed(seed)
    return scale * 10 ** (2 * torch.rand(3, 256, generator=rng) - 2)


def draw_input_and_fit(seed: int, scale: float) -> tuple[Tensor, Tensor]:
    """Draw an input and a fit of it."""
    given = draw_varied(seed, scale)
    return given * (1 + 0.1 * torch.randn(given.shape, generator=torch.Generator().manual_seed(seed))).clamp_min(
        0
    ), given


def plain(seed: int, noise: float = 0.0) -> Tensor:
    """Draw one colour, with noise."""
    rng = torch.Generator().manual_seed(seed)
    return torch.rand(3, 1, generator=rng).clamp_min(0.01) * (1 + noise * torch.rand(3, 256, generator=rng))


SOUND: dict[str, Callable[[int], tuple[Tensor, Tensor]]] = {
    "a good fit": lambda seed: draw_input_and_fit(seed, 1.0),
    "a good fit of black velvet": lambda seed: draw_input_and_fit(seed, 1e-3),
    "a good fit of a mirror": lambda seed: draw_input_and_fit(seed, 1e5),
    "a plain fit of chalk": lambda seed: (plain(seed), plain(seed)),
    "a plain fit of noisy chalk": lambda seed: (plain(seed), plain(seed, 0.08)),
    "a dark fit of a bright material": lambda seed: (draw_varied(seed, 0.01), draw_varied(seed)),
    "black of black": lambda seed: (torch.zeros(3, 9), torch.zeros(3, 9)),
}
COLLAPSED: dict[str, tuple[Callable[[int], tuple[Tensor, Tensor]], str]] = {
    "black": (lambda seed: (torch.zeros(3, 256), draw_varied(seed)), BLACK),
    "nearly black": (lambda seed: (draw_varied(seed, 1e-5), draw_varied(seed)), BLACK),
    "black of velvet": (lambda seed: (torch.zeros(3, 256), draw_varied(seed, 1e-3)), BLACK),
    "black of chalk": (lambda seed: (torch.zeros(3, 256), plain(seed)), BLACK),
    "plain": (lambda seed: (plain(seed), draw_varied(seed)), SAME),
    "plain of velvet": (lambda seed: (plain(seed), draw_varied(seed, 1e-3)), SAME),
}


@pytest.mark.parametrize("name", SOUND)
def test_sound_fits_get_no_warning(name: str) -> None:
    assert [collapsed_fit_warnings(*SOUND[name](seed)) for seed in SEEDS] == [[]] * len(SEEDS)


@pytest.mark.parametrize("name", COLLAPSED)
def test_collapsed_fits_get_a_warning(name: str) -> None:
    make, message = COLLAPSED[name]
    for seed in SEEDS:
        (clause,) = collapsed_fit_warnings(*make(seed))
        assert clause.startswith(message)
        assert ";" not in clause  # which parts the clauses of a record


def test_inputs_of_one_value_get_a_remark() -> None:
    for seed in SEEDS:
        (clause,) = uniform_input_remarks(plain(seed).expand(3, 256), "reflectance in 1/sr")
        assert clause.startswith("the input is one reflectance in 1/sr everywhere: 0.")
        assert uniform_input_remarks(plain(seed, 0.02), "reflectance") == []
        assert uniform_input_remarks(draw_varied(seed, 1e-4), "reflectance") == []
    assert uniform_input_remarks(torch.zeros(3, 9), "reflectance") == []  # which readers say
