"""Pictures by paths: the same mean whoever guides them, less noise where the guide is right."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from data_tools.synthetic.cornell import random_scene
from metapp.rendering.path_space import Guide, Tracer, reference, render
from metapp.rendering.scene_rules import scene_bytes, scene_of
from tests.needs_mitsuba import needs_mitsuba

pytestmark = needs_mitsuba

RUNS, SIZE, SPP = 8, 8, 512


def slope(film: Tensor) -> Tensor:
    """Of the guide's density over each number, by the place on the film, [N, 1] in [0, 1)."""
    return 0.95 * film[:, :1]


def density(film: Tensor, directions: Tensor) -> Tensor:
    """The product over the numbers of 1 + slope * (2 u - 1)."""
    return (1 + slope(film) * (2 * directions - 1)).prod(1)


def sloped(dimensions: int = 2) -> Guide:
    """A guide that knows nothing of the scene, with a closed form."""

    def sample(film: Tensor) -> tuple[Tensor, Tensor]:
        uniform, steep = torch.rand(len(film), dimensions), slope(film)
        # the inverse of u + slope * (u^2 - u), stable at a slope of 0
        root = ((1 - steep) ** 2 + 4 * steep * uniform).sqrt()
        directions = (2 * uniform / (1 - steep + root)).clamp(0, 1 - 1e-7)
        return directions, density(film, directions)

    return Guide(sample, density)


def means(tracer: Tracer, guide: Guide | None, runs: int = RUNS) -> Tensor:
    """Of the lower halves of several pictures, where the light itself is not seen, [runs]."""
    pictures = [render(tracer, SPP, SIZE, seed, guide)[:, SIZE // 2 :] for seed in range(runs)]
    return torch.stack([picture.mean() for picture in pictures]).double()


def deviation(first: Tensor, second: Tensor) -> float:
    """The difference of two means, in standard errors."""
    error = (first.var() / len(first) + second.var() / len(second)).sqrt()
    return float((first.mean() - second.mean()) / error)


@pytest.mark.parametrize("seed", range(5))
def test_a_guided_picture_has_the_same_mean(seed: int) -> None:
    tracer = Tracer(random_scene(seed))
    regular, guided = means(tracer, None), means(tracer, sloped(4 if seed == 4 else 2))
    assert abs(deviation(regular, guided)) < 3
    error = (regular.var() + guided.var()).sqrt() / math.sqrt(RUNS)
    assert float(error / regular.mean()) < 0.04  # or the above would say little


def corner(stated: float) -> Guide:
    """A guide whose directions all lie in one corner, of density 16, and the density it states."""

    def sample(film: Tensor) -> tuple[Tensor, Tensor]:
        return 0.25 * torch.rand(len(film), 2), torch.full((len(film),), stated)

    return Guide(sample, lambda film, directions: stated * (directions < 0.25).all(1).float())


def test_a_guide_that_leaves_out_the_light_costs_no_light_unless_it_is_wrong_about_itself() -> None:
    tracer = Tracer(random_scene(1))
    regular = means(tracer, None)
    assert abs(deviation(regular, means(tracer, corner(16.0)))) < 3
    assert abs(deviation(regular, means(tracer, corner(1.0)))) > 3


def test_the_reference_is_what_pictures_tend_to() -> None:
    tracer = Tracer(random_scene(3))
    ours = torch.stack([render(tracer, 256, SIZE, seed) for seed in range(RUNS)]).double()
    theirs = torch.stack([reference(tracer, SIZE, 128, seed) for seed in range(RUNS)]).double()
    assert abs(deviation(ours.mean((1, 2, 3)), theirs.mean((1, 2, 3)))) < 3
    errors = (ours.var(0) / RUNS + theirs.var(0) / RUNS).sqrt()
    assert float(((ours - theirs).mean(0) / errors).abs().median()) < 1.2  # pixel by pixel
    dark = ours.mean((0, 1)) < ours.mean((0, 1)).median()
    assert float(theirs.var(0).sum(0)[dark].median()) < float(ours.var(0).sum(0)[dark].median()) / 4


def test_a_picture_depends_on_the_seed_alone() -> None:
    scene = random_scene(2)
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    first = render(scene, 4, 16, 7, sloped())
    assert torch.equal(torch.rand(3), expected)  # of others
    assert first.shape == (3, 16, 16)
    assert first.dtype is torch.float32
    assert torch.equal(first, render(scene_of(scene_bytes(scene)), 4, 16, 7, sloped()))
    assert not torch.equal(first, render(scene, 4, 16, 8, sloped()))


def test_pixels_are_where_they_belong() -> None:
    # the light hangs below the ceiling, in the upper half; a picture in pieces is the picture
    picture = render(random_scene(1), 16, 32, 0)
    brightest = int(picture.sum(0).argmax())
    assert brightest // 32 < 12
    light = torch.tensor(random_scene(1)["light"]["to_world"])[:3, 3]
    column = (0.5 + 0.5 * light[0] / ((3.9 - light[2]) * math.tan(math.radians(19)))) * 32
    assert abs(brightest % 32 - float(column)) < 6


@pytest.mark.parametrize(("spp", "size"), [(0, 8), (1, 0)])
def test_empty_pictures_are_refused(spp: int, size: int) -> None:
    with pytest.raises(ValueError, match="expected 1 or more of both"):
        render(random_scene(0), spp, size)
