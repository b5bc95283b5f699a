"""Data augmentation of materials: turned, mirrored, mixed, recoloured, photographed with another flash."""

from __future__ import annotations

import torch
from torch import Generator, Tensor
from torch.nn.functional import interpolate

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.flash import ASIDE, BESIDE_LENS, BRIGHTER, HIGHER, unpack
from metapp.apps.svbrdf_nonstationary.maps import ACROSS, BRIGHT, FLASH, UP, flash_of, of_length_1, photographed

# of the numbers that describe a flash, as drawn materials are photographed
JITTER = (ASIDE / ACROSS, ASIDE / ACROSS, HIGHER / UP, BRIGHTER / BRIGHT)


def varied(maps: Tensor, rng: Generator) -> tuple[Tensor, Tensor]:
    """Augmented materials [T, 10, S, S] and their photographs, linear [T, 3, S, S], of 8 bits.

    Half of them are mixed with their neighbour, evenly or by a smooth mask.
    """
    maps = _mixed(_recoloured(torch.stack([_turned(each, rng) for each in maps]), rng), rng)
    count, device = len(maps), maps.device
    flash = torch.randn(count, FLASH, generator=rng, device=device) * maps.new_tensor(JITTER)
    flash = flash * (torch.rand(count, 1, generator=rng, device=device) > BESIDE_LENS)
    radiance = photographed(unpack(maps), flash_of(flash))
    shown = linear_to_srgb(radiance.clamp(0, 1))
    noise = torch.randn(shown.shape, generator=rng, device=device) * 0.01
    noise = noise * torch.rand(count, 1, 1, 1, generator=rng, device=device)
    return maps, srgb_to_linear(((shown + noise).clamp(0, 1) * 255).round() / 255)


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


def _recoloured(maps: Tensor, rng: Generator) -> Tensor:
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


def _mixed(maps: Tensor, rng: Generator) -> Tensor:
    """Half of the materials mixed with the next one, with one share all over or one that varies smoothly."""
    count, device = len(maps), rng.device
    coarse = torch.randn(count, 1, 4, 4, generator=rng, device=device)
    masks = torch.sigmoid(6 * interpolate(coarse, size=maps.shape[-2:], mode="bicubic"))
    even = torch.rand(count, 1, 1, 1, generator=rng, device=device)
    kind = torch.rand(count, 1, 1, 1, generator=rng, device=device)
    share = torch.where(kind < 0.5, torch.ones_like(masks), torch.where(kind < 0.75, even.expand_as(masks), masks))
    mixed = torch.lerp(maps.roll(1, 0), maps, share)
    return torch.cat([of_length_1(mixed[:, :3]), mixed[:, 3:]], 1)
