"""Histogram-preserving blending: what pictures keep of an exemplar (colours, grain), and what they lose (order)."""

from typing import cast

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, pad

from metapp.appearance.lattice import find_lattice, kept_order_share
from metapp.apps.texture.app import Texture
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import BaselineFit, CostLimits
from metapp.extensions.baselines.blending import ColourDistribution, blend_tile, find_triangle
from metapp.extensions.baselines.texture import quilt_tile
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task, Tasks
from tests.recipe_apps import app_by_recipe, application

SIDE = 128


def draw_clouds(side: int = SIDE, smooth_px: int = 3) -> Tensor:
    """Draw noise that is smoothed over so many px, of skewed and correlated colours, [3, side, side]."""
    noise = torch.rand(3, side, side, generator=Generator().manual_seed(3))
    padded = pad(noise[None], (smooth_px // 2,) * 4, mode="circular")
    smooth = avg_pool2d(padded, smooth_px, 1)[0]
    smooth = ((smooth - smooth.mean()) / smooth.std() / 6 + 0.5).clamp(0, 1)
    first, second, third = smooth
    return torch.stack([first**2, 0.6 * first**2 + 0.4 * second**3, 0.3 * third + 0.2 * first])


def draw_bricks(side: int) -> Tensor:
    """Draw courses of bricks 32 px wide and 16 px high, each other one moved by half a brick, [3, side, side]."""
    at = torch.arange(side)
    moved = at[None] + 16 * (at[:, None] // 16 % 2)
    joints = (at[:, None] % 16 < 3) | (moved % 32 < 3)
    return torch.where(joints, 0.2, 0.7).expand(3, -1, -1)


def blend(exemplar: Tensor, size: tuple[int, int] = (2 * SIDE, 2 * SIDE), seed: int = 0) -> Tensor:
    return blend_tile(exemplar, size, Generator().manual_seed(seed))


def colour_shares(picture: Tensor) -> Tensor:
    """Return the shares of px of each channel that are below quantiles of the clouds, [3, 9]."""
    levels = draw_clouds().flatten(1).quantile(torch.arange(1, 10) / 10, 1).T
    return (picture.flatten(1)[:, None] <= levels[..., None]).float().mean(-1)


def test_colours_keep_their_histogram_mean_and_covariance() -> None:
    exemplar = draw_clouds()
    picture = blend(exemplar)
    torch.testing.assert_close(colour_shares(picture), colour_shares(exemplar), atol=0.03, rtol=0)
    torch.testing.assert_close(picture.mean((1, 2)), exemplar.mean((1, 2)), atol=0.01, rtol=0)
    scale = exemplar.flatten(1).var(1).mean()
    torch.testing.assert_close(picture.flatten(1).cov() / scale, exemplar.flatten(1).cov() / scale, atol=0.06, rtol=0)


def test_normal_numbers_are_normal_and_map_back() -> None:
    exemplar = draw_clouds()
    distribution = ColourDistribution.of(exemplar)
    normal = distribution.to_normal(exemplar)
    torch.testing.assert_close(normal.flatten(1).var(1), torch.ones(3), atol=0.01, rtol=0)
    expected = torch.special.ndtr(torch.tensor([-1.0, 0.0, 2.0]))
    for values in normal.flatten(1):
        shares = torch.stack([(values <= level).float().mean() for level in (-1, 0, 2)])
        torch.testing.assert_close(shares, expected, atol=1e-3, rtol=0)
    torch.testing.assert_close(distribution.to_colours(normal), exemplar, atol=1e-5, rtol=0)


def test_equal_colours_get_equal_normal_numbers() -> None:
    exemplar = draw_clouds().clamp_min(0.3)
    normal = ColourDistribution.of(exemplar).to_normal(exemplar)
    clipped = (exemplar == 0.3).all(0)
    assert int(clipped.sum()) > 100
    assert float(normal[:, clipped].std(1).max()) < 1e-5


def test_normal_numbers_of_the_largest_photographs_are_finite() -> None:
    """The highest of 4096 x 4096 values has a rank that single precision rounds to the end of the distribution."""
    values = torch.linspace(0, 1, 4096**2, dtype=torch.float64)
    zeros, axes = torch.zeros(3, dtype=torch.float64), torch.eye(3, dtype=torch.float64)
    distribution = ColourDistribution(zeros, axes, values.repeat(3, 1))
    normal = distribution.to_normal(torch.tensor([0.0, 0.5, 1.0]).expand(3, 1, 3))
    assert normal.isfinite().all()
    torch.testing.assert_close(normal[..., 0], -normal[..., 2], atol=1e-3, rtol=0)


def test_an_even_picture_stays_even() -> None:
    colour = torch.tensor([0.7, 0.3, 0.1])[:, None, None]
    torch.testing.assert_close(blend(colour.expand(-1, SIDE, SIDE), (90, 150)), colour.expand(-1, 90, 150))


@pytest.mark.parametrize("size", [(128, 128), (101, 77), (16, 300), (45, 31)])
def test_any_size_goes_on_across_its_edges(size: tuple[int, int]) -> None:
    """Opposite edges of many pictures differ by no more than neighbouring rows and columns inside."""
    exemplar, rng = draw_clouds(smooth_px=9), Generator().manual_seed(0)
    pictures = torch.stack([blend_tile(exemplar, size, rng) for _ in range(16)])
    assert pictures.shape == (16, 3, *size)
    for axis in (-1, -2):
        steps = (pictures - pictures.roll(1, axis)).abs().mean((0, 1, -1 if axis == -2 else -2))
        assert float(steps[0]) < 1.25 * float(steps[1:].mean())


def test_patches_are_exact_copies_at_vertices() -> None:
    """A pixel at a vertex has a colour of the exemplar; strips do not show."""
    exemplar = draw_clouds()
    whole = blend(exemplar, (120, 128))  # rows of vertices 20 px apart, in each of them one every 32 px
    assert torch.equal(blend_tile(exemplar, (120, 128), Generator().manual_seed(0), strip_rows=7), whole)
    for row, column in ((0, 0), (0, 64), (40, 32), (20, 16), (60, 112)):
        assert float((exemplar - whole[:, row, column, None, None]).abs().sum(0).min()) < 1e-5


def test_triangles_hold_their_points(rng: Generator) -> None:
    """Barycentric coordinates lie in [0, 1], sum to 1 and give the point back."""
    y, x = 5 * torch.rand(20, 1, generator=rng), 5 * torch.rand(1, 30, generator=rng)
    rows, columns, weights = (torch.stack(parts) for parts in zip(*find_triangle(y, x), strict=True))
    assert float(weights.min()) >= 0
    torch.testing.assert_close(weights.sum(0), torch.ones(20, 30))
    torch.testing.assert_close((weights * rows).sum(0), y.expand(20, 30))
    torch.testing.assert_close((weights * (columns + rows / 2)).sum(0), x.expand(20, 30), atol=1e-5, rtol=0)


def test_a_seed_makes_one_picture_and_another_seed_another() -> None:
    exemplar = draw_clouds()
    first, same, other = (blend(exemplar, seed=seed) for seed in (0, 0, 1))
    assert torch.equal(first, same)
    assert float((first - other).abs().mean()) > 0.3 * float((exemplar - exemplar.roll(40, 1)).abs().mean())


def test_order_is_lost_that_quilting_keeps() -> None:
    bricks, size = draw_bricks(SIDE), (2 * SIDE, 2 * SIDE)
    lattice = find_lattice(bricks)
    assert kept_order_share(lattice, blend(bricks, size)) < 0.4
    assert kept_order_share(lattice, quilt_tile(bricks, size, Generator().manual_seed(0))) > 0.8


# The method


@pytest.fixture(scope="module")
def app() -> Texture:
    return cast("Texture", app_by_recipe("texture"))


def fit(app: Texture, method: str, tasks: Tasks) -> BaselineFit:
    (baseline,) = [baseline for baseline in baselines_of(application(app.name), app) if baseline.name == method]
    return baseline.fit(tasks, Generator().manual_seed(0), CostLimits(64, 1))


def errors_of(app: Texture, exemplar: Tensor) -> dict[str, float]:
    """Return the errors of blending and quilting an exemplar, by method."""
    tasks = stack_tasks(app, [Task("exemplar", {"image": (255 * exemplar).round().to(torch.uint8)})])
    with torch.no_grad():
        return {
            method: float(app.errors_of(fit(app, method, tasks).prediction(), tasks)["error"])
            for method in ("blending", "quilting")
        }


def test_errors_are_level_with_quilting_on_noise_and_higher_on_bricks(app: Texture) -> None:
    noise, bricks = (
        errors_of(app, draw_clouds(app.decoder.octaves.width, 1)),
        errors_of(app, draw_bricks(app.decoder.octaves.width)),
    )
    assert noise["blending"] == pytest.approx(noise["quilting"], rel=0.25)
    assert bricks["blending"] > 1.2 * bricks["quilting"]


def test_a_fit_keeps_the_exemplar_and_makes_any_size(app: Texture) -> None:
    image = (255 * draw_clouds(app.decoder.octaves.width)).to(torch.uint8)
    blending = fit(app, "blending", stack_tasks(app, [Task("clouds", {"image": image})]))
    assert blending.kept_numbers == blending.kept_bytes == image.numel()
    assert blending.asset is not None
    task = Task("clouds", {})
    assert [blending.asset(task, size).size for size in (None, (40, 70))] == [image.shape[1:], (40, 70)]  # type: ignore[attr-defined]
