"""The flash renderer: closed forms, Mitsuba's own pictures, gradients, and where a photo's flash was."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from metapp.appearance.flash import (
    Maps,
    camera_distance,
    camera_position,
    estimate_flash_position,
    evaluate_brdf,
    height_from_normal,
    map_statistics,
    normal_from_height,
    radiance_to_display,
    render_maps,
    texel_positions,
)
from metapp.appearance.geometry import rusinkiewicz_to_directions
from metapp.appearance.highlight import (
    F0_BOUND_CLAUSE,
    clipped_highlight_warnings,
    estimate_gloss,
    fill_clipped,
    find_clipped,
    find_white,
    remove_flash_falloff,
)
from tests import surfaces
from tests.surfaces import normal_from_slopes, wave_heights_and_normals

RandomAngles = Callable[..., Tensor]
MitsubaBrdf = Callable[[dict[str, Any], Tensor, Tensor], Tensor]
UP = (0.0, 0.0, 1.0)


def flat(
    diffuse: float = 0.0,
    specular: float = 0.0,
    roughness: float = 0.5,
    *,
    size: tuple[int, int] = (1, 1),
    normal: tuple[float, ...] = UP,
) -> Maps:
    """Return maps that are alike everywhere, float64, [.., H, W] without a batch."""
    values = ([diffuse] * 3, [specular], [roughness], normal)
    return Maps(*(torch.tensor(v, dtype=torch.float64)[:, None, None].expand(-1, *size) for v in values))


def rough(rng: torch.Generator, *batch: int, size: tuple[int, int] = (6, 5), colours: int = 3) -> Maps:
    """A random bumpy material, float64."""

    def draw(channels: int) -> Tensor:
        return torch.rand(*batch, channels, *size, generator=rng, dtype=torch.float64)

    return Maps(draw(3), draw(colours), 0.25 + 0.7 * draw(1), normal_from_height(draw(1), 0.6))


def position_above(x: float, y: float, z: float = camera_distance()) -> Tensor:
    return torch.tensor([x, y, z], dtype=torch.float64)


def grid(height: int, width: int) -> Tensor:
    return texel_positions(height, width, dtype=torch.float64)


# Places and normals


def test_texels_fill_the_patch_and_row_0_is_on_top() -> None:
    x, y = grid(4, 4)
    torch.testing.assert_close(x[0], torch.tensor([-0.75, -0.25, 0.25, 0.75], dtype=torch.float64))
    torch.testing.assert_close(y[:, 0], -x[0])
    wide = grid(4, 8)
    torch.testing.assert_close(wide[:, :, 2:6], grid(4, 4))  # the square in the middle of a photo is the patch
    # the camera sees exactly the patch
    assert math.atan(1 / camera_distance()) == pytest.approx(math.pi / 8)
    assert camera_position().tolist() == pytest.approx([0, 0, camera_distance()])


def test_normals_of_a_slope() -> None:
    x, y = grid(16, 16) * 8  # in texels
    expected = torch.tensor([-1.0, 0.5, 1.0], dtype=torch.float64)[:, None, None] / 1.5
    for periodic, inner in ((False, slice(None)), (True, slice(1, -1))):
        normal = normal_from_height((0.5 * x - 0.25 * y)[None], 2.0, periodic=periodic)[:, inner, inner]
        torch.testing.assert_close(normal, expected.expand_as(normal))


def test_statistics_of_two_halves_agree_with_worked_values() -> None:
    """Half of the patch bright, shiny and level, half dark, dull and tilted by 30 degrees."""
    bright = flat(1.0, 1.0, 0.9)
    dark = flat(0.25, 0.25, 0.5, normal=(0.0, -0.5, math.sqrt(0.75)))
    found = map_statistics(Maps(*(torch.cat(pair, -1) for pair in zip(bright, dark, strict=True))))
    low = 0.25 ** (1 / 2.2)
    shown = ((1 + low) / 2, (1 - low) / 2)
    expected = torch.tensor([[shown[0]] * 4 + [0.7, 0.25], [shown[1]] * 4 + [0.2, 0.25]], dtype=torch.float64)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-3)


# Closed forms


def test_a_tilted_texel_is_brightest_where_it_faces_the_flash() -> None:
    centre, tilted = torch.zeros(2, 1, 1, dtype=torch.float64), flat(0.5, normal=(0.6, 0, 0.8))  # to the right
    towards = render_maps(tilted, centre, position_above(1.5, 0, 2), position_above(0, 0))  # face to face, 2.5 away
    assert towards[0].item() == pytest.approx(0.5 * (camera_distance() / 2.5) ** 2, rel=1e-3)
    assert (towards > render_maps(tilted, centre, position_above(0, 0, 2.5), position_above(0, 0))).all()
    steep = flat(1, 0.5, normal=(0.96, 0, 0.28))
    assert (render_maps(steep, centre, position_above(-1, 0, 0.2), position_above(0, 0)) == 0).all()


def test_intensity_and_falloff_may_differ_by_picture() -> None:
    maps, place = flat(0.7, size=(4, 4)), grid(4, 4)
    colour = torch.tensor([[1.0, 0.5, 0.25], [2.0, 2.0, 2.0]], dtype=torch.float64)
    power = torch.tensor([0.0, 2.0], dtype=torch.float64)
    both = render_maps(maps, place, position_above(0, 0), position_above(0, 0), intensity=colour, falloff=power)
    white = render_maps(maps, place, position_above(0, 0), position_above(0, 0))
    torch.testing.assert_close(both[0], white * colour[0][:, None, None])
    torch.testing.assert_close(
        both[1], 2 * render_maps(maps, place, position_above(0, 0), position_above(0, 0), falloff=2.0)
    )


# Reflection


def channels_first(*vectors: Tensor) -> list[Tensor]:
    """Directions [N, 3] as a picture of one column."""
    return [directions.T[..., None] for directions in vectors]


def test_very_smooth_materials_stay_finite() -> None:
    maps = flat(0.5, 0.04, 0.0, size=(3, 3))
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
        flat(0.3, 1, roughness)._replace(normal=tilted), *turned
    )  # F0 = 1 leaves no light for the body
    torch.testing.assert_close(value[..., 0].T, mitsuba_brdf(mirror, wi, wo), rtol=1e-4, atol=1e-6)

    value = evaluate_brdf(flat(0.3, 0, roughness)._replace(normal=tilted), *turned)
    matte = {"type": "diffuse", "reflectance": 0.3}
    # Schlick's reflectance of F0 = 0 rises near grazing; only what is left without it is the body.
    lobe = evaluate_brdf(flat(0, 0, roughness)._replace(normal=tilted), *turned)
    torch.testing.assert_close((value - lobe)[..., 0].T, mitsuba_brdf(matte, wi, wo), rtol=1e-5, atol=0)


# Mitsuba's camera, light and plane


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
        flat(size=(16, 16))._replace(diffuse=diffuse), grid(16, 16), position_above(*LIGHT), position_above(0, 0)
    )
    torch.testing.assert_close(image, photo, rtol=5e-3, atol=0)


# Crops, batches, types, gradients


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
    maps = maps._replace(roughness=torch.full_like(maps.roughness, roughness), normal=flat(size=(64, 64)).normal)
    single = render_maps(
        Maps(*(part.float() for part in maps)), texel_positions(64, 64), camera_position(), camera_position()
    )
    assert single.dtype == torch.float32
    double = render_maps(maps, grid(64, 64), position_above(0, 0), position_above(0, 0))
    # At the floor of roughness alpha squared is 2.6e-6, and 1 - cos is known to 6e-8.
    torch.testing.assert_close(single.double(), double, rtol=0.1 if roughness == 0 else 1e-3, atol=1e-6)


# Exposure


def test_exposure_is_a_clamp_and_a_root_with_finite_gradients() -> None:
    radiance = torch.tensor([-1.0, 0.0, 1e-6, 0.25, 1.0, 1.5], dtype=torch.float64, requires_grad=True)
    shown = radiance_to_display(radiance)
    assert shown[-2:].tolist() == [1, 1]
    assert shown[3].item() == pytest.approx(0.25 ** (1 / 2.2))
    assert shown[1].item() < 0.5 / 255
    (slope,) = torch.autograd.grad(shown.sum(), radiance)
    assert slope.isfinite().all()
    assert slope[[0, 1, 5]].tolist() == [0, 0, 0]
    assert slope.max() < 1000
    assert torch.autograd.gradcheck(
        radiance_to_display, (torch.linspace(0.01, 0.99, 9, dtype=torch.float64).requires_grad_(),)
    )


# Where the flash was


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
    maps = Maps(*(part.float() for part in flat(0.5, size=(64, 64))))
    found = estimate_flash_position(radiance_to_display(render_maps(maps, texel_positions(64, 64), light, light)))
    assert found.norm() <= 0.5 + 1e-6
    x, y = texel_positions(64, 64)
    corner = torch.where((x > 0.8) & (y > 0.8), 1.0, 0.2 + 0.1 * torch.rand(64, 64, generator=rng))
    assert estimate_flash_position(corner.expand(3, -1, -1)).norm() <= 0.5 + 1e-6  # a sticker, say


# Highlights


SIZE = 128


def above(x: float, y: float) -> Tensor:
    return (camera_position() + torch.tensor([x, y, 0.0]))[None]


def photo(
    roughness: float, specular: float, light: Tensor, diffuse: tuple[float, float, float] = (0.3, 0.2, 0.1)
) -> Tensor:
    """A flat even material [1, 3, SIZE, SIZE] under a flash."""
    ones = torch.ones(1, 1, SIZE, SIZE)
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(1, 3, SIZE, SIZE)
    maps = Maps(torch.tensor(diffuse)[:, None, None] * ones, specular * ones, roughness * ones, up)
    return radiance_to_display(render_maps(maps, texel_positions(SIZE, SIZE), light, light, falloff=1.0))


@pytest.mark.parametrize(("roughness", "within"), [(0.16, 0.25), (0.25, 0.12), (0.4, 0.12), (0.6, 0.12)])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.2, -0.3)])
def test_gloss_of_flat_even_materials_is_found(roughness: float, within: float, place: tuple[float, float]) -> None:
    light = above(*place)
    found = estimate_gloss(photo(roughness, 0.04, light), light)
    assert float(found.roughness) == pytest.approx(roughness, rel=within)
    assert float(found.specular) == pytest.approx(0.04, rel=0.5)
    torch.testing.assert_close(found.diffuse, torch.tensor([[0.3, 0.2, 0.1]]), rtol=0.08, atol=0)


def glossy(seed: int, size: int) -> Maps:
    """A drawn material [1, C, size, size]: paint in cells, a bumpy surface, one roughness and one specular colour."""
    draws = torch.Generator().manual_seed(seed)
    paint = torch.rand(1, 3, 8, 8, generator=draws).repeat_interleave(size // 8, -1).repeat_interleave(size // 8, -2)
    bumps = torch.nn.functional.interpolate(torch.randn(1, 1, 16, 16, generator=draws), (size, size), mode="bicubic")
    roughness, specular = 0.15 + 0.35 * torch.rand(2, generator=draws)
    even = torch.ones(1, 1, size, size)
    return Maps(0.1 + 0.5 * paint, specular * even.expand(1, 3, -1, -1), roughness * even, normal_from_height(bumps))


def photo_with_clipping(maps: Maps, clipped: float) -> Tensor:
    """A photo [3, H, W] of 8 bits, with a little noise, of whose px such a share clips in all channels."""
    size = maps.roughness.shape[-1]
    radiance = render_maps(maps, texel_positions(size, size), above(0.1, 0.0), above(0.1, 0.0))[0]
    level = radiance.amin(0).flatten().sort().values[round((1 - clipped) * (size * size - 1))]
    display = radiance_to_display(radiance / level * (1.02 if clipped else 0.8))
    noise = torch.randn(display.shape, generator=torch.Generator().manual_seed(0))
    return (255 * (display + 0.005 * noise)).round().clamp(0, 255) / 255


@pytest.mark.parametrize("seed", range(20))
def test_highlights_are_doubted_if_white_is_clipped(seed: int) -> None:
    """Exposures of which 0.5 to 5 % clip are said, others, of which less than 0.1 % does, are not."""
    maps = glossy(seed, 64)
    share = 0.005 * 10 ** (seed / 19)
    (clause,) = clipped_highlight_warnings(photo_with_clipping(maps, share), F0_BOUND_CLAUSE)
    assert clause.endswith("% of the photo is clipped, so F0 is a lower bound (a darker exposure shows more)")
    assert 0.9 * share < float(clause.split()[0]) / 100 < 2.5 * share  # with what all but clips
    assert clipped_highlight_warnings(photo_with_clipping(maps, 0.0), F0_BOUND_CLAUSE) == []


@pytest.mark.parametrize("paint", [(255, 120, 80), (255, 252, 190), (229, 229, 229)])
def test_saturated_paint_is_no_clipped_highlight(paint: tuple[int, int, int]) -> None:
    """One or two clipped channels are a colour, and white beneath which JPEG left traces of colour is a highlight."""
    photo = (torch.tensor(paint) / 255)[:, None, None].expand(3, 64, 64)
    assert not find_white(photo).any()
    assert find_white((torch.tensor([250, 255, 243]) / 255)[:, None, None].expand(3, 64, 64)).all()


def test_highlights_are_filled_and_glints_are_not() -> None:
    photo = torch.full((1, 3, 256, 256), 0.3)
    photo[..., ::16, ::16] = 1
    assert not find_clipped(photo).any()
    photo[..., 100:110, 90:120] = 1
    found = find_clipped(photo)[0, 0]
    assert found[101:109, 91:119].all()
    assert found.sum() <= 300


@pytest.fixture
def maps_with_blots() -> tuple[Maps, Tensor]:
    """Maps [2, C, 128, 128] of an even material, wrong beneath the first photo's clipped highlight, and both photos."""
    photos = torch.full((2, 3, 128, 128), 0.5)
    photos[0, :, 40:80, 40:80] = 1
    photos[0, :, 60, 60] = 0.2  # a dark speck that is seen
    even = torch.ones(2, 1, 128, 128)
    maps = Maps(0.3 * even.repeat(1, 3, 1, 1), 0.1 * even, 0.4 * even, torch.rand(2, 3, 128, 128))
    for part, wrong in zip(maps[:3], (0.01, 0.9, 0.8), strict=True):
        part[0, :, 40:80, 40:80] = wrong
        part[:, :, 60, 60] = 0.77
        part[:, :, 5, 5] = 0.66
    return maps, photos


def test_maps_beneath_clipped_highlights_are_those_around(maps_with_blots: tuple[Maps, Tensor]) -> None:
    maps, photos = maps_with_blots
    filled = fill_clipped(maps, photos)
    for part, before, value in zip(filled, maps, (0.3, 0.1, 0.4), strict=False):
        covered = part[0, :, 40:80, 40:80].clone()
        covered[:, 20, 20] = value
        torch.testing.assert_close(
            covered, torch.full_like(covered, value), atol=0.03, rtol=0
        )  # at corners, 0.2 off before
        torch.testing.assert_close(part[0, :, 60, 60], before[0, :, 60, 60])
        far = torch.ones(128, 128, dtype=torch.bool)
        far[30:90, 30:90] = False
        assert torch.equal(part[0][:, far], before[0][:, far])
        assert torch.equal(part[1], before[1])
    assert torch.equal(filled.normal, maps.normal)
    assert fill_clipped(maps, photos.clamp_max(0.9)) is maps


def test_finer_maps_are_filled_as_coarser_ones(maps_with_blots: tuple[Maps, Tensor]) -> None:
    maps, photos = maps_with_blots
    fine = Maps(*(part.repeat_interleave(2, -1).repeat_interleave(2, -2) for part in maps))
    found = Maps(*(torch.nn.functional.avg_pool2d(part, 2) for part in fill_clipped(fine, photos)))
    for part, expected in zip(found[:3], fill_clipped(maps, photos)[:3], strict=True):
        torch.testing.assert_close(part[0, :, 45:55, 45:55], expected[0, :, 45:55, 45:55], atol=0.01, rtol=0)


def test_a_photo_that_clips_all_over_leaves_mean_maps(maps_with_blots: tuple[Maps, Tensor]) -> None:
    maps, photos = maps_with_blots
    filled = fill_clipped(maps, torch.ones_like(photos))
    for part, before in zip(filled[:3], maps[:3], strict=True):
        assert torch.isfinite(part).all()
        assert before.amin() <= part.amin() <= part.amax() <= before.amax()


def test_width_of_clipped_highlights_is_estimated() -> None:
    light = above(0.0, 0.0)
    picture = photo(0.25, 0.1, light)
    assert (picture > 0.99).float().mean() > 0.005
    assert float(estimate_gloss(picture, light).roughness) == pytest.approx(0.25, rel=0.2)


def test_contrast_separates_varnish_from_cloth_and_highlight_share_metal() -> None:
    light = above(0.0, 0.0)
    shiny, matte = (
        float(estimate_gloss(photo(*parameters, light), light).central_lobe_share)
        for parameters in ((0.2, 0.04), (0.8, 0.02))
    )
    assert matte < 0.3 < 0.8 < shiny
    bodies = ((0.2, (0.0, 0.0, 0.0)), (0.02, (0.4, 0.4, 0.4)))
    metal, cloth = (float(estimate_gloss(photo(0.5, f0, light, diffuse=body), light).lobe_share) for f0, body in bodies)
    assert cloth < 0.15 < 0.9 < metal


def test_photos_without_their_light_are_as_bright_in_all_rings() -> None:
    light = above(0.1, 0.0)
    picture = photo(0.3, 0.05, light)
    even = remove_flash_falloff(picture, light)
    assert float(even.std((2, 3)).max()) < 0.1 * float(picture.std((2, 3)).max())
    torch.testing.assert_close(even.mean((2, 3)), picture.mean((2, 3)), rtol=0.05, atol=0)
    stains = 1 + 0.2 * (torch.rand(SIZE, SIZE, generator=torch.Generator().manual_seed(0)) < 0.5)
    stained = remove_flash_falloff(picture * stains, light)
    assert float((stained / even / stains).std()) < 0.05


# Heights from normals


def test_waves_that_tile_are_found_exactly() -> None:
    height, normal = wave_heights_and_normals(48)
    assert torch.allclose(height_from_normal(normal, periodic=True), height, atol=1e-10)
    both = height_from_normal(torch.stack([normal.flip(-1), normal]), periodic=True)
    assert torch.equal(both[1], height_from_normal(normal, periodic=True))


def test_heights_of_a_hill_and_of_a_plane_that_do_not_tile() -> None:
    size = 64
    x, y = ((centres - size / 2) / (size / 6) for centres in surfaces.texel_centres(size))
    height = 5 * (-(x * x + 2 * y * y) / 2).exp()
    normal = normal_from_slopes(-x * height / (size / 6), -2 * y * height / (size / 6))
    found = height_from_normal(normal, periodic=False)[0]
    assert (found - (height - height.mean())).abs().max() < 0.02  # of 5
    # and a tilted plane
    x, y = surfaces.texel_centres(32)
    plane = 0.3 * x - 0.2 * y
    found = height_from_normal(normal_from_slopes(0.3 + 0 * x, -0.2 + 0 * y), periodic=False)[0]
    assert (found - (plane - plane.mean())).abs().max() < 0.15  # half a texel's step: edges are mirrored


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("kept", [(48, 24), (24, 48)])
def test_fields_need_not_be_square(kept: tuple[int, int], periodic: bool) -> None:
    """Waves along the longer side alone, of which the other is a part."""
    rows, columns = kept
    x, y = (4 * math.pi * centres / 48 for centres in surfaces.texel_centres(48))
    along, slope = (x, (1, 0)) if columns == 48 else (y, (0, 1))
    step = 4 * math.pi / 48 * along.cos()
    normal = normal_from_slopes(slope[0] * step, slope[1] * step)[:, :rows, :columns]
    found = height_from_normal(normal, periodic=periodic)
    assert found.shape == (1, rows, columns)
    assert (found[0] - along.sin()[:rows, :columns]).abs().max() < (1e-9 if periodic else 0.2)
