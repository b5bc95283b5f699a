"""Data augmentation of whole materials: pieces, polish, windows and mixtures."""

import torch
from torch import Generator

from metapp.appearance.flash import texel_positions
from metapp.apps.svbrdf_nonstationary.pretrained.augmentation import (
    LOG_FLATTENING,
    MIN_SIDE,
    blend_materials,
    crop_pieces,
    crop_windows,
    exchange_relief,
    flatten_relief,
)


def test_pieces_turn_normals_with_what_they_are_of(rng: Generator) -> None:
    """The normals of planes lean as their heights fall, in every direction, mirrored or not."""
    across, up = texel_positions(64, 64)
    slopes = torch.randn(12, 2, generator=rng)
    heights = slopes[:, 0, None, None] * across + slopes[:, 1, None, None] * up
    normal = torch.nn.functional.normalize(torch.cat([-slopes, torch.ones(12, 1)], 1), dim=1)
    maps = torch.cat([normal[:, :, None, None].expand(-1, -1, 64, 64), heights[:, None].expand(-1, 7, -1, -1)], 1)
    piece = crop_pieces(maps, 16, rng)
    fall_x = piece[:, 3, 8, 7] - piece[:, 3, 8, 8]
    fall_y = piece[:, 3, 8, 8] - piece[:, 3, 7, 8]
    fall = torch.nn.functional.normalize(torch.stack([fall_x, fall_y], 1), dim=1)
    lean = torch.nn.functional.normalize(piece[:, :2, 8, 8], dim=1)
    torch.testing.assert_close(lean, fall, atol=1e-3, rtol=0)
    torch.testing.assert_close(piece[:, 2, 8, 8], normal[:, 2])
    assert piece[:, 3].std() > 0.1


def test_pieces_show_up_to_all_of_the_maps(rng: Generator) -> None:
    """From LEAST of the side to all of it, and nothing beyond; such as are turned have less room."""
    across, up = texel_positions(64, 64)
    maps = torch.stack([torch.zeros_like(up), torch.zeros_like(up), torch.ones_like(up), across, up, *[across] * 5])
    piece = crop_pieces(maps.expand(200, -1, -1, -1), 64, rng)[:, 3:5]
    sides = (piece[:, :, 0, 0] - piece[:, :, 0, -1]).norm(dim=1) / 2
    assert MIN_SIDE - 0.02 < sides.min() < 0.45
    assert 0.9 < sides.max() < 1.001
    assert piece.abs().max() <= 1


def test_polished_materials_keep_all_but_their_slopes(rng: Generator) -> None:
    maps = torch.rand(300, 10, 4, 4, generator=rng)
    maps[:, :3] = torch.nn.functional.normalize(maps[:, :3] + torch.tensor([-0.5, -0.5, 0.5])[:, None, None], dim=1)
    flat = flatten_relief(maps, rng)
    assert torch.equal(flat[:, 3:], maps[:, 3:])
    torch.testing.assert_close(flat[:, :3].norm(dim=1), torch.ones(300, 4, 4))
    ratio = (flat[:, :2] / flat[:, 2:3] / (maps[:, :2] / maps[:, 2:3])).log()
    torch.testing.assert_close(ratio, ratio[:, :1, :1, :1].expand_as(ratio), atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(ratio.min(), torch.tensor(LOG_FLATTENING[0]), atol=0.1, rtol=0)
    torch.testing.assert_close(ratio.max(), torch.tensor(LOG_FLATTENING[1]), atol=0.1, rtol=0)


def test_windows_come_from_everywhere_and_know_where(rng: Generator) -> None:
    side = 8
    rows = torch.arange(20.0)[:, None].expand(20, 20)
    seen = crop_windows(torch.stack([rows, rows.T]).expand(200, -1, -1, -1), side, rng)
    assert torch.equal(seen[:, 0, 1:] - seen[:, 0, :-1], torch.ones(200, side - 1, side))
    for corner in (seen[:, 0, 0, 0], seen[:, 1, 0, 0]):
        assert (corner.min(), corner.max()) == (0, 20 - side)


def test_relief_beside_other_colours_keeps_what_is_known_of_it(rng: Generator) -> None:
    maps = torch.arange(40.0)[:, None, None, None].expand(-1, 10, 2, 2)
    map_weights = torch.arange(40.0)[:, None].expand(-1, 4)
    mixed, of_mixed = exchange_relief(maps, map_weights, rng)
    assert torch.equal(mixed[:, 3:], maps[:, 3:])
    assert torch.equal(mixed[:, 0, 0, 0], of_mixed[:, 3])
    assert 0.1 < float((mixed[:, 0, 0, 0] != maps[:, 0, 0, 0]).float().mean()) < 0.6


def test_mixed_materials_keep_weights_of_maps_known_in_both(rng: Generator) -> None:
    """Maps that are as they were keep what is known of them; the others lie between two materials."""
    maps = torch.arange(1, 41.0)[:, None, None, None].expand(-1, 10, 8, 8)
    map_weights = (torch.arange(40)[:, None] % torch.tensor([2, 3, 4, 5]) > 0).float()
    both, of_both = blend_materials(maps, map_weights, rng)
    alone = (both[:, 3] == maps[:, 3]).flatten(1).all(1)
    assert 0.3 < float(alone.float().mean()) < 0.7
    assert torch.equal(of_both[alone], map_weights[alone])
    assert torch.equal(of_both[~alone], torch.minimum(map_weights, map_weights.roll(1, 0))[~alone])
    low, high = torch.minimum(maps, maps.roll(1, 0)), torch.maximum(maps, maps.roll(1, 0))
    assert ((both >= low - 1e-4) & (both <= high + 1e-4))[:, 3:].all()
    torch.testing.assert_close(both[:, :3].norm(dim=1), torch.ones(40, 8, 8))
