"""Textures: what is compared, what is made up for training, that fits learn, and that what they make tiles."""

from dataclasses import replace

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import interpolate, pad

from metapp.appearance.picture_measures import measure_pictures
from metapp.appearance.pictures import TimedFit
from metapp.apps.exemplar.exemplar_sight import JUDGED_PICTURES, crop_at_random
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.texture.app import MIN_CROP_SHARE, GramStatistics, Texture, compose_texture
from metapp.apps.texture.texture_codec import TextureAnswer, TextureDecoder
from metapp.learning.app import stack_tasks
from metapp.learning.task import Params, Task, Tasks
from metapp.networks.generators import UNet
from tests.recipe_apps import presenter_of

SIZE, LEVELS = 32, 3
NETWORK, TAPS = UNet(8, LEVELS, noise=4, code=8), ("relu1_1", "relu2_1")
TINY = compose_texture(NETWORK, Octaves(SIZE, SIZE, TAPS))


def seeded(seed: int = 0) -> Generator:
    return Generator().manual_seed(seed)


def wavy(sharpness: float, seed: int, size: int = 64) -> Tensor:
    """A picture [3, size, size] of blobs in two colours that tiles."""
    rng = seeded(seed)
    coarse = pad(torch.randn(1, 1, size // 4, size // 4, generator=rng), (2, 2, 2, 2), mode="circular")
    smooth = interpolate(coarse, scale_factor=4, mode="bicubic")[0, 0, 8:-8, 8:-8]
    first, second = torch.rand(2, 3, 1, 1, generator=rng)
    return torch.lerp(first, second, torch.sigmoid(sharpness * smooth))


def stripes(size: int = 64) -> Tensor:
    at = torch.arange(size) * (8 * torch.pi / size)
    wave = 0.5 + 0.5 * (at[:, None] + 2 * at).sin()
    return torch.stack([wave, 0.3 + 0.4 * wave, 1 - wave])


def pavement(size: int = 64) -> Tensor:
    at = torch.arange(size) % 8 < 2
    joint = (at[:, None] | at).float()
    return torch.stack([0.2 + 0.6 * joint, torch.full_like(joint, 0.5), 0.8 - 0.6 * joint])


@pytest.fixture(scope="module")
def sources() -> list[Task]:
    pictures = {"soft": wavy(3, 1), "hard": wavy(8, 2), "stripes": stripes(), "paving": pavement()}
    return [Task(name, {"image": (255 * picture).to(torch.uint8)}) for name, picture in pictures.items()]


@pytest.fixture(scope="module")
def tasks(sources: list[Task]) -> Tasks:
    return stack_tasks(TINY, sources)


# What is compared


def test_errors_are_of_textures_that_no_fit_has_seen(tasks: Tasks) -> None:
    app = TINY
    theta = app.init(seeded(), 4)
    errors = app.errors(theta, tasks)["error"]
    alone = {key: value[2:3] for key, value in theta.items()}
    noise = torch.randn(1, JUDGED_PICTURES, app.decoder.noise_channels, SIZE, SIZE, generator=seeded())
    batch = app.sample(tasks.select([2]), seeded(5), 1) | {"noise": noise}
    torch.testing.assert_close(app.loss(alone, batch, {}), errors[2:3])


# What is made up for training


class Exemplars(GramStatistics):
    """Exemplars themselves instead of what describes them."""

    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        return {"exemplar": exemplars} | {f"gram{i}": exemplars for i in range(self.octaves.count_maps(octave))}


def variants(image: Tensor, count: int = 40, min_crop_share: float = MIN_CROP_SHARE) -> Tensor:
    """Variants [count, 3, 16, 16] of an image [3, S, S]."""
    statistics = Exemplars(Octaves(16, 16, TAPS))
    app = replace(TINY, sight=replace(TINY.sight, statistics=statistics, min_crop_share=min_crop_share))
    task = Task("a", {"image": (255 * image).round().to(torch.uint8)})
    tasks = stack_tasks(app, [task]).select([0] * count)
    return app.augment(tasks, seeded()).data["exemplar"]


def test_variants_permute_the_channels_and_no_more() -> None:
    colour = torch.tensor([0.2, 0.4, 0.8])
    result = variants(colour[:, None, None].expand(3, 32, 32)).mean((2, 3))
    torch.testing.assert_close(result.sort(1).values, colour.expand(40, 3), rtol=0, atol=0.5 / 255)
    assert len(result.round(decimals=2).unique(dim=0)) == 6  # every permutation comes


def test_variants_are_flipped_and_transposed() -> None:
    """What is brightest at the upper left comes at every corner, and turned over its diagonal."""
    image = torch.full((3, 16, 16), 0.2)
    image[:, :2, :6] = 1.0  # lies along the upper edge
    result = variants(image, min_crop_share=1.0)[:, 0]
    corners = torch.stack([result[:, y : y + 2, x : x + 2].mean((1, 2)) for y in (0, 14) for x in (0, 14)], 1) > 0.9
    assert (corners.sum(1) == 1).all()
    assert corners.any(0).tolist() == [True, True, True, False]  # flips go left to right, before the transposition
    lying = (result > 0.9).any(1).sum(1) == 6
    assert 5 < lying.sum() < 35
    torch.testing.assert_close(result.mean((1, 2)), torch.full((40,), image.mean().item()), rtol=0, atol=1e-3)


def test_crops_are_squares_of_at_least_half_the_side() -> None:
    at = torch.arange(64.0)
    image = torch.stack([at.expand(64, 64), at[:, None].expand(64, 64), torch.zeros(64, 64)])
    rng, sides, corners = seeded(), [], []
    for _ in range(200):
        part = crop_at_random(image, TINY.sight.min_crop_share, rng)
        side = part.shape[1]
        assert part.shape == (3, side, side)
        left, top = int(part[0, 0, 0]), int(part[1, 0, 0])
        assert torch.equal(part, image[:, top : top + side, left : left + side])
        sides.append(side)
        corners.append((left, top, 64 - left - side, 64 - top - side))
    assert min(sides) in range(round(MIN_CROP_SHARE * 64), round(MIN_CROP_SHARE * 64) + 3)
    assert max(sides) >= 62
    assert torch.tensor(corners).amin(0).tolist() == [0, 0, 0, 0]
    assert torch.tensor(corners).amax(0).min() > 20


# Fitting, and what fits make


def test_order_is_measured_where_the_exemplar_has_some() -> None:
    """1 for the exemplar itself, about 0 for noise, nothing for an exemplar without order."""
    app = compose_texture(NETWORK, Octaves(64, 64, TAPS))

    def showing(picture: Tensor) -> Texture:
        class Shown(TextureDecoder):
            def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> TextureAnswer:
                return TextureAnswer(picture[None, None])

        return replace(app, decoder=Shown(**vars(app.decoder)))

    fits = {"a": TimedFit({"z": torch.zeros(8)}, 0.0)}
    paving = pavement().repeat(1, 2, 2)[:, :64, :64]
    for result, expected in ((paving, 1.0), (torch.rand(3, 64, 64, generator=seeded()), 0.0)):
        task = Task("paving", {"image": (255 * paving).to(torch.uint8)})
        measured = measure_pictures(presenter_of(showing(result)), fits, task)
        assert measured["a"]["order"] == pytest.approx(expected, abs=0.25)
    noise = torch.randint(256, (3, 64, 64), generator=seeded(1), dtype=torch.uint8)
    disorder = measure_pictures(presenter_of(showing(noise / 255)), fits, Task("noise", {"image": noise}))
    assert "order" not in disorder["a"]
