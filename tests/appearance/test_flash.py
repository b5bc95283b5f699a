"""Renderings under a flash: closed forms, Mitsuba's own pictures, crops and batches."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from metapp.appearance.flash import (
    camera_distance,
    camera_position,
    evaluate_brdf,
    render_maps,
    texel_positions,
)
from metapp.appearance.geometry import rusinkiewicz_to_directions
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.svbrdf_maps import Maps
from tests.surfaces import flat_maps

RandomAngles = Callable[..., Tensor]
MitsubaBrdf = Callable[[dict[str, Any], Tensor, Tensor], Tensor]
UP = (0.0, 0.0, 1.0)


def rough(rng: torch.Generator, *batch: int, size: tuple[int, int] = (6, 5), colours: int = 3) -> Maps:
    """A random bumpy material, float64."""

    def draw(channels: int) -> Tensor:
        return torch.rand(*batch, channels, *size, generator=rng, dtype=torch.float64)

    return Maps(draw(3), draw(colours), 0.25 + 0.7 * draw(1), normal_from_height(draw(1), 0.6))


def position_above(x: float, y: float, z: float = camera_distance()) -> Tensor:
    return torch.tensor([x, y, z], dtype=torch.float64)


def grid(height: int, width: int) -> Tensor:
    return texel_positions(height, width, dtype=torch.float64)


def test_texels_fill_the_patch_and_row_0_is_on_top() -> None:
    x, y = grid(4, 4)
    torch.testing.assert_close(x[0], torch.tensor([-0.75, -0.25, 0.25, 0.75], dtype=torch.float64))
    torch.testing.assert_close(y[:, 0], -x[0])
    wide = grid(4, 8)
    torch.testing.assert_close(wide[:, :, 2:6], grid(4, 4))  # the square in the middle of a photo is the patch
    # the camera sees exactly the patch
    assert math.atan(1 / camera_distance()) == pytest.approx(math.pi / 8)
    assert camera_position().tolist() == pytest.approx([0, 0, camera_distance()])


def test_a_tilted_texel_is_brightest_where_it_faces_the_flash() -> None:
    centre, tilted = torch.zeros(2, 1, 1, dtype=torch.float64), flat_maps(0.5, normal=(0.6, 0, 0.8))  # to the right
    towards = render_maps(tilted, centre, position_above(1.5, 0, 2), position_above(0, 0))  # face to face, 2.5 away
    assert towards[0].item() == pytest.approx(0.5 * (camera_distance() / 2.5) ** 2, rel=1e-3)
    assert (towards > render_maps(tilted, centre, position_above(0, 0, 2.5), position_above(0, 0))).all()
    steep = flat_maps(1, 0.5, normal=(0.96, 0, 0.28))
    assert (render_maps(steep, centre, position_above(-1, 0, 0.2), position_above(0, 0)) == 0).all()


def test_intensity_and_falloff_may_differ_by_picture() -> None:
    maps, place = flat_maps(0.7, size=(4, 4)), grid(4, 4)
    colour = torch.tensor([[1.0, 0.5, 0.25], [2.0, 2.0, 2.0]], dtype=torch.float64)
    power = torch.tensor([0.0, 2.0], dtype=torch.float64)
    both = render_maps(maps, place, position_above(0, 0), position_above(0, 0), intensity=colour, falloff=power)
    white = render_maps(maps, place, position_above(0, 0), position_above(0, 0))
    torch.testing.assert_close(both[0], white * colour[0][:, None, None])
    torch.testing.assert_close(
        both[1], 2 * render_maps(maps, place, position_above(0, 0), position_above(0, 0), falloff=2.0)
    )


def channels_first(*vectors: Tensor) -> list[Tensor]:
    """Directions [N, 3] as a picture of one column."""
    return [directions.T[..., None] for directions in vectors]


def test_very_smooth_materials_stay_finite() -> None:
    maps = flat_maps(0.5, 0.04, 0.0, size=(3, 3))
    roughness = maps.roughness.clone().requires_grad_()
    image = render_maps(maps._replace(roughness=roughness), grid(3, 3), position_above(0, 0), position_above(0, 0))
    assert image.isfinite().all()
    image.sum().backward()
    assert roughness.grad is not None
    assert (roughness.grad == 0).all()


def rotate_to_frames(normal: Tensor, direction: Tensor) -> Tensor:
    """Local directions [N, 3] to those of the patch where the normals are [N, 3]."""
    tangent = torch.linalg.cross(normal, normal.new_tensor([0.0, 1.0, 0.0]).expand_as(normal))
    tangent = tangent / tangent.norm(dim=-1, keepdim=True)
    frame = torch.stack([tangent, torch.linalg.cross(normal, tangent), normal], dim=-1)
    return (frame @ direction[..., None])[..., 0]


@pytest.mark.parametrize("roughness", [0.2, 0.4, 0.7])
def test_reflection_agrees_with_mitsuba(
    mitsuba_brdf: MitsubaBrdf, roughness: float, random_angles: RandomAngles, rng: torch.Generator
) -> None:
    angles = random_angles(300)
    angles[::2, 0] *= 0.2  # half of them near the peak
    local = rusinkiewicz_to_directions(angles)
    above = (local[0][:, 2] > 0) & (local[1][:, 2] > 0)
    wi, wo = (directions[above] for directions in local)
    normal = torch.randn(len(wi), 3, generator=rng, dtype=torch.float64) * 0.4 + torch.tensor(UP, dtype=torch.float64)
    normal = normal / normal.norm(dim=-1, keepdim=True)
    turned = channels_first(*(rotate_to_frames(normal, directions) for directions in (wi, wo)))
    tilted = normal.T[..., None]

    mirror = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": roughness**2}
    value = evaluate_brdf(
        flat_maps(0.3, 1, roughness)._replace(normal=tilted), *turned
    )  # F0 = 1 leaves no light for the body
    torch.testing.assert_close(value[..., 0].T, mitsuba_brdf(mirror, wi, wo), rtol=1e-4, atol=1e-6)

    value = evaluate_brdf(flat_maps(0.3, 0, roughness)._replace(normal=tilted), *turned)
    matte = {"type": "diffuse", "reflectance": 0.3}
    # Schlick's reflectance of F0 = 0 rises near grazing; only what is left without it is the body.
    lobe = evaluate_brdf(flat_maps(0, 0, roughness)._replace(normal=tilted), *turned)
    torch.testing.assert_close((value - lobe)[..., 0].T, mitsuba_brdf(matte, wi, wo), rtol=1e-5, atol=0)


LIGHT = (0.5, 0.3, 2.0)  # to the right and further up, lower than the camera


def test_a_photo_of_a_texture_agrees_with_mitsuba(photograph: Callable[..., Tensor], rng: torch.Generator) -> None:
    diffuse = torch.rand(3, 16, 16, generator=rng, dtype=torch.float64)

    def bsdf(mitsuba: Any) -> dict[str, Any]:
        upwards = diffuse.flip(-2).movedim(0, -1)  # Mitsuba's first row is at v = 0, which is below
        bitmap = mitsuba.Bitmap(upwards.float().contiguous().numpy())
        texture = {"type": "bitmap", "bitmap": bitmap, "filter_type": "nearest", "raw": True}
        return {"type": "diffuse", "reflectance": texture}

    photo = photograph(bsdf, position_above(*LIGHT), 16, 16)
    image = render_maps(
        flat_maps(size=(16, 16))._replace(diffuse=diffuse), grid(16, 16), position_above(*LIGHT), position_above(0, 0)
    )
    torch.testing.assert_close(image, photo, rtol=5e-3, atol=0)


def test_a_crop_is_lit_as_its_place_in_the_photo(rng: torch.Generator) -> None:
    maps, place = rough(rng, 2), grid(6, 5)
    light, view = position_above(0.2, 0.1), position_above(0, 0)
    whole = render_maps(maps, place, light, view)
    crop = Maps(*(part[..., 1:4, 2:5] for part in maps))
    torch.testing.assert_close(render_maps(crop, place[:, 1:4, 2:5], light, view), whole[..., 1:4, 2:5])
    other = torch.stack([place[:, 1:4, 2:5], place[:, :3, :3]])  # each of the batch from a place of its own
    rendered_crop = render_maps(Maps(*(part[1:, ..., 1:4, 2:5] for part in maps)), place[:, :3, :3], light, view)
    torch.testing.assert_close(render_maps(crop, other, light, view)[1:], rendered_crop)


def test_batches_render_as_their_members_do(rng: torch.Generator) -> None:
    maps, place = rough(rng, 3, colours=1), grid(6, 5)
    light, view = (
        torch.stack([position_above(0, 0), position_above(0.3, 0, 2), position_above(0, 1)]),
        torch.stack([position_above(0, 0), position_above(0, 0.5), position_above(1, 0, 3)]),
    )
    together = render_maps(maps, place, light, view)
    assert together.shape == (3, 3, 6, 5)
    alone = [render_maps(Maps(*(part[i] for part in maps)), place, light[i], view[i]) for i in range(3)]
    torch.testing.assert_close(together, torch.stack(alone))
    mapped = torch.func.vmap(lambda maps, light, view: render_maps(maps, place, light, view))(maps, light, view)
    torch.testing.assert_close(together, mapped)


@pytest.mark.parametrize("roughness", [0.0, 0.2, 0.5, 1.0])
def test_single_precision_is_enough(rng: torch.Generator, roughness: float) -> None:
    maps = rough(rng, size=(64, 64))
    maps = maps._replace(roughness=torch.full_like(maps.roughness, roughness), normal=flat_maps(size=(64, 64)).normal)
    single = render_maps(
        Maps(*(part.float() for part in maps)), texel_positions(64, 64), camera_position(), camera_position()
    )
    assert single.dtype == torch.float32
    double = render_maps(maps, grid(64, 64), position_above(0, 0), position_above(0, 0))
    # At the floor of roughness alpha squared is 2.6e-6, and 1 - cos is known to 6e-8.
    torch.testing.assert_close(single.double(), double, rtol=0.1 if roughness == 0 else 1e-3, atol=1e-6)
