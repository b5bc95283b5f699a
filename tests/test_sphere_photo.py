"""Photographs of spheres: energy, agreement with Mitsuba's own pictures, symmetries, exposure and draws."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from data_tools.procedural import stream
from data_tools.sphere_photo import (
    ROUGHNESSES,
    Camera,
    Material,
    draw_camera,
    draw_material,
    expose,
    photograph,
    shade,
)
from metapp.colour import srgb_to_linear
from metapp.latlong import cosine_transfer, directions, glossy_transfer, luminance, resample, sphere_normals

WHITE = torch.ones(3)
SRGB = Camera(level=0.7, gamma=1.0, contrast=0.0)


def gloss(roughness: float) -> Material:
    """No body, all gloss."""
    return Material(torch.zeros(3), 1.0, roughness)


def draw_map(rng: torch.Generator, height: int = 64) -> Tensor:
    return torch.rand(3, height, 2 * height, generator=rng) ** 6


def sky(height: int, width: int) -> Tensor:
    """A smooth map without any symmetry, [3, height, width], of directions alone."""
    return smooth(directions(height, width))


def smooth(towards: Tensor) -> Tensor:
    lamps = torch.tensor([[0.6, 0.5, 0.6], [-0.8, 0.3, 0.4], [0.3, -0.2, -0.9]])
    return 0.05 + ((torch.einsum("lc,chw->lhw", lamps, towards) - 0.6) * 2).exp()


# What a sphere sends to the camera


@pytest.mark.parametrize("roughness", ROUGHNESSES)
def test_furnace(roughness: float) -> None:
    picture = shade(torch.ones(3, 64, 128), Material(WHITE, 0.3, roughness), 16)
    mask = sphere_normals(16)[1]
    torch.testing.assert_close(picture, mask.expand(3, 16, 16).float(), atol=1e-5, rtol=0)


def test_a_quarter_of_the_matrix_is_enough(rng: torch.Generator) -> None:
    light = draw_map(rng)
    normals, mask = sphere_normals(16)
    for material, transfer in (
        (Material(WHITE, 0.0, 0.3), cosine_transfer(normals.flatten(1).T, 16, 32)),
        (gloss(0.7), glossy_transfer(normals.flatten(1).T, 0.7, 16, 32)),
    ):
        whole = (resample(light, 16, 32).flatten(1) @ transfer.T).reshape(3, 16, 16) * mask
        torch.testing.assert_close(shade(light, material, 16), whole, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("roughness", ROUGHNESSES)
def test_the_matrices_are_fine_enough(roughness: float) -> None:
    # Against all texels of the map, each looked at in 9 places.
    normals, mask = sphere_normals(16)
    some = mask & (torch.arange(256).reshape(16, 16) % 9 == 0)
    light = sky(64, 128)
    lobe = glossy_transfer(normals[:, some].T, roughness, 64, 128, samples=3)
    fine, coarse = light.flatten(1) @ lobe.T, shade(light, gloss(roughness), 16)[:, some]
    assert (coarse - fine).abs().max() < 0.02 * fine.max()


@pytest.fixture
def mitsuba_sphere(mitsuba: Any) -> Callable[[dict[str, Any], int], Tensor]:
    """Mitsuba's own picture [3, S, S] of a sphere of some BSDF under `smooth`."""

    def render(bsdf: dict[str, Any], size: int) -> Tensor:
        # The poles are rows of Mitsuba's maps.
        theta = torch.linspace(0, math.pi, 65)[:, None]
        phi = (torch.arange(128) + 0.5) * (math.tau / 128)
        y = theta.cos().expand(65, 128)
        light = smooth(torch.stack([theta.sin() * phi.sin(), y, -theta.sin() * phi.cos()]))
        bitmap = mitsuba.Bitmap(np.ascontiguousarray(light.permute(1, 2, 0).numpy()))
        above = mitsuba.ScalarTransform4f().look_at(origin=[0, 0, 3], target=[0, 0, 0], up=[0, 1, 0])
        film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
        scene = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
            "sensor": {"type": "orthographic", "to_world": above, "film": film},
            "light": {"type": "envmap", "bitmap": bitmap},
            "sphere": {"type": "sphere", "bsdf": bsdf},
        }
        picture = mitsuba.render(mitsuba.load_dict(scene), spp=256, seed=1)
        return torch.from_numpy(np.array(picture)).permute(2, 0, 1)

    return render


def test_the_picture_is_mitsubas(mitsuba_sphere: Callable) -> None:
    albedo = torch.tensor([0.8, 0.5, 0.3])
    bodies = {
        "diffuse": ({"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo.tolist()}},
                    Material(albedo, 0.0, 0.5)),
        "mirror": ({"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": 0.25**2},
                   gloss(0.25)),
    }  # fmt: skip
    normals, _ = sphere_normals(16)
    inside = normals[2] > 0.7  # a pixel is nearly what its centre is, and masking loses little
    for name, (bsdf, material) in bodies.items():
        ours, theirs = (each[:, inside] for each in (shade(sky(64, 128), material, 16), mitsuba_sphere(bsdf, 16)))
        assert (ours - theirs).abs().mean() < 0.06 * theirs.mean(), name  # noise
        torch.testing.assert_close(ours.mean(-1), theirs.mean(-1), rtol=0.02, atol=0)


def test_light_falls_from_where_it_is() -> None:
    y, x = torch.meshgrid(-torch.arange(16.0) + 7.5, torch.arange(16.0) - 7.5, indexing="ij")
    for axis, sign, lit in ((0, 1, x > 0), (0, -1, x < 0), (1, 1, y > 0), (1, -1, y < 0)):
        light = ((directions(64, 128)[axis] * sign) > 0.9).expand(3, -1, -1).float()
        for material in (Material(WHITE, 0.0, 0.5), Material(WHITE, 0.4, 0.3)):
            picture = shade(light, material, 16)
            assert picture[:, lit].sum() > 10 * picture[:, ~lit].sum()


# Cameras


@pytest.mark.parametrize("level", [0.4, 0.9])
def test_nine_tenths_of_the_sphere_are_exposed_below_the_level(level: float, rng: torch.Generator) -> None:
    light = draw_map(rng).mean(0, keepdim=True).expand(3, -1, -1)
    display = expose(shade(light, Material(WHITE, 0.0, 0.5), 32), Camera(level, 1.0, 0.0))
    mask = sphere_normals(32)[1]
    linear = srgb_to_linear(display[0, mask])
    assert linear.quantile(0.9).item() == pytest.approx(srgb_to_linear(torch.tensor(level)).item(), rel=1e-4)
    assert (display[:, ~mask] == 0).all()


def test_curves_rise_from_black_to_white() -> None:
    ramp = (torch.linspace(0, 1, 32 * 32) ** 20).reshape(1, 32, 32).expand(3, -1, -1)
    for index in range(20):
        display = expose(ramp, draw_camera(stream(index)))[0].flatten()
        assert display[0] == 0
        assert (display.diff() >= -1e-6).all()
        assert display[-1].item() == pytest.approx(1, abs=1e-6)  # clipped: 1 is over four times the level


def test_suns_clip_and_the_rest_is_seen() -> None:
    light = torch.full((3, 64, 128), 0.3)
    light[:, 20, 70] = 1e5
    picture = expose(shade(light, Material(0.5 * WHITE, 0.3, 0.25), 16), SRGB)
    assert picture.max() > 0.999
    assert 0.2 < picture[:, sphere_normals(16)[1]].median() < 0.8


@pytest.mark.parametrize("peak", [0.0, 1e-20, 1e20])
def test_light_from_behind_only(peak: float) -> None:
    light = torch.zeros(3, 64, 128)
    light[:, 32, 20] = peak  # z = -0.54: only the rim sees it
    photos = photograph(light, stream(1), size=16)
    assert (photos[:, :, 8, 8] == 0).all()
    assert bool(photos.any()) == (peak > 0)


# Photographs


def test_photographs_fill_the_disc(rng: torch.Generator) -> None:
    photos = photograph(draw_map(rng), stream(0))
    assert photos.shape == (4, 3, 64, 64)
    assert photos.dtype == torch.uint8
    mask = sphere_normals(64)[1]
    assert (photos[..., ~mask] == 0).all()
    assert (photos[..., mask].sum(1) > 0).float().mean() > 0.99
    seen = photos[..., mask].float().mean((1, 2))
    assert (seen > 30).all()
    assert (seen < 250).all()


def test_draws(rng: torch.Generator) -> None:
    light = draw_map(rng)
    first = photograph(light, stream(5), size=16)
    assert torch.equal(photograph(light, stream(5), size=16), first)
    assert not torch.equal(photograph(light, stream(6), size=16), first)
    assert torch.equal(photograph(light, stream(5), count=2, size=16), first[:2])
    assert not any(torch.equal(first[0], other) for other in first[1:])


def test_the_scale_of_a_map_does_not_matter(rng: torch.Generator) -> None:
    light = draw_map(rng)
    photos = [photograph(light * scale, stream(2), size=16).int() for scale in (1.0, 1e-4, 1e4)]
    assert max((photo - photos[0]).abs().max() for photo in photos) <= 1


def test_mirrored_maps_make_mirrored_photographs(rng: torch.Generator) -> None:
    light = draw_map(rng)
    photos = photograph(light, stream(2), size=16).int()
    for dim in (-1, -2):
        mirrored = photograph(light.flip(dim), stream(2), size=16).int().flip(dim)
        assert (mirrored - photos).abs().max() <= 1
    assert (photos - photos.flip(-1)).abs().max() > 1


def test_materials_and_cameras_stay_in_their_ranges() -> None:
    materials = [draw_material(stream(0, index)) for index in range(400)]
    albedo = torch.stack([material.albedo for material in materials])
    assert albedo.min() >= 0.3
    assert 0.9 < albedo.max() <= 0.95
    assert luminance(albedo[..., None, None]).std() > 0.1
    assert (albedo.amax(-1) - albedo.amin(-1)).max() > 0.2
    specular = torch.tensor([material.specular for material in materials])
    assert 0.15 < (specular == 0).float().mean() < 0.35
    assert 0.5 < specular.max() <= 0.6
    assert {material.roughness for material in materials} == set(ROUGHNESSES)
    cameras = torch.tensor([draw_camera(stream(1, index)) for index in range(400)])
    for values, low, high in zip(cameras.T, (0.4, 0.8, 0.0), (0.9, 1.25, 0.5), strict=True):
        assert low <= values.min() < low + 0.05 < high - 0.05 < values.max() <= high


def test_an_odd_size_is_an_error() -> None:
    with pytest.raises(ValueError, match="15 px, expected an even number"):
        shade(torch.ones(3, 64, 128), Material(WHITE, 0.0, 0.5), 15)
