"""Photographs of spheres: energy, agreement with Mitsuba's own pictures, symmetries, exposure and draws."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.latlong import glossy_transfer, sphere_normals, texel_directions
from metapp.appearance.photograph import (
    GLOSS_ROUGHNESSES,
    CameraCurves,
    SphereMaterials,
    develop,
    draw_camera_curves,
    exposures,
    photograph_spheres,
    render_mirror_spheres,
)
from metapp.appearance.photograph import render_material_spheres as shade_all

WHITE = torch.ones(3)


def material(albedo: Tensor, specular: float, roughness: float) -> SphereMaterials:
    """Return a material whose gloss has a single roughness."""
    parts = torch.tensor([[float(lobe_roughness == roughness) for lobe_roughness in GLOSS_ROUGHNESSES]])
    return SphereMaterials(albedo[None], torch.tensor([specular]), parts)


def gloss(roughness: float) -> SphereMaterials:
    """No body, all gloss."""
    return material(torch.zeros(3), 1.0, roughness)


def render_material_spheres(light: Tensor, of: SphereMaterials, size: int) -> Tensor:
    """Return one picture [3, size, size] of a sphere whose gloss has a single roughness."""
    kind = int(of.gloss_weights.argmax())
    single = of._replace(gloss_weights=of.gloss_weights[:, kind : kind + 1])
    return shade_all(light[None], single, size, GLOSS_ROUGHNESSES[kind : kind + 1])[0]


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def photographs(light: Tensor, seed: int, count: int = 4, size: int = 16) -> Tensor:
    """Some of one map, uint8."""
    return (photograph_spheres(light.expand(count, -1, -1, -1), seeded(seed), size) * 255).round().to(torch.uint8)


def draw_map(rng: torch.Generator, height: int = 64) -> Tensor:
    return torch.rand(3, height, 2 * height, generator=rng) ** 6


def sky(height: int, width: int) -> Tensor:
    """A smooth map without any symmetry, [3, height, width], of directions alone."""
    return smooth(texel_directions(height, width))


def smooth(towards: Tensor) -> Tensor:
    lamps = torch.tensor([[0.6, 0.5, 0.6], [-0.8, 0.3, 0.4], [0.3, -0.2, -0.9]])
    return 0.05 + ((torch.einsum("lc,chw->lhw", lamps, towards) - 0.6) * 2).exp()


# What a sphere sends to the camera


@pytest.mark.parametrize("roughness", GLOSS_ROUGHNESSES)
def test_spheres_in_even_light_show_that_light(roughness: float) -> None:
    picture = render_material_spheres(torch.ones(3, 64, 128), material(WHITE, 0.3, roughness), 16)
    mask = sphere_normals(16)[1]
    torch.testing.assert_close(picture, mask.expand(3, 16, 16).float(), atol=1e-5, rtol=0)
    with pytest.raises(ValueError, match="15 px, expected an even number"):
        render_material_spheres(torch.ones(3, 64, 128), material(WHITE, 0.3, roughness), 15)


@pytest.mark.parametrize("specular", [0.0, 0.04, 0.5])
def test_gloss_rises_to_the_rim_by_schlick(specular: float) -> None:
    """Under light of 1 from everywhere, a black body shows the share of its gloss alone: F + (1 - F) (1 - cos)^5."""
    normals, mask = sphere_normals(32)
    picture = render_material_spheres(torch.ones(3, 64, 128), material(torch.zeros(3), specular, 0.54), 32)
    expected = (specular + (1 - specular) * (1 - normals[2].double()) ** 5) * mask * (specular > 0)
    torch.testing.assert_close(picture.double(), expected.expand(3, -1, -1), atol=1e-5, rtol=0)


@pytest.mark.parametrize("roughness", GLOSS_ROUGHNESSES)
def test_the_matrices_are_fine_enough(roughness: float) -> None:
    # Against all texels of the map, each looked at in 9 places.
    normals, mask = sphere_normals(16)
    compared_pixels = mask & (torch.arange(256).reshape(16, 16) % 9 == 0)
    light = sky(64, 128)
    lobe = glossy_transfer(normals[:, compared_pixels].T, roughness, 64, 128, samples=3)
    fine, coarse = light.flatten(1) @ lobe.T, render_material_spheres(light, gloss(roughness), 16)[:, compared_pixels]
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


def test_pictures_agree_with_mitsuba(mitsuba_sphere: Callable) -> None:
    albedo = torch.tensor([0.8, 0.5, 0.3])
    bodies = {
        "diffuse": ({"reflectance": {"type": "rgb", "value": albedo.tolist()}}, material(albedo, 0.0, 0.54)),
        "roughconductor": ({"material": "none", "distribution": "ggx", "alpha": 0.25**2}, gloss(0.25)),
    }
    normals, _ = sphere_normals(16)
    inside = normals[2] > 0.7  # a pixel is nearly what its centre is, and masking loses little
    for name, (bsdf, of) in bodies.items():
        ours, theirs = (
            spheres[:, inside]
            for spheres in (render_material_spheres(sky(64, 128), of, 16), mitsuba_sphere({"type": name, **bsdf}, 16))
        )
        assert (ours - theirs).abs().mean() < 0.06 * theirs.mean(), name  # noise
        torch.testing.assert_close(ours.mean(-1), theirs.mean(-1), rtol=0.02, atol=0)


# Cameras


@pytest.mark.parametrize("level", [0.4, 0.9])
def test_nine_tenths_of_the_sphere_are_exposed_below_the_level(level: float, rng: torch.Generator) -> None:
    light = draw_map(rng).mean(0, keepdim=True).expand(3, -1, -1)
    radiance = render_material_spheres(light, material(WHITE, 0.0, 0.54), 32)[None]
    camera = CameraCurves(exposures(radiance, torch.tensor([level])), torch.ones(1), torch.zeros(1))
    display = develop(radiance, camera)[0].clamp_max(1)  # by sRGB's curve
    mask = sphere_normals(32)[1]
    linear = srgb_to_linear(display[0, mask])
    assert linear.quantile(0.9).item() == pytest.approx(srgb_to_linear(torch.tensor(level)).item(), rel=1e-4)
    assert (display[:, ~mask] == 0).all()


def test_curves_rise_from_black_and_go_on_above_white(rng: torch.Generator) -> None:
    """What a picture clips, a gradient still pulls down."""
    ramp = (torch.linspace(0, 1, 32 * 32) ** 20).reshape(1, 32, 32).expand(20, 3, -1, -1).clone().requires_grad_()
    display = develop(ramp, draw_camera_curves(torch.rand(20, 3, generator=rng), ramp.detach()))
    curves = display[:, 0].flatten(1)
    assert (curves[:, 0] == 0).all()
    assert (curves.diff() >= -1e-6).all()
    assert (curves[:, -1] > 1).all()
    (slope,) = torch.autograd.grad(display.sum(), ramp)
    assert slope.isfinite().all()
    assert (slope[:, 0, -1] > 0).all()


def test_light_from_behind_reaches_the_rim_alone() -> None:
    for peak in (0.0, 1e-20, 1e20):
        light = torch.zeros(3, 64, 128)
        light[:, 32, 20] = peak  # z = -0.54: only the rim sees it
        photos = photographs(light, 1)
        assert (photos[:, :, 8, 8] == 0).all()
        assert bool(photos.any()) == (peak > 0), peak


# Photographs


def test_photographs_depend_on_the_seed_and_not_on_the_scale_of_a_map(rng: torch.Generator) -> None:
    light = draw_map(rng)
    first = photographs(light, 5)
    assert torch.equal(photographs(light, 5), first)
    assert not torch.equal(photographs(light, 6), first)
    assert (photographs(light, 5, count=2).int() - first[:2].int()).abs().max() <= 1  # rounding alone
    assert not any(torch.equal(first[0], other) for other in first[1:])
    photos = [photographs(light * scale, 2).int() for scale in (1.0, 1e-4, 1e4)]
    assert max((photo - photos[0]).abs().max() for photo in photos) <= 1


def test_a_mirror_shows_the_map_where_it_reflects_the_view() -> None:
    towards = texel_directions(256, 512)
    seen = render_mirror_spheres((towards + 1)[None], 32)[0] - 1
    normals, mask = sphere_normals(32)
    inside = normals[2] > 0.4
    reflected = 2 * normals[2] * normals - torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    assert (seen - reflected)[:, inside].abs().max() < 0.02  # texels, and curvature within a pixel
    assert (seen[:, ~mask] == -1).all()
    assert torch.equal(render_mirror_spheres(torch.ones(1, 3, 16, 32), 16)[0, 0] > 0, sphere_normals(16)[1])
    torch.testing.assert_close(render_mirror_spheres(torch.ones(1, 3, 16, 32), 16).amax(), torch.ones(()))
