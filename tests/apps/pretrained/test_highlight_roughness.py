"""The roughness that a sharp highlight shows, and how General's prediction of it is corrected."""

import math

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import interpolate

from metapp.appearance.flash import camera_distance
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_LOG_HEIGHT, decode_flash, render_photo
from metapp.apps.svbrdf_nonstationary.maps import MIN_ROUGHNESS, encode_roughness
from metapp.apps.svbrdf_nonstationary.pretrained.encoder import init_reader
from metapp.apps.svbrdf_nonstationary.pretrained.highlight_roughness import (
    describe_highlight,
    predict_roughness,
    roughness_shift,
    scale_roughness,
)
from metapp.learning.task import Params
from metapp.networks.coded import select_reader
from metapp.storage.checkpoint_files import read_entry
from metapp.storage.shipped_checkpoints import shipped_checkpoint_path


@pytest.fixture(scope="module")
def reader() -> Params:
    """The parameters of the checkpoint's encoder."""
    file = shipped_checkpoint_path("svbrdf_nonstationary", "pretrained")
    return select_reader(read_entry(file, "general-photo")[0].encoder)


def marble(roughness: float, seed: int, aside: float = 0.0, height: float = camera_distance()) -> Tensor:
    """A flash photograph [1, 3, 256, 256] of flat stone with a strong pattern, from a height in half sides."""
    rng = Generator().manual_seed(seed)
    coarse = sum(
        interpolate(torch.randn(1, 1, n, n, generator=rng), (256, 256), mode="bicubic") / n for n in (4, 9, 31)
    )
    veins = torch.exp(-((8 * coarse) ** 2))
    diffuse = 0.1 + torch.tensor([0.6, 0.45, 0.3])[:, None, None] * veins
    ones = torch.ones_like(veins)
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None] * ones
    maps = Maps(diffuse, 0.04 * ones.expand(-1, 3, -1, -1), roughness * ones, up)
    log_height = math.log(height / camera_distance()) / FLASH_LOG_HEIGHT
    flash = decode_flash(torch.tensor([[aside, 0.5 * aside, log_height, 0.0]]), camera="raised")
    return render_photo(maps, flash).clamp(0, 1)


@pytest.mark.parametrize("aside", [0.0, 1.0])
@pytest.mark.parametrize(("roughness", "most"), [(0.07, 0.15), (0.1, 0.2), (0.15, 0.2)])
def test_the_highlight_of_a_polished_pattern_is_sharp(
    reader: Params, roughness: float, most: float, aside: float
) -> None:
    """The median of ten patterns is tested.

    Sharp highlights may show up to twice the roughness, as mixed materials would.
    """
    photos = torch.cat([marble(roughness, seed, aside) for seed in range(10)])
    shown = predict_roughness(reader, describe_highlight(photos))
    assert 0.7 * roughness < float(shown.median()) < most
    assert float(shown.max()) < 0.3


def test_a_known_height_corrects_the_roughness_of_a_wider_highlight(reader: Params) -> None:
    """From twice as high a highlight is twice as wide; where the height is 0, it is unknown."""
    heights = torch.full((10,), 2 * camera_distance())
    photos = torch.cat([marble(0.1, seed, height=2 * camera_distance()) for seed in range(10)])
    usual = predict_roughness(reader, describe_highlight(torch.cat([marble(0.1, seed) for seed in range(10)])))
    shown = predict_roughness(reader, describe_highlight(photos))
    assert float(shown.median()) > 1.25 * float(usual.median())
    assert float(scale_roughness(shown, heights).median()) == pytest.approx(float(usual.median()), rel=0.15)
    assert torch.equal(scale_roughness(shown, torch.zeros(10)), shown)


def test_rough_patterns_are_not_taken_for_polished_ones(reader: Params) -> None:
    shown = predict_roughness(reader, describe_highlight(torch.cat([marble(0.6, seed) for seed in range(10)])))
    assert float(shown.min()) > 0.3
    torch.testing.assert_close(
        shifted_roughness(torch.full((10,), 0.6), shown), torch.full((10,), 0.6), atol=0.005, rtol=0
    )


def shifted_roughness(roughness: Tensor, shown: Tensor, slope: float = 0.0) -> Tensor:
    """The roughness [T] of even maps after the shift."""
    ones = torch.ones(len(roughness), 1, 2, 2)
    normal = torch.nn.functional.normalize(torch.cat([slope * ones, 0 * ones, ones], 1), dim=1)
    maps = Maps(ones.expand(-1, 3, -1, -1), ones.expand(-1, 3, -1, -1), roughness[:, None, None, None] * ones, normal)
    raw = ((roughness - MIN_ROUGHNESS) / (1 - MIN_ROUGHNESS)).logit()
    return MIN_ROUGHNESS + (1 - MIN_ROUGHNESS) * torch.sigmoid(
        raw + roughness_shift(shown, maps, torch.zeros(len(shown)))
    )


def test_roughness_moves_to_that_of_a_sharp_highlight_of_a_flat_surface_alone() -> None:
    mean, shown = torch.tensor([0.7, 0.7]), torch.tensor([0.08, 0.9])
    torch.testing.assert_close(shifted_roughness(mean, shown), torch.tensor([0.08, 0.7]), atol=0.005, rtol=0)
    torch.testing.assert_close(shifted_roughness(mean, shown, slope=0.1), mean, atol=0.005, rtol=0)


def test_a_known_height_changes_the_roughness_of_polished_surfaces_and_never_which_are_polished() -> None:
    ones = torch.ones(2, 1, 2, 2)
    up = torch.cat([0 * ones, 0 * ones, ones], 1)
    maps = Maps(ones.expand(-1, 3, -1, -1), ones.expand(-1, 3, -1, -1), 0.7 * ones, up)
    shown, true_roughness = torch.tensor([0.12, 0.9]), torch.tensor([0.08, 0.1])
    shift = roughness_shift(shown, maps, camera_distance() * (shown / true_roughness) ** 2)
    before, after = encode_roughness(torch.tensor([0.7, 0.08])).tolist()
    assert float(shift[0]) == pytest.approx(after - before, rel=0.02)
    assert abs(float(shift[1])) < 1e-3


def test_untrained_encoders_take_no_material_for_polished(rng: Generator) -> None:
    shown = predict_roughness(init_reader(rng, 5), describe_highlight(torch.rand(3, 3, 64, 64, generator=rng)))
    torch.testing.assert_close(shown, torch.ones(3))


def test_a_highlight_is_the_same_at_twice_the_resolution() -> None:
    photo = marble(0.1, 3)
    twice = photo.repeat_interleave(2, 2).repeat_interleave(2, 3)
    torch.testing.assert_close(describe_highlight(twice), describe_highlight(photo))
