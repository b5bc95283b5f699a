"""Where a photo's flash was."""

import pytest
import torch

from metapp.appearance.colour import radiance_to_display
from metapp.appearance.flash import camera_position, render_maps, texel_positions
from metapp.appearance.flash_search import estimate_flash_position
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.svbrdf_maps import Maps
from tests.surfaces import flat_maps


def textured_material(rng: torch.Generator, specular: float, roughness: float, contrast: float, blob: int = 1) -> Maps:
    """A material of 128 by 128 texels whose albedo and normals vary, in blobs of so many texels."""
    noise = torch.randn(1, 1, 128 // blob, 128 // blob, generator=rng).repeat_interleave(blob, -1)
    albedo = (0.25 * (contrast * noise.repeat_interleave(blob, -2)).exp()).clamp(0, 1)
    bumps = torch.randn(1, 1, 128, 128, generator=rng) * (0.1 if contrast > 0 else 0)
    constant = torch.ones(1, 1, 128, 128)
    return Maps(albedo.expand(-1, 3, -1, -1), constant * specular, constant * roughness, normal_from_height(bumps))


PLACES = ((0.0, 0.0), (0.2, 0.1), (-0.3, 0.2), (0.1, -0.4))


@pytest.mark.parametrize(
    ("specular", "roughness", "contrast", "blob", "tolerance"),
    [
        (0.04, 0.12, 0, 1, 0.02),  # a spot as of polish
        (0.04, 0.35, 0, 1, 0.02),
        (0.3, 0.5, 0, 1, 0.02),  # metallic
        (0.0, 0.9, 0, 1, 0.04),  # matte: only the fall-off tells
        (0.04, 0.12, 0.4, 1, 0.06),
        (0.04, 0.35, 0.4, 4, 0.1),
        (0.3, 0.5, 0.8, 8, 0.06),  # one deviation of its albedo is a factor of 2.2
        (0.0, 0.9, 0.4, 1, 0.1),
    ],
)
def test_the_flash_is_found(
    specular: float, roughness: float, contrast: float, blob: int, tolerance: float, rng: torch.Generator
) -> None:
    maps = textured_material(rng, specular, roughness, contrast, blob)
    for x, y in PLACES:
        above = camera_position() + torch.tensor([x, y, 0])
        photo = radiance_to_display(render_maps(maps, texel_positions(128, 128), above, above, intensity=1.2))
        assert (estimate_flash_position(photo)[0] - above[:2]).norm() < tolerance


def test_flash_positions_of_wide_photos_and_of_batches(rng: torch.Generator) -> None:
    maps = textured_material(rng, 0.04, 0.3, 0.2)
    lights = camera_position() + torch.tensor([[0.2, -0.1, 0.0], [-0.3, 0.3, 0.0]])
    photos = radiance_to_display(render_maps(maps, texel_positions(128, 128), lights, lights))
    found = estimate_flash_position(photos)
    assert found.shape == (2, 2)
    torch.testing.assert_close(found, torch.stack([estimate_flash_position(photo) for photo in photos]))
    wide = radiance_to_display(
        render_maps(Maps(*(torch.cat([m, m], -1) for m in maps)), texel_positions(128, 256), lights, lights)
    )
    torch.testing.assert_close(estimate_flash_position(wide), lights[:, :2], rtol=0, atol=0.05)


def test_an_unclear_flash_is_taken_to_be_central(rng: torch.Generator) -> None:
    x, y = texel_positions(96, 96)
    noise = torch.rand(96, 96, generator=rng)
    photos = {
        "noise": noise,
        "constant": torch.full_like(x, 0.5),
        "black": torch.zeros_like(x),
        "slope": 0.5 + 0.3 * x + 0.1 * y,
        "dark spot": 0.8 - 0.5 * (-4 * ((x - 0.3).square() + y.square())).exp(),
        "frame": torch.where(x.abs() > 0.9, 1.0, 0.2 + 0.1 * noise),
    }
    for kind, photo in photos.items():
        assert estimate_flash_position(photo.expand(1, 3, -1, -1))[0].norm() < 0.05, kind


def test_the_flash_is_at_most_half_way_to_the_edge(rng: torch.Generator) -> None:
    light = camera_position() + torch.tensor([0.9, 0.0, 0.0])
    maps = Maps(*(part.float() for part in flat_maps(0.5, size=(64, 64))))
    found = estimate_flash_position(radiance_to_display(render_maps(maps, texel_positions(64, 64), light, light)))
    assert found.norm() <= 0.5 + 1e-6
    x, y = texel_positions(64, 64)
    corner = torch.where((x > 0.8) & (y > 0.8), 1.0, 0.2 + 0.1 * torch.rand(64, 64, generator=rng))
    assert estimate_flash_position(corner.expand(3, -1, -1)).norm() <= 0.5 + 1e-6  # a sticker, say
