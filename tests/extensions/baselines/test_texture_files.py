"""Files of textures by methods without a network, where fits are pieces of the photograph itself."""

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d

from metapp.appearance.assets import Texture
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.texture.app import compose_texture
from metapp.extensions.baselines.baseline import BaselineFit, CostLimits
from metapp.extensions.baselines.texture import Blending, Quilting
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task
from metapp.networks.quilted import LightGrid
from tests.recipe_apps import app_by_recipe

APP = compose_texture(LightGrid(8, 8), Octaves(64, 64, ("relu1_1", "relu2_1"), count=2), candidates=1)
PHOTO_SIDE = 192  # three px for each px of the exemplar
METHODS = (Quilting, Blending)


def draw_checks(side: int, check: int, slope: float = 0.0) -> Tensor:
    """Draw checks of noise, each so many px wide, under light that rises from left to right, uint8 [3, side, side]."""
    checks = 0.3 + 0.4 * torch.rand(3, side // check, side // check, generator=Generator().manual_seed(0))
    picture = checks.repeat_interleave(check, 1).repeat_interleave(check, 2)
    return (255 * (picture + slope * torch.linspace(-1, 1, side))).round().to(torch.uint8)


def fit(method: type[Quilting | Blending], image: Tensor, app: object = APP) -> BaselineFit:
    tasks = stack_tasks(app, [Task("checks", {"image": image})])  # type: ignore[arg-type]
    return method(app).fit(tasks, Generator().manual_seed(0), CostLimits(64, 1))  # type: ignore[arg-type]


def draw_file(method: type[Quilting | Blending], image: Tensor, size: tuple[int, int] | None = None) -> Tensor:
    """Return the picture [3, H, W] of a file."""
    fitted = fit(method, image)
    assert fitted.asset is not None
    texture = fitted.asset(Task("checks", {}), size)
    assert isinstance(texture, Texture)
    assert 0 <= float(texture.pixels.min()) <= float(texture.pixels.max()) <= 1
    return texture.pixels


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("size", [None, (192, 192), (100, 300), (16, 20)])
def test_files_have_the_asked_size_and_tile(method: type[Quilting], size: tuple[int, int] | None) -> None:
    picture = draw_file(method, draw_checks(PHOTO_SIDE, 6), size)
    assert picture.shape == (3, *(size or (PHOTO_SIDE, PHOTO_SIDE)))
    for axis in (1, 2):
        steps = (picture - picture.roll(1, axis)).abs().mean((0, 3 - axis))
        assert float(steps[0]) < 1.5 * float(steps[1:].max())


@pytest.mark.parametrize("size", [None, (384, 288)])
def test_quilts_are_copies_at_the_resolution_of_the_photo(size: tuple[int, int] | None) -> None:
    """Most windows of a file, finer than an exemplar shows, stand in the photograph without its slow light."""
    image = draw_checks(PHOTO_SIDE, 6)
    picture, photo = draw_file(Quilting, image, size), APP.judge.take_even_photo(image)
    windows = photo.unfold(1, 9, 1).unfold(2, 9, 1).permute(1, 2, 0, 3, 4).flatten(2).flatten(0, 1)
    rng = Generator().manual_seed(1)
    rows, columns = (torch.randint(side - 9, (60,), generator=rng).tolist() for side in picture.shape[1:])
    copies = 0
    for row, column in zip(rows, columns, strict=True):
        window = picture[:, row : row + 9, column : column + 9].flatten()
        copies += float((windows - window).abs().mean(1).min()) < 0.02
    assert copies > 30


@pytest.mark.parametrize("method", METHODS)
def test_slow_changes_of_light_are_subtracted(method: type[Quilting]) -> None:
    """Under light that rises, files are as those of the photograph under even light, but for other draws."""
    even, uneven = (draw_file(method, draw_checks(PHOTO_SIDE, 6, slope)) for slope in (0, 0.25))
    spreads = [float(avg_pool2d(picture, 32).std()) for picture in (even, uneven)]
    assert spreads[1] < 1.3 * spreads[0]


@pytest.mark.parametrize("method", METHODS)
def test_judged_pictures_have_the_size_of_exemplars(method: type[Quilting]) -> None:
    fitted = fit(method, draw_checks(PHOTO_SIDE, 6))
    prediction = fitted.prediction()
    assert isinstance(prediction, Tensor)
    assert prediction.shape == (1, 4, 3, 64, 64)
    assert fitted.kept_numbers == 3 * 64 * 64


@pytest.mark.parametrize("method", METHODS)
def test_files_of_other_networks_have_the_size_of_exemplars(method: type[Quilting]) -> None:
    fitted = fit(method, draw_checks(PHOTO_SIDE, 6), app_by_recipe("texture"))
    assert fitted.asset is not None
    texture = fitted.asset(Task("checks", {}), None)
    assert isinstance(texture, Texture)
    assert texture.size == (64, 64)
