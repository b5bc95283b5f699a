"""Data augmentation of materials: turned, mixed, of other gloss and colour, photographed anew.

All functions take packed maps [T, 10, H, W], one material a task, and a generator that draws for each task by itself.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import torch
from torch import Generator, Tensor
from torch.nn.functional import affine_grid, avg_pool2d, grid_sample, interpolate

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.flash import camera_distance
from metapp.appearance.svbrdf_maps import unpack_maps
from metapp.apps.svbrdf_nonstationary.flashes import (
    FLASH_LOG_GAIN,
    FLASH_LOG_HEIGHT,
    FLASH_NUMBERS,
    FLASH_SHIFT,
    decode_flash,
    render_photo,
)
from metapp.apps.svbrdf_nonstationary.maps import find_slopes, normalise
from metapp.apps.svbrdf_nonstationary.places import (
    BESIDE_LENS_SHARE,
    FLASH_BRIGHTNESS_LOG_DEVIATION,
    FLASH_HEIGHT_LOG_DEVIATION,
    FLASH_OFFSET_HALF_SIDES,
)
from metapp.learning import random_tensors

# Standard deviations of the raw parameters of a flash
FLASH_DEVIATIONS = (
    FLASH_OFFSET_HALF_SIDES / FLASH_SHIFT,
    FLASH_OFFSET_HALF_SIDES / FLASH_SHIFT,
    FLASH_HEIGHT_LOG_DEVIATION / FLASH_LOG_HEIGHT,
    FLASH_BRIGHTNESS_LOG_DEVIATION / FLASH_LOG_GAIN,
)
CROP_SIDES = (0.35, 0.7)  # sides of crops over that of the maps, in which a square of any direction has room
MISEXPOSED_SHARE, MAX_EXPOSURE_STOPS = 0.2, 1.1  # share of photographs that are exposed wrongly, and by how much
FAR_FLASH_SHARE, FLASH_HEIGHTS_HALF_SIDES = 0.4, (1.7, 6.0)  # of crops and other lenses
TINTED_SHARE, TINT_LOG_DEVIATION = 0.3, 0.04  # share whose white balance is off, and the deviation of its log gains
MAX_SLOPE = 2.0  # tangent of the tilt of normals, at most, in restyled materials
DIELECTRIC_F0 = (0.02, 0.08)  # range of the specular reflectance of dielectrics
POLISHED_SHARE, POLISHED_ROUGHNESSES = 0.2, (0.05, 0.3)  # share of materials that become polished, and their roughness
METAL_DIFFUSE = 0.02  # mean diffuse reflectance below which a material is a metal
RESTYLED_SHARES = (0.75, 0.3)  # the share of materials of other gloss and colour, before and after they are mixed

Draw = Callable[..., Tensor]  # draws random numbers [T, *shape] from a shape


def vary_materials(maps: Tensor, side: int, rng: Generator) -> Tensor:
    """Return augmented materials [T, 10, side, side] of maps [T, 10, S, S].

    If S is at least twice the side, each material is a crop in any direction; else it is the whole material, turned by
    quarters. Half of the materials are mixed with their neighbour, evenly or by a smooth mask.
    """
    has_room = maps.shape[-1] >= 2 * side
    maps = _crop(maps, side, rng) if has_room else torch.stack([_turn(material, rng) for material in maps])
    maps = change_some(restyle, maps, RESTYLED_SHARES[0], rng)
    maps = change_some(restyle, mix_materials(recolour(maps, rng), rng), RESTYLED_SHARES[1], rng)
    return change_some(polish, maps, POLISHED_SHARE, rng)


def draw_photos(maps: Tensor, rng: Generator) -> Tensor:
    """Render photographs of maps [T, 10, S, S] with random flash, exposure, white balance and noise.

    Most photographs show the patch in a field of view of 45 degrees; in the others, crops or of other lenses, camera
    and flash are at any height of FLASH_HEIGHTS_HALF_SIDES.

    Returns:
        Linear values that were rounded to 8 bits of sRGB, [T, 3, S, S].
    """
    uniform, normal = draws_per_material(len(maps), rng)
    flash = normal(FLASH_NUMBERS) * maps.new_tensor(FLASH_DEVIATIONS) * (uniform(1) > BESIDE_LENS_SHARE)
    flash = torch.where(uniform(1) < FAR_FLASH_SHARE, _move_far(flash, uniform(1)), flash)
    stops = MAX_EXPOSURE_STOPS * (2 * uniform(1) - 1) * (uniform(1) < MISEXPOSED_SHARE)
    flash = flash + maps.new_tensor([0.0, 0.0, 0.0, math.log(2) / FLASH_LOG_GAIN]) * stops
    tint = torch.exp(TINT_LOG_DEVIATION * normal(3, 1, 1) * (uniform(1, 1, 1) < TINTED_SHARE))
    radiance = render_photo(unpack_maps(maps), decode_flash(flash, camera="raised"))
    display = linear_to_srgb((tint * radiance).clamp(0, 1))
    noise = torch.randn(display.shape, generator=rng, device=rng.device) * 0.01 * uniform(1, 1, 1)
    return srgb_to_linear(((display + noise).clamp(0, 1) * 255).round() / 255)


def _move_far(flash: Tensor, share: Tensor) -> Tensor:
    """Move flashes [T, FLASH_NUMBERS] to heights that shares [T, 1] of a logarithmic range tell, and as far aside."""
    low, high = FLASH_HEIGHTS_HALF_SIDES
    log_height = math.log(low / camera_distance()) + math.log(high / low) * share
    return torch.cat([flash[:, :2] * log_height.exp(), log_height / FLASH_LOG_HEIGHT, flash[:, 3:]], 1)


def draws_per_material(count: int, rng: Generator) -> tuple[Draw, Draw]:
    """Return two functions of a shape, which draw uniform numbers in [0, 1) and normal ones for `count` materials."""
    return functools.partial(random_tensors.draw_uniform, rng, count), functools.partial(
        random_tensors.draw_normal, rng, count
    )


def change_some(change: Callable[[Tensor, Generator], Tensor], maps: Tensor, share: float, rng: Generator) -> Tensor:
    """Apply a change to a random share of the materials [T, ...] and leave the others as they are."""
    is_chosen = torch.rand(len(maps), 1, 1, 1, generator=rng, device=rng.device) < share
    return torch.where(is_chosen, change(maps, rng), maps)


def _crop(maps: Tensor, side: int, rng: Generator) -> Tensor:
    """Cut random squares [T, 10, side, side] out of maps [T, 10, S, S], in any direction, half of them mirrored."""
    uniform, _ = draws_per_material(len(maps), rng)
    angle = 2 * math.pi * uniform()
    share = CROP_SIDES[0] + (CROP_SIDES[1] - CROP_SIDES[0]) * uniform()
    return crop_turned(maps, side, angle, share, maps.new_zeros(len(maps), 2), uniform(1, 1, 1) < 0.5, "reflection")


def crop_turned(
    maps: Tensor, side: int, angle: Tensor, share: Tensor, centre: Tensor, mirrored: Tensor, padding: str
) -> Tensor:
    """Cut turned squares [T, 10, side, side] out of maps [T, 10, S, S], and turn their normals with them.

    Args:
        maps: the packed maps.
        side: texels a side of the crops.
        angle: the angles of the crops in rad, [T].
        share: sides of the crops over sides of the maps, [T].
        centre: centres of the crops, x and y from -1 to 1, [T, 2].
        mirrored: whether crops are mirrored after they are turned, [T, 1, 1, 1].
        padding: what lies beyond the maps: `padding_mode` of torch's `grid_sample`.
    """
    cosine, sine = angle.cos(), angle.sin()
    matrix = share[:, None, None] * torch.stack([cosine, -sine, sine, cosine], 1).unflatten(1, (2, 2))
    grid = affine_grid(torch.cat([matrix, centre[:, :, None]], 2), [len(maps), 1, side, side], False)
    x, y, rest = grid_sample(maps, grid, padding_mode=padding, align_corners=False).split((1, 1, 8), 1)
    cosine, sine = cosine[:, None, None, None], sine[:, None, None, None]
    x, y = cosine * x - sine * y, sine * x + cosine * y  # rows go down, y goes up
    crops = torch.where(mirrored, torch.cat([-x, y, rest], 1).flip(3), torch.cat([x, y, rest], 1))
    return torch.cat([normalise(crops[:, :3]), crops[:, 3:]], 1)


def restyle(maps: Tensor, rng: Generator) -> Tensor:
    """Give materials [T, 10, H, W] other relief, colours and roughness, which follow the patterns of the old ones.

    The new gloss differs little from place to place, as it does more often in scanned materials than in drawn ones.
    Each change is made to a random share of the materials.
    """
    uniform, normal = draws_per_material(len(maps), rng)

    def draw_chance(share: float) -> Tensor:
        return uniform(1, 1, 1) < share

    # Relief, and the patterns that the new specular colour and roughness follow
    normals, diffuse, roughness, specular = maps.split((3, 3, 1, 3), 1)
    slopes = find_slopes(normals)
    slopes = slopes * torch.where(draw_chance(0.6), torch.exp(0.5 * normal(1, 1, 1)), 1)
    slopes = _limit_slopes(slopes, MAX_SLOPE)
    tone_pattern = _standardise((diffuse.mean(1, keepdim=True) + 1e-3).log())
    roughness_pattern = _standardise(roughness)
    relief_pattern = _standardise(avg_pool2d(slopes.square().sum(1, keepdim=True).add(1e-8).sqrt(), 9, 1, 4))
    # Specular colour: of any material from 0.02 to 0.3 or, mostly, of a dielectric, in some materials slightly coloured
    f0 = torch.where(draw_chance(0.2), torch.exp(-3.9 + 2.7 * uniform(1, 1, 1)), _draw_dielectrics(uniform))
    f0 = f0 * torch.exp(0.06 * normal(3, 1, 1) * draw_chance(0.4))
    even_specular = f0 * torch.exp(0.08 * normal(1, 1, 1) * tone_pattern + 0.05 * normal(1, 1, 1) * roughness_pattern)
    specular = torch.where(draw_chance(0.5), even_specular.clamp(0.005, 0.95), specular)
    # Roughness
    variation = (
        0.06 * normal(1, 1, 1) * tone_pattern
        + 0.06 * normal(1, 1, 1) * roughness_pattern
        + 0.05 * normal(1, 1, 1) * relief_pattern
    )
    new_roughness = (0.1 + 0.95 * uniform(1, 1, 1) + variation).clamp(0.08, 1)
    roughness = torch.where(draw_chance(0.6), new_roughness, roughness)
    # Diffuse colour: greyer, brighter or darker, in some materials nearly black, in others nearly even
    grey = diffuse.mean(1, keepdim=True)
    new_diffuse = torch.where(
        draw_chance(0.35), torch.lerp(grey.expand_as(diffuse), diffuse, 0.5 * uniform(1, 1, 1)), diffuse
    )
    new_diffuse = new_diffuse * torch.exp(0.6 * normal(1, 1, 1) - 0.4) * torch.where(draw_chance(0.15), 0.05, 1)
    diffuse = torch.where(draw_chance(0.5), new_diffuse, diffuse)
    plain_diffuse = torch.lerp(diffuse, diffuse.mean((2, 3), keepdim=True), 0.9 * uniform(1, 1, 1))
    diffuse = torch.where(draw_chance(0.3), plain_diffuse, diffuse)
    normals = normalise(torch.cat([slopes, torch.ones_like(roughness)], 1))
    return torch.cat([normals, diffuse.clamp(0, 0.98), roughness, specular.clamp(0, 0.98)], 1)


def _draw_dielectrics(uniform: Draw) -> Tensor:
    """Draw specular reflectance of dielectrics, [T, 1, 1, 1]."""
    low, high = DIELECTRIC_F0
    return low * (high / low) ** uniform(1, 1, 1)


def polish(maps: Tensor, rng: Generator) -> Tensor:
    """Make materials [T, 10, H, W] nearly flat dielectrics of one gloss, whose patterns are paint under a highlight."""
    uniform, normal = draws_per_material(len(maps), rng)
    normals, diffuse, roughness, specular = maps.split((3, 3, 1, 3), 1)
    slopes = find_slopes(normals) * torch.exp(-4 + 2.5 * uniform(1, 1, 1))
    is_metal = diffuse.mean((1, 2, 3), keepdim=True) < METAL_DIFFUSE  # colours of metals become paint
    diffuse = torch.where(is_metal, specular, diffuse) * torch.exp(0.4 * normal(1, 1, 1))
    low, high = POLISHED_ROUGHNESSES
    variation = torch.exp(0.15 * normal(1, 1, 1) * (uniform(1, 1, 1) < 0.5) * _standardise(roughness).clamp(-2, 2))
    roughness = (low * (high / low) ** uniform(1, 1, 1) * variation).clamp(0.05, 1)
    specular = _draw_dielectrics(uniform).expand_as(specular)
    normals = normalise(torch.cat([slopes, torch.ones_like(roughness)], 1))
    return torch.cat([normals, diffuse.clamp(0, 0.98), roughness, specular], 1)


def _limit_slopes(slopes: Tensor, steepest: float) -> Tensor:
    """Bound the lengths of slopes [T, 2, H, W] smoothly and keep their directions."""
    length = slopes.square().sum(1, keepdim=True).add(1e-12).sqrt()
    return slopes * (steepest * torch.tanh(length / steepest) / length)


def _standardise(values: Tensor) -> Tensor:
    """Scale values [T, 1, H, W] to mean 0 and standard deviation 1; values that are equal become 0."""
    mean, deviation = values.mean((2, 3), keepdim=True), values.std((2, 3), keepdim=True)
    return (values - mean) / (deviation + 1e-4)


def _turn(maps: Tensor, rng: Generator) -> Tensor:
    """Turn maps [10, S, S] by a random number of quarters and mirror half of them."""
    quarters, mirrored = divmod(int(torch.randint(8, (1,), generator=rng, device=rng.device)), 2)
    x, y, rest = maps[:1], maps[1:2], maps[2:]
    if mirrored:
        x, y, rest = -x.flip(2), y.flip(2), rest.flip(2)
    x, y, rest = (torch.rot90(part, quarters, (1, 2)) for part in (x, y, rest))
    for _ in range(quarters):  # anticlockwise, as rot90 with rows downwards: (x, y) goes to (-y, x)
        x, y = -y, x
    return torch.cat([x, y, rest])


def recolour(maps: Tensor, rng: Generator) -> Tensor:
    """Scale colours and roughness at random, and exchange the channels of a third of the materials."""
    count, device = len(maps), rng.device
    order = torch.rand(count, 3, generator=rng, device=device).argsort(1)
    keeps_order = torch.rand(count, 1, generator=rng, device=device) > 1 / 3
    order = torch.where(keeps_order, torch.arange(3, device=device), order)[:, :, None, None]
    gains = torch.exp(0.2 * torch.randn(count, 7, 1, 1, generator=rng, device=device))
    parts = [maps[:, :3]]
    for first, last in ((3, 6), (7, 10)):
        colour = maps[:, first:last]
        colour = colour.gather(1, order.expand_as(colour))
        parts.append((colour * gains[:, first - 3 : last - 3]).clamp(0, 0.98))
    roughness = (maps[:, 6:7] * gains[:, 3:4]).clamp(0.05, 1)
    return torch.cat([parts[0], parts[1], roughness, parts[2]], 1)


def mix_materials(maps: Tensor, rng: Generator) -> Tensor:
    """Mix half of the materials with the one before, by one share all over or by one that varies smoothly."""
    count, device = len(maps), rng.device
    coarse = torch.randn(count, 1, 4, 4, generator=rng, device=device)
    masks = torch.sigmoid(6 * interpolate(coarse, size=maps.shape[-2:], mode="bicubic"))
    even_shares = torch.rand(count, 1, 1, 1, generator=rng, device=device)
    kinds = torch.rand(count, 1, 1, 1, generator=rng, device=device)
    shares = torch.where(
        kinds < 0.5, torch.ones_like(masks), torch.where(kinds < 0.75, even_shares.expand_as(masks), masks)
    )
    mixed = torch.lerp(maps.roll(1, 0), maps, shares)
    return torch.cat([normalise(mixed[:, :3]), mixed[:, 3:]], 1)
