"""Quilts that are fetched of a photograph by places, and the network that corrects their light: closed forms."""

import numpy as np
import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.quilting import quilt, quilt_pixel_numbers
from metapp.networks.quilted import (
    CORRECTION_GAIN,
    STRIP_ROWS,
    LightGrid,
    colour_moments,
    copied_share,
    enlarge_grid,
    fetch_pieces,
    find_cuts,
    repeated_share,
    seam_strength,
    subtract_trend,
)

NETWORK = LightGrid(4, 8)


def scatter_blocks(side: int, rng: Generator) -> Tensor:
    """Draw the places [2, 64, 64] of a quilt of square blocks at random, which are not cut."""
    places = places_of(64, 64)
    quilt_of_blocks = places.clone()
    for row in range(0, 64, side):
        for column in range(0, 64, side):
            y, x = torch.randint(64 - side + 1, (2,), generator=rng).tolist()
            quilt_of_blocks[:, row : row + side, column : column + side] = places[:, y : y + side, x : x + side]
    return quilt_of_blocks


def places_of(rows: int, columns: int) -> Tensor:
    """Return the centres of cells, which fetch the photograph itself, [2, rows, columns]."""
    return torch.stack(
        torch.meshgrid((torch.arange(rows) + 0.5) / rows, (torch.arange(columns) + 0.5) / columns, indexing="ij")
    )


@pytest.fixture
def photo(rng: Generator) -> Tensor:
    return torch.rand(3, 32, 64, generator=rng)


def test_pixel_numbers_are_those_of_the_quilt() -> None:
    exemplar = np.random.default_rng(0).random((24, 20, 3))
    pictures = (
        function(exemplar, (32, 28), np.random.default_rng(1), block=10, overlap=3, tiles=True)
        for function in (quilt, quilt_pixel_numbers)
    )
    picture, numbers = pictures
    assert np.array_equal(exemplar.reshape(-1, 3)[numbers], picture)


@pytest.mark.parametrize("size", [(32, 64), (16, 32), (48, 96), (200, 100)])
def test_the_own_places_of_cells_fetch_the_photograph(size: tuple[int, int]) -> None:
    """A slope comes back as a slope at any resolution, off the edges, where the picture goes on at the opposite one."""
    slope = ((torch.arange(32)[:, None] + 0.5) / 32 + (torch.arange(64) + 0.5) / 64).expand(3, -1, -1)
    fetched = fetch_pieces(slope, places_of(16, 32), size, (16, 32))
    y, x = ((torch.arange(side) + 0.5) / side for side in size)
    inside = slice(size[0] // 8, -size[0] // 8), slice(size[1] // 8, -size[1] // 8)
    torch.testing.assert_close(fetched[0][inside], (y[:, None] + x)[inside], atol=3e-3, rtol=0)


def test_moved_places_fetch_moved_copies(photo: Tensor) -> None:
    """Places that are moved by whole px, also across opposite edges, give px of the photograph itself."""
    places = places_of(8, 16).roll((2, 5), (1, 2))
    fetched = fetch_pieces(photo, places, (32, 64), (8, 16))
    moved = photo.roll((8, 20), (1, 2))
    seams = torch.zeros(32, 64, dtype=torch.bool)  # where the edges of the photograph meet in the picture
    for row, column in ((8, 20), (0, 0), (32, 64)):
        seams[max(row - 3, 0) : row + 3], seams[:, max(column - 3, 0) : column + 3] = True, True
    torch.testing.assert_close(fetched[:, ~seams], moved[:, ~seams], atol=1e-5, rtol=0)


def test_pieces_fade_into_each_other_across_a_cut() -> None:
    photo = torch.cat([torch.zeros(3, 16, 8), torch.ones(3, 16, 8)], 2)
    places = places_of(4, 4)
    places[1, :, 0], places[1, :, 1] = 0.15, 0.15  # dark
    places[1, :, 2], places[1, :, 3] = 0.85, 0.85  # bright
    row = fetch_pieces(photo, places, (64, 64), (4, 4))[0, 32]
    assert row[10:22].abs().max() < 0.01
    assert (row[42:54] - 1).abs().max() < 0.01
    fade = row[24:40]
    assert (fade.diff() >= -0.01).all()
    assert 0.2 < float(fade[8]) < 0.8


def test_strips_do_not_show(photo: Tensor) -> None:
    """Places that move down by a cell move the quilt by the rows of a cell, though other rows begin strips."""
    places, rows = places_of(8, 16).roll(3, 2), 2 * STRIP_ROWS
    moved = fetch_pieces(photo, places.roll(1, 1), (rows, 16), (8, 16))
    torch.testing.assert_close(moved, fetch_pieces(photo, places, (rows, 16), (8, 16)).roll(rows // 8, 1))


def test_a_trend_is_subtracted_at_any_resolution() -> None:
    """A photograph of a slope loses it where its small copy has lost it."""
    slope = torch.linspace(0.2, 0.8, 64).expand(3, 32, -1)
    small = torch.nn.functional.avg_pool2d(slope[None], 4)[0]
    flat = subtract_trend(slope, small, torch.full_like(small, 0.5))
    torch.testing.assert_close(flat[:, :, 2:-2], torch.full((3, 32, 60), 0.5), atol=5e-3, rtol=0)


def test_grids_are_enlarged_periodically(rng: Generator) -> None:
    values = torch.randn(2, 2, 4, 8, generator=rng, dtype=torch.float64)
    large = enlarge_grid(values, (16, 32))
    rolled = enlarge_grid(values.roll((1, 3), (2, 3)), (16, 32))
    torch.testing.assert_close(rolled, large.roll((4, 12), (2, 3)))
    torch.testing.assert_close(enlarge_grid(values, (4, 8)), values)
    even = torch.full((1, 2, 4, 8), 0.3, dtype=torch.float64)
    torch.testing.assert_close(enlarge_grid(even, (40, 24)), torch.full((1, 2, 40, 24), 0.3, dtype=torch.float64))


def test_first_parameters_and_predictions_change_nothing(rng: Generator) -> None:
    quilts = torch.rand(3, 3, 16, 32, generator=rng)
    torch.testing.assert_close(NETWORK(NETWORK.init(rng, 3), quilts), quilts)
    predicted = NETWORK.encode(NETWORK.init_encoder(rng), quilts, colour_moments(quilts))
    assert predicted["z"].shape == (3, 2, 4, 8)
    assert not predicted["z"].any()


def test_parameters_change_contrast_and_brightness(rng: Generator) -> None:
    """An even grid changes all of a quilt by the closed form, and tasks do not influence each other."""
    quilts = 0.4 + 0.2 * torch.rand(2, 3, 16, 32, generator=rng)
    theta = {"z": torch.stack([torch.ones(4, 8), torch.full((4, 8), 2.0)]).expand(2, -1, -1, -1).clone()}
    theta["z"][1] = 0
    first, second = NETWORK(theta, quilts)
    mean = quilts[0].mean((1, 2), keepdim=True)
    expected = mean + (quilts[0] - mean) * torch.tensor(2 * CORRECTION_GAIN).exp() + 2 * CORRECTION_GAIN
    torch.testing.assert_close(first, expected)
    torch.testing.assert_close(second, quilts[1])


def test_gradients_of_the_correction_agree_with_differences(rng: Generator) -> None:
    quilts = 0.3 + 0.4 * torch.rand(1, 3, 8, 16, generator=rng, dtype=torch.float64)
    z = torch.randn(1, 2, 4, 8, generator=rng, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda z: NETWORK({"z": z}, quilts), (z,))


def test_encoders_move_with_quilts(rng: Generator) -> None:
    """A quilt that is moved by whole cells has moved parameters: predictions do not depend on the place."""
    encoder = NETWORK.init_encoder(rng)
    encoder = {key: torch.randn(value.shape, generator=rng) / 10 for key, value in encoder.items()}
    quilts, moments = torch.rand(1, 3, 16, 32, generator=rng), torch.rand(1, 6, generator=rng)
    predicted, moved = (NETWORK.encode(encoder, quilts.roll(shift, (2, 3)), moments)["z"] for shift in ((0, 0), (4, 8)))
    torch.testing.assert_close(moved, predicted.roll((1, 2), (2, 3)))


def test_cells_at_cuts_are_no_copies() -> None:
    """Of the photograph itself these are the cells at its edges, where the tile does not go on; of two pieces more."""
    places = places_of(10, 16)
    assert copied_share(places, (10, 16)) == pytest.approx(8 * 14 / 160)
    moved = places.clone()
    moved[1, :, 8:] -= 3 / 16
    assert copied_share(moved, (10, 16)) == pytest.approx(8 * 12 / 160)
    assert copied_share(places.roll((4, 5), (1, 2)), (10, 16)) == pytest.approx(8 * 14 / 160)


# What an eye sees of pieces


@pytest.mark.parametrize("size", [(96, 96), (70, 120)])
def test_blocks_that_are_shown_already_are_taken_less(size: tuple[int, int]) -> None:
    """A weight lets less come back in tiles, which still agree across their cuts."""
    pixels = np.random.default_rng(3).random((96, 96, 3))
    shares = []
    for weight in (0.0, 2.0):
        repeated = []
        for seed in range(4):
            rng = np.random.default_rng(seed)
            numbers = quilt_pixel_numbers(pixels, size, rng, block=24, overlap=8, tiles=True, repetition_weight=weight)
            repeated.append(1 - len(np.unique(numbers)) / numbers.size)
        shares.append(sum(repeated) / len(repeated))
    assert shares[1] < 0.8 * shares[0]


def test_cuts_are_where_neighbours_come_from_other_pieces() -> None:
    places = places_of(10, 16)
    down, right = find_cuts(places, (10, 16))
    assert down.nonzero()[:, 0].unique().tolist() == [9]  # where the tile meets itself
    assert right.nonzero()[:, 1].unique().tolist() == [15]
    places[0, 4:] -= 0.3
    assert find_cuts(places, (10, 16))[0].any(1).nonzero().flatten().tolist() == [3, 9]


def test_a_piece_that_comes_back_is_repeated_and_the_photograph_is_not() -> None:
    """Half of a quilt that shows one half twice comes back; a piece of a tenth counts a tenth, wherever it lies."""
    places = places_of(40, 20)
    assert repeated_share(places, (40, 20)) == 0
    twice = places.clone()
    twice[:, 22:40] = places[:, :18]
    assert repeated_share(twice, (40, 20)) == pytest.approx(18 / 40)
    small = places.clone()
    small[:, 30:38, 10:20] = places[:, 3:11, 2:12]
    assert repeated_share(small, (40, 20)) == pytest.approx(0.1)
    assert repeated_share(small.roll((13, 7), (1, 2)), (40, 20)) == pytest.approx(0.1)
    stretched = places.clone()
    stretched[0] *= 0.93  # neighbours show a place twice, as in stretched pieces
    assert repeated_share(stretched, (40, 20)) == 0


@pytest.mark.parametrize("kind", ["noise", "clouds"])
def test_changes_across_cuts_of_blocks_at_random_are_strong(kind: str, rng: Generator) -> None:
    """Smooth pictures show them most; a quilt that is cut where blocks agree, and the photograph, show less."""
    noise = torch.rand(3, 64, 64, generator=rng)
    smooth = noise
    side = 5 if kind == "noise" else 9
    for _ in range(3):
        smooth = torch.nn.functional.avg_pool2d(smooth[None], side, 1, side // 2)[0]
    photo = (0.5 + (smooth - smooth.mean()) / (6 * smooth.std())).clamp(0, 1)
    pixels, numbers_rng = photo.permute(1, 2, 0).numpy(), np.random.default_rng(0)
    numbers = quilt_pixel_numbers(pixels, (64, 64), numbers_rng, block=24, overlap=8, tiles=True)
    strengths = [
        seam_strength(photo, fetch_pieces(photo, places, (64, 64), (64, 64)), places, (64, 64))
        for places in (scatter_blocks(16, rng), places_of(64, 64).flatten(1)[:, torch.from_numpy(numbers)])
    ]
    assert strengths[0] > 1.5
    assert strengths[1] < 0.8 * strengths[0]


def test_changes_across_cuts_are_relative_to_the_photograph() -> None:
    """Of a picture of one colour nothing is seen, and along joints, which are edges in the photograph, nothing new."""
    places, flat = places_of(32, 32), torch.full((3, 32, 32), 0.4)
    ramp = torch.linspace(0, 1, 32).expand(3, 32, 32)
    assert seam_strength(ramp, ramp, places, (32, 32)) > 3  # where the photograph meets itself
    assert seam_strength(flat, flat, places.roll(9, 2), (32, 32)) < 0.1
    stripes = (torch.arange(32) // 8 % 2).float().expand(3, 32, 32)
    moved = places.clone()
    moved[1, :, 16:] -= 0.5  # the left half twice: the cut lies where a stripe ends anyway
    assert seam_strength(stripes, stripes, moved, (32, 32)) == pytest.approx(1, abs=0.1)
    shown = fetch_pieces(stripes, moved, (32, 32), (32, 32))
    brighter = shown.clone()
    brighter[:, :, 16:] += 0.8
    assert seam_strength(stripes, brighter, moved, (32, 32)) > 1.3
