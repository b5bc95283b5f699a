"""Whether pictures break the lines of their exemplars or show seams: drawn textures, most of them without a lattice."""

import functools
import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, grid_sample, interpolate

from data_tools.synthetic.texture import synthetic_tasks
from metapp.appearance.doubts import BROKEN_LINES_OF_TEXTURE
from metapp.appearance.lines import SMALLEST_SIDE_PX, compare_lines

SIDE = 256


def noise(rng: Generator, blur: int, side: int = 2 * SIDE) -> Tensor:
    """Return noise [side, side] of mean 0 and deviation 1, smooth at a scale in px."""
    fine = torch.randn(side, side, generator=rng)
    down, across = torch.fft.fftfreq(side)[:, None], torch.fft.rfftfreq(side)
    smooth = (-0.5 * (math.tau * blur) ** 2 * (down.square() + across.square())).exp()
    fine = torch.fft.irfft2(torch.fft.rfft2(fine) * smooth, s=(side, side))
    return (fine - fine.mean()) / fine.std()


def places(side: int = 2 * SIDE) -> tuple[Tensor, Tensor]:
    """Return the rows and columns of the texels of a picture."""
    y, x = torch.meshgrid(torch.arange(side).float(), torch.arange(side).float(), indexing="ij")
    return y, x


def planks(rng: Generator) -> Tensor:
    """Return boards of unlike widths with dark joints and grain along them."""
    y, x = places()
    x = x + 1.5 * noise(rng, 40)
    edges = torch.cumsum(14 + 22 * torch.rand(60, generator=rng), 0)
    joint = (x[..., None] - edges).abs().amin(-1) < 1.2
    board = 0.08 * torch.randn(61, generator=rng)[torch.searchsorted(edges, x.contiguous())]
    grain = avg_pool2d(torch.randn(1, 1, 2 * SIDE, 2 * SIDE, generator=rng), (41, 1), 1, (20, 0))[0, 0]
    return (0.5 + board + 0.25 * grain).where(~joint, torch.tensor(0.15)) + 0.01 * torch.randn(y.shape, generator=rng)


def cells(rng: Generator, width: float = 1.6) -> Tensor:
    """Return mud that cracks along the borders of the regions nearest to points, one in each square at random."""
    y, x = places()
    y, x = y + 3 * noise(rng, 6), x + 3 * noise(rng, 6)
    squares = torch.cartesian_prod(torch.arange(16.0), torch.arange(16.0))
    points = 2 * SIDE / 16 * (squares + torch.rand(256, 2, generator=rng))
    distances = ((y[..., None] - points[:, 0]) ** 2 + (x[..., None] - points[:, 1]) ** 2).sqrt()
    nearest = distances.topk(2, -1, largest=False).values
    crack = (nearest[..., 1] - nearest[..., 0]) < 2 * width
    return (0.6 + 0.05 * noise(rng, 2)).where(~crack, torch.tensor(0.15)) + 0.02 * noise(rng, 0)


def knit(rng: Generator) -> Tensor:
    """Return columns of V-shaped stitches, whose phase and brightness vary."""
    y, x = places()
    x = x + 2 * noise(rng, 30)
    across = (x % 14) - 7
    stitches = torch.sin(2 * math.pi * (y - 1.4 * across.abs() + 2 * noise(rng, 20)) / 9)
    return 0.5 + 0.15 * stitches.clamp(-0.6, 0.6) * (1 + 0.3 * noise(rng, 4)) + 0.03 * noise(rng, 1)


def threads(rng: Generator) -> Tensor:
    """Return crossed threads of unlike brightness and widths, as of linen."""
    rows = avg_pool2d(torch.randn(1, 1, 2 * SIDE, 1, generator=rng), (3, 1), 1, (1, 0))[0, 0]
    columns = avg_pool2d(torch.randn(1, 1, 1, 2 * SIDE, generator=rng), (1, 3), 1, (0, 1))[0, 0]
    return 0.5 + 0.1 * (rows + columns) + 0.02 * noise(rng, 0)


def scratches(rng: Generator) -> Tensor:
    """Return metal with straight scratches in all directions."""
    y, x = places()
    picture = 0.5 + 0.02 * noise(rng, 0)
    for _ in range(160):
        top, left, angle, length = (torch.rand(4, generator=rng) * torch.tensor([512, 512, math.pi, 80])).tolist()
        along = (x - left) * math.cos(angle) + (y - top) * math.sin(angle)
        across = (y - top) * math.cos(angle) - (x - left) * math.sin(angle)
        picture = picture + 0.25 * (-across.square()).exp() * (along.abs() < 30 + length)
    return picture


def spots(rng: Generator) -> Tensor:
    """Return gravel: blobs without lines."""
    return 0.5 + 0.12 * noise(rng, 3) + 0.03 * noise(rng, 1)


LINES = {"planks": planks, "cells": cells, "knit": knit, "threads": threads, "scratches": scratches}
KINDS = LINES | {"spots": spots}


@functools.cache
def draw_exemplar(name: str, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Return an exemplar [3, SIDE, SIDE] and another part of the same drawing, of the same size."""
    whole = KINDS[name](Generator().manual_seed(seed)).clamp(0, 1).expand(3, -1, -1)
    return whole[:, :SIDE, :SIDE], whole[:, SIDE:, SIDE:]


def chop_and_blend(exemplar: Tensor, rng: Generator, side: int = 16) -> Tensor:
    """Return pieces of an exemplar in another order, blended where they meet, so that lines end without seams."""
    moves = side * (torch.rand(1, 2, SIDE // side, SIDE // side, generator=rng) - 0.5)
    shift = interpolate(moves, size=(SIDE, SIDE), mode="nearest")
    shift = avg_pool2d(shift, 5, 1, 2, count_include_pad=False)[0].movedim(0, -1)
    y, x = places(SIDE)
    grid = (torch.stack([x, y], -1) + shift + 0.5) * 2 / SIDE - 1
    return grid_sample(exemplar[None], grid[None], padding_mode="reflection", align_corners=False)[0]


def scatter_phases(exemplar: Tensor, rng: Generator) -> Tensor:
    """Return noise of an exemplar's spectrum: each wave is there, at another place."""
    phases = torch.fft.rfft2(torch.randn(SIDE, SIDE, generator=rng))
    mean = exemplar.mean((1, 2), keepdim=True)
    spectrum = torch.fft.rfft2(exemplar - mean).abs() * phases / phases.abs().clamp_min(1e-6)
    return torch.fft.irfft2(spectrum, s=(SIDE, SIDE)) + mean


SEEDS = (0, 1, 2)
LIKE = ("planks", "cells", "knit", "spots")  # whose parts are alike; threads and scratches differ from place to place


def is_doubted(exemplar: Tensor, picture: Tensor) -> bool:
    """Return True if fits would say that a texture breaks lines."""
    return compare_lines(exemplar, picture) < BROKEN_LINES_OF_TEXTURE.limit


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", LIKE)
def test_another_part_of_a_texture_is_intact(name: str, seed: int) -> None:
    assert not is_doubted(*draw_exemplar(name, seed))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", [*LIKE, "threads"])
def test_a_texture_that_is_moved_and_repeated_is_intact(name: str, seed: int) -> None:
    """Seen past its edges, where it does not meet itself; also of four times the size."""
    exemplar, _ = draw_exemplar(name, seed)
    assert not is_doubted(exemplar, exemplar.roll((90, 70), (1, 2)))
    assert not is_doubted(exemplar, exemplar.roll((90, 70), (1, 2)).repeat(1, 2, 2))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", LINES)
def test_broken_lines_are_detected(name: str, seed: int) -> None:
    exemplar, _ = draw_exemplar(name, seed)
    assert is_doubted(exemplar, chop_and_blend(exemplar, Generator().manual_seed(seed)))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", ["planks", "cells", "scratches"])
def test_noise_of_the_same_spectrum_is_detected(name: str, seed: int) -> None:
    """Joints, cracks and scratches become noise, though no wave is stronger or weaker."""
    exemplar, _ = draw_exemplar(name, seed)
    assert is_doubted(exemplar, scatter_phases(exemplar, Generator().manual_seed(seed)))


@pytest.mark.parametrize("change", [chop_and_blend, scatter_phases])
def test_textures_without_lines_get_no_warning(change: Callable[[Tensor, Generator], Tensor]) -> None:
    for seed in SEEDS:
        exemplar, _ = draw_exemplar("spots", seed)
        assert not is_doubted(exemplar, change(exemplar, Generator().manual_seed(seed)))


def test_synthetic_photographs_are_intact_as_they_are_and_broken_in_pieces() -> None:
    for task in synthetic_tasks("test", 12, 3):
        exemplar = torch.from_numpy(np.asarray(task.data["image"])) / 255
        assert not is_doubted(exemplar, exemplar.roll((90, 70), (1, 2))), task.name
        if task.name.startswith(("bricks", "wood", "tiles", "knit")):
            assert is_doubted(exemplar, chop_and_blend(exemplar, Generator().manual_seed(0))), task.name


def test_small_pictures_and_flat_exemplars_get_no_warning() -> None:
    exemplar, other = draw_exemplar("planks")
    small = other[:, : SMALLEST_SIDE_PX - 1]
    flat = torch.full_like(exemplar, 0.4)
    for pair in ((exemplar, small), (small, exemplar), (flat, exemplar), (flat, flat)):
        assert math.isnan(compare_lines(*pair))
    assert is_doubted(exemplar, flat)
