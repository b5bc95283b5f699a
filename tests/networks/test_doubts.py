"""Doubts about fits, on pictures and maps that were made to be right or wrong."""

import re

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.flash import Maps
from metapp.networks.doubts import (
    BLOB_CONTRAST,
    CLIPPED_SHARE,
    EVEN_CONTRAST,
    LEAST_ORDER,
    of_blobs,
    of_highlight,
    of_order,
    uneven,
)
from metapp.registry import registry

SIZE = 128


def noise(seed: int, amount: float = 0.02) -> Tensor:
    return amount * torch.randn(3, SIZE, SIZE, generator=Generator().manual_seed(seed))


def bricks(offset: int = 0) -> Tensor:
    """Courses of 16 px [3, SIZE, SIZE], bricks of 32 px in running bond, from another place on."""
    at = torch.arange(SIZE) + offset
    y, x = at[:, None] % 32, at[None, :]
    joint = ((y % 16) < 3) | (((x + 16 * (y >= 16)) % 32) < 3)
    return torch.where(joint, 0.75, 0.4).expand(3, -1, -1) + noise(offset)


# Regular structure


def test_what_keeps_regular_structure_is_not_doubted_nor_what_had_none() -> None:
    for photo, made in ((bricks(), bricks(5)), (0.5 + noise(1), bricks()), (0.5 + noise(1), 0.5 + noise(2))):
        assert of_order("texture", photo, made) == []


@pytest.mark.parametrize("app", ["texture", "svbrdf_stationary"])
def test_what_loses_regular_structure_is_told_how_much_and_what_copies_it(app: str) -> None:
    mixed = bricks().flatten(1)[:, torch.randperm(SIZE * SIZE, generator=Generator().manual_seed(0))]
    (clause,) = of_order(app, bricks(), mixed.unflatten(1, (SIZE, SIZE)))
    kept = re.fullmatch(
        rf"keeps (\S+) of the photo's regular structure \(`metapp baseline {app} INPUT --method (\w+)` copies it\)",
        clause,
    )
    assert kept
    assert 0 <= float(kept[1]) < LEAST_ORDER
    assert kept[2] in registry().baselines.of(app)


# Highlights


@pytest.mark.parametrize(("share", "clauses"), [(0.0, 0), (0.9 * CLIPPED_SHARE, 0), (1.2 * CLIPPED_SHARE, 1), (0.3, 1)])
def test_highlights_are_doubted_where_enough_of_the_photo_is_clipped(share: float, clauses: int) -> None:
    photo = torch.full((3, 100, 100), 200, dtype=torch.uint8)
    photo.flatten(1)[:, : round(share * 100 * 100)] = 255
    found = of_highlight(photo)
    assert len(found) == clauses
    assert all(f"clipped in {100 * share:.2g} % of its px, so F0 is a lower bound" in clause for clause in found)


def test_a_channel_that_is_clipped_alone_is_a_colour() -> None:
    photo = torch.full((3, 100, 100), 255, dtype=torch.uint8)
    photo[1:] = 90
    assert of_highlight(photo) == []


# Blobs


def flat(photo: Tensor) -> Maps:
    """Maps that vary as a photo does, or not at all."""
    one = torch.ones(1, SIZE, SIZE)
    return Maps(photo**2.2, 0.04 * one, 0.4 * one, torch.cat([0 * one, 0 * one, one]))


def bump(height: float, size: float = 12.0) -> Tensor:
    """One round bump [1, SIZE, SIZE] of so many px."""
    at = torch.arange(SIZE) - 70.0
    return height * torch.exp(-(at[:, None].square() + at.square()) / (2 * size**2))[None]


def test_maps_that_vary_as_their_photo_are_not_doubted() -> None:
    for photo in (bricks(), 0.5 + noise(3), (0.5 + bump(0.3) + noise(4)).clamp(0, 1)):
        assert of_blobs(photo, flat(photo)) == []


@pytest.mark.parametrize("name", ["diffuse", "specular", "roughness"])
def test_a_blob_in_a_map_is_named(name: str) -> None:
    photo = 0.5 + noise(5)
    maps = flat(photo)
    blob = maps._replace(**{name: (getattr(maps, name) + bump(0.3)).clamp(0, 1)})
    (clause,) = of_blobs(photo, blob)
    assert re.fullmatch(rf"blobs in {name} that the photo does not show, \d+\.\d times its contrast", clause)
    shown = photo + bump(0.4)
    assert uneven(shown) > uneven(photo) + EVEN_CONTRAST
    assert of_blobs(shown, blob) == []  # as the photo shows one


def test_a_slow_change_and_grain_are_no_blobs() -> None:
    photo, maps = 0.5 + noise(6), flat(0.5 + noise(6))
    slope = torch.linspace(-0.1, 0.1, SIZE).expand(1, SIZE, SIZE)
    assert uneven(slope) < BLOB_CONTRAST * EVEN_CONTRAST
    assert of_blobs(photo, maps._replace(roughness=maps.roughness + slope + noise(7, 0.1)[:1])) == []
