"""Data augmentation of materials: turned, mixed, of other gloss and colour, photographed anew."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import torch
from torch import Generator, Tensor
from torch.nn.functional import affine_grid, avg_pool2d, grid_sample, interpolate

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.flash import ASIDE, BESIDE_LENS, BRIGHTER, HIGHER, unpack
from metapp.apps.svbrdf_nonstationary.maps import ACROSS, BRIGHT, FLASH, UP, flash_of, of_length_1, photographed
from metapp.learning import draws

# of the numbers that describe a flash, as drawn materials are photographed
JITTER = (ASIDE / ACROSS, ASIDE / ACROSS, HIGHER / UP, BRIGHTER / BRIGHT)
CROPPED = (0.35, 0.7)  # of the maps' side, in which a square of any direction has room
EXPOSED, STOPS = 0.2, 1.1  # the share of photographs that are exposed wrongly, by up to so many stops
TINTED, TINT = 0.3, 0.04  # the share whose white balance is off, and the log of how much
STEEPEST_SLOPE = 2.0  # slope
RESTYLED = (0.75, 0.3)  # the share of materials of other gloss and colour, before and after they are mixed

Draw = Callable[..., Tensor]


def varied(maps: Tensor, side: int, rng: Generator) -> Tensor:
    """Augmented materials [T, 10, side, side].

    Half of them are mixed with their neighbour, evenly or by a smooth mask. Of maps [T, 10, S, S], S at least twice
    the side, they are crops in any direction, else the whole, turned by quarters.
    """
    if maps.shape[-1] >= 2 * side:
        maps = _cropped(maps, side, rng)
    else:
        maps = torch.stack([_turned(each, rng) for each in maps])
    maps = some(restyled, maps, RESTYLED[0], rng)
    return some(restyled, mixed(recoloured(maps, rng), rng), RESTYLED[1], rng)


def photographs(maps: Tensor, rng: Generator) -> Tensor:
    """Linear photographs [T, 3, S, S] of 8 bits: any flash and exposure, with noise."""
    uniform, normal = draws_of(len(maps), rng)
    flash = normal(FLASH) * maps.new_tensor(JITTER) * (uniform(1) > BESIDE_LENS)
    stops = STOPS * (2 * uniform(1) - 1) * (uniform(1) < EXPOSED)
    flash = flash + maps.new_tensor([0.0, 0.0, 0.0, math.log(2) / BRIGHT]) * stops
    tint = torch.exp(TINT * normal(3, 1, 1) * (uniform(1, 1, 1) < TINTED))
    display = linear_to_srgb((tint * photographed(unpack(maps), flash_of(flash))).clamp(0, 1))
    noise = torch.randn(display.shape, generator=rng, device=rng.device) * 0.01 * uniform(1, 1, 1)
    return srgb_to_linear(((display + noise).clamp(0, 1) * 255).round() / 255)


def draws_of(count: int, rng: Generator) -> tuple[Draw, Draw]:
    """Functions of a shape that draw evenly from 0 to 1, and normally, for each of so many materials."""
    return functools.partial(draws.uniform, rng, count), functools.partial(draws.normal, rng, count)


def some(change: Callable[[Tensor, Generator], Tensor], maps: Tensor, share: float, rng: Generator) -> Tensor:
    """A share of the materials [T, ...] after a change of them all."""
    chosen = torch.rand(len(maps), 1, 1, 1, generator=rng, device=rng.device) < share
    return torch.where(chosen, change(maps, rng), maps)


def _cropped(maps: Tensor, side: int, rng: Generator) -> Tensor:
    """Crops [T, 10, side, side] of maps [T, 10, S, S], in any direction, half of them mirrored."""
    uniform, _ = draws_of(len(maps), rng)
    angle = 2 * math.pi * uniform()
    share = CROPPED[0] + (CROPPED[1] - CROPPED[0]) * uniform()
    return turned_crops(maps, side, angle, share, maps.new_zeros(len(maps), 2), uniform(1, 1, 1) < 0.5, "reflection")


def turned_crops(
    maps: Tensor, side: int, angle: Tensor, share: Tensor, centre: Tensor, mirrored: Tensor, padding: str
) -> Tensor:
    """Crops [T, 10, side, side] of maps [T, 10, S, S], turned by `angle` [T], with the normals that these then have.

    `share` [T] is a crop's side over the maps', `centre` [T, 2] from -1 to 1, `mirrored` [T, 1, 1, 1] true or false.
    """
    cosine, sine = angle.cos(), angle.sin()
    turn = share[:, None, None] * torch.stack([cosine, -sine, sine, cosine], 1).unflatten(1, (2, 2))
    grid = affine_grid(torch.cat([turn, centre[:, :, None]], 2), [len(maps), 1, side, side], False)
    x, y, rest = grid_sample(maps, grid, padding_mode=padding, align_corners=False).split((1, 1, 8), 1)
    cosine, sine = cosine[:, None, None, None], sine[:, None, None, None]
    x, y = cosine * x - sine * y, sine * x + cosine * y  # rows go down, y goes up
    crops = torch.where(mirrored, torch.cat([-x, y, rest], 1).flip(3), torch.cat([x, y, rest], 1))
    return torch.cat([of_length_1(crops[:, :3]), crops[:, 3:]], 1)


def restyled(maps: Tensor, rng: Generator) -> Tensor:
    """Materials of the same pattern, steeper or flatter, darker, evenly specular, with roughness that follows it.

    Scanned materials are like this more often than drawn ones: where they differ from place to place, it is by little.
    """
    uniform, normal = draws_of(len(maps), rng)

    def chance(share: float) -> Tensor:
        return uniform(1, 1, 1) < share

    normals, diffuse, roughness, specular = maps.split((3, 3, 1, 3), 1)
    slopes = normals[:, :2] / normals[:, 2:].clamp_min(0.2)
    slopes = slopes * torch.where(chance(0.6), torch.exp(0.5 * normal(1, 1, 1)), 1)
    slopes = _at_most(slopes, STEEPEST_SLOPE)
    tone = _standard((diffuse.mean(1, keepdim=True) + 1e-3).log())
    rough = _standard(roughness)
    relief = _standard(avg_pool2d(slopes.square().sum(1, keepdim=True).add(1e-8).sqrt(), 9, 1, 4))
    level = torch.where(chance(0.5), torch.exp(-3.9 + 2.7 * uniform(1, 1, 1)), 0.03 + 0.03 * uniform(1, 1, 1))
    level = level * torch.exp(0.06 * normal(3, 1, 1) * chance(0.4))
    even = level * torch.exp(0.08 * normal(1, 1, 1) * tone + 0.05 * normal(1, 1, 1) * rough)
    specular = torch.where(chance(0.5), even.clamp(0.005, 0.95), specular)
    parts = 0.06 * normal(1, 1, 1) * tone + 0.06 * normal(1, 1, 1) * rough + 0.05 * normal(1, 1, 1) * relief
    follows = (0.1 + 0.95 * uniform(1, 1, 1) + parts).clamp(0.08, 1)
    roughness = torch.where(chance(0.6), follows, roughness)
    grey = diffuse.mean(1, keepdim=True)
    other = torch.where(chance(0.35), torch.lerp(grey.expand_as(diffuse), diffuse, 0.5 * uniform(1, 1, 1)), diffuse)
    other = other * torch.exp(0.6 * normal(1, 1, 1) - 0.4) * torch.where(chance(0.15), 0.05, 1)
    diffuse = torch.where(chance(0.5), other, diffuse)
    plain = torch.lerp(diffuse, diffuse.mean((2, 3), keepdim=True), 0.9 * uniform(1, 1, 1))
    diffuse = torch.where(chance(0.3), plain, diffuse)
    normals = of_length_1(torch.cat([slopes, torch.ones_like(roughness)], 1))
    return torch.cat([normals, diffuse.clamp(0, 0.98), roughness, specular.clamp(0, 0.98)], 1)


def _at_most(slopes: Tensor, steepest: float) -> Tensor:
    """Slopes [T, 2, H, W] of the same directions, smoothly bounded."""
    length = slopes.square().sum(1, keepdim=True).add(1e-12).sqrt()
    return slopes * (steepest * torch.tanh(length / steepest) / length)


def _standard(values: Tensor) -> Tensor:
    """Values [T, 1, H, W] of mean 0 and standard deviation 1, or 0 if they are all the same."""
    mean, std = values.mean((2, 3), keepdim=True), values.std((2, 3), keepdim=True)
    return (values - mean) / (std + 1e-4)


def _turned(maps: Tensor, rng: Generator) -> Tensor:
    """Maps [10, S, S] after some quarter turns, half of them mirrored."""
    quarters, mirrored = divmod(int(torch.randint(8, (1,), generator=rng, device=rng.device)), 2)
    x, y, rest = maps[:1], maps[1:2], maps[2:]
    if mirrored:
        x, y, rest = -x.flip(2), y.flip(2), rest.flip(2)
    x, y, rest = (torch.rot90(each, quarters, (1, 2)) for each in (x, y, rest))
    for _ in range(quarters):  # anticlockwise, as rot90 with rows downwards: (x, y) goes to (-y, x)
        x, y = -y, x
    return torch.cat([x, y, rest])


def recoloured(maps: Tensor, rng: Generator) -> Tensor:
    """Colours scaled, a third of them with channels exchanged, and roughness scaled."""
    count, device = len(maps), rng.device
    order = torch.rand(count, 3, generator=rng, device=device).argsort(1)
    kept = torch.rand(count, 1, generator=rng, device=device) > 1 / 3
    order = torch.where(kept, torch.arange(3, device=device), order)[:, :, None, None]
    gains = torch.exp(0.2 * torch.randn(count, 7, 1, 1, generator=rng, device=device))
    parts = [maps[:, :3]]
    for first, last in ((3, 6), (7, 10)):
        colour = maps[:, first:last]
        colour = colour.gather(1, order.expand_as(colour))
        parts.append((colour * gains[:, first - 3 : last - 3]).clamp(0, 0.98))
    rough = (maps[:, 6:7] * gains[:, 3:4]).clamp(0.05, 1)
    return torch.cat([parts[0], parts[1], rough, parts[2]], 1)


def mixed(maps: Tensor, rng: Generator) -> Tensor:
    """Half of the materials mixed with the next one, with one share all over or one that varies smoothly."""
    count, device = len(maps), rng.device
    coarse = torch.randn(count, 1, 4, 4, generator=rng, device=device)
    masks = torch.sigmoid(6 * interpolate(coarse, size=maps.shape[-2:], mode="bicubic"))
    even = torch.rand(count, 1, 1, 1, generator=rng, device=device)
    kind = torch.rand(count, 1, 1, 1, generator=rng, device=device)
    share = torch.where(kind < 0.5, torch.ones_like(masks), torch.where(kind < 0.75, even.expand_as(masks), masks))
    both = torch.lerp(maps.roll(1, 0), maps, share)
    return torch.cat([of_length_1(both[:, :3]), both[:, 3:]], 1)
