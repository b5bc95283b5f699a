"""Lattices of pictures, their periodic parts, and how much order a picture keeps."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from metapp.appearance import order

SIZE = 128


def waves_of(basis: Tensor, generator: torch.Generator, finest: float = 0.2) -> Tensor:
    """Random amplitudes of the waves on a lattice that are coarse enough, [K, 2, 3]."""
    frequency = order.harmonics(basis) @ basis
    coarse = (frequency.norm(dim=1) <= finest)[:, None, None]
    return torch.randn(order.waves(), 2, 3, generator=generator, dtype=basis.dtype) * coarse / 10


def lattices(vectors: Tensor, other: Tensor) -> bool:
    """Whether two bases, close to integers of each other, are of one lattice."""
    times = torch.linalg.solve(vectors.T, other.T)
    return (
        bool((times - times.round()).abs().max() < 0.06) and abs(abs(float(torch.linalg.det(times.round()))) - 1) < 0.1
    )


@pytest.mark.parametrize(
    "vectors",
    [
        ((16.0, 0.0), (0.0, 21.0)),
        ((11.0, 14.0), (-12.0, 13.0)),
        ((17.3, 3.1), (2.2, 24.6)),
        ((9.0, 15.0), (9.0, -15.0)),
    ],
)
def test_lattice_of_a_periodic_picture_is_found(vectors: tuple[tuple[float, float], tuple[float, float]]) -> None:
    generator = torch.Generator().manual_seed(3)
    basis = order.frequencies_of(torch.tensor(vectors, dtype=torch.float64))
    picture = 0.5 + order.drawn(basis, waves_of(basis, generator), (SIZE, SIZE))
    picture = picture + 0.05 * torch.randn(picture.shape, generator=generator)
    found = order.lattice_of(picture)
    assert found.score > 0.4
    assert lattices(found.vectors, torch.tensor(vectors, dtype=torch.float64))


def test_pictures_without_order_have_none() -> None:
    generator = torch.Generator().manual_seed(0)
    for blurred in (0, 3, 9):
        noise = torch.rand(3, SIZE, SIZE, generator=generator)
        noise = torch.nn.functional.avg_pool2d(noise, 2 * blurred + 1, 1, blurred, count_include_pad=False)
        assert order.lattice_of(noise).score < order.ORDERED[1]
        assert float(order.periodic_part(noise).strength) < 0.3
    assert float(order.periodic_part(torch.full((3, SIZE, SIZE), 0.4)).strength) == 0


def test_periodic_part_is_what_repeats() -> None:
    """Of a periodic picture it is the picture, to the noise; its waves are those that the picture was made of."""
    generator = torch.Generator().manual_seed(1)
    basis = order.frequencies_of(torch.tensor([[16.4, 1.2], [-2.3, 21.7]], dtype=torch.float64))
    clean = order.drawn(basis, waves_of(basis, generator), (SIZE, SIZE))
    picture = 0.5 + clean + 0.02 * torch.randn(clean.shape, generator=generator)
    found = order.periodic_part(picture)
    assert float(found.strength) > 0.9
    drawn = order.drawn(found.basis, found.waves, (SIZE, SIZE))
    assert float((drawn - clean).std() / clean.std()) < 0.12


def test_drawn_moves_with_its_offset_and_tiles_when_snapped() -> None:
    generator = torch.Generator().manual_seed(2)
    basis = order.frequencies_of(torch.tensor([[16.4, 1.2], [-2.3, 21.7]], dtype=torch.float64))
    waves = waves_of(basis, generator)
    whole = order.drawn(basis, waves, (64, 64))
    moved = order.drawn(basis, waves, (60, 50), torch.tensor([4.0, 14.0]))
    torch.testing.assert_close(moved, whole[:, 4:, 14:])
    tile = order.snapped(basis, (64, 96))
    repeated = order.drawn(tile, waves, (128, 192))
    torch.testing.assert_close(repeated[:, :64, :96], repeated[:, 64:, 96:])
    assert float((tile - basis).abs().max()) <= 0.5 / 64
    batched = order.drawn(basis.expand(2, 3, 2, 2), waves.expand(2, 3, -1, -1, -1), (64, 64))
    torch.testing.assert_close(batched[1, 2], whole)


def test_unlike_compares_the_periodic_part_alone() -> None:
    generator = torch.Generator().manual_seed(4)
    basis = order.frequencies_of(torch.tensor([[12.0, 0.0], [3.0, 17.0]], dtype=torch.float64))
    periodic = order.drawn(basis, waves_of(basis, generator), (SIZE, SIZE))
    noise = 0.05 * torch.randn(periodic.shape, generator=generator)
    assert float(order.unlike(0.3 + periodic, periodic, basis)) < 1e-6
    assert float(order.unlike(0.3 + periodic + noise, periodic, basis)) < 0.05
    assert float(order.unlike(torch.full_like(periodic, 0.3), periodic, basis)) == pytest.approx(1, abs=1e-6)
    assert float(order.unlike(0.5 * periodic, periodic, basis)) == pytest.approx(0.25, abs=1e-4)


def test_order_kept_is_one_for_as_much_order_and_none_for_noise() -> None:
    generator = torch.Generator().manual_seed(5)
    basis = order.frequencies_of(torch.tensor([[16.0, 0.0], [5.0, 21.0]], dtype=torch.float64))
    waves = waves_of(basis, generator)

    def picture(offset: float) -> Tensor:
        clean = order.drawn(basis, waves, (SIZE, SIZE), torch.tensor([offset, 2 * offset]))
        return 0.5 + clean + 0.1 * torch.randn(clean.shape, generator=generator)

    exemplar = order.lattice_of(picture(0.0))
    assert order.order_kept(exemplar, picture(7.3)) == pytest.approx(1, abs=0.1)
    assert order.order_kept(exemplar, torch.rand(3, SIZE, SIZE, generator=generator)) < 0.15
    nothing = order.lattice_of(torch.rand(3, SIZE, SIZE, generator=generator))
    assert math.isnan(order.order_kept(nothing, picture(0.0)))


def test_reduced_basis_is_the_shortest_of_its_lattice() -> None:
    generator = torch.Generator().manual_seed(6)
    for _ in range(20):
        vectors = torch.randint(-20, 21, (2, 2), generator=generator).double()
        if float(torch.linalg.det(vectors).abs()) < 1:
            continue
        short = order.reduced(vectors)
        assert lattices(vectors, short)
        steps = torch.cartesian_prod(torch.arange(-3.0, 4), torch.arange(-3.0, 4)).double()
        lengths = (steps[(steps != 0).any(1)] @ short).norm(dim=1)
        assert float(short[0].norm()) == pytest.approx(float(lengths.min()))
        assert abs(float(short[0] @ short[1])) <= 0.5 * float(short[0] @ short[0]) + 1e-9


def test_flattened_photos_have_one_brightness() -> None:
    ramp = torch.linspace(0.2, 0.8, SIZE).expand(3, SIZE, SIZE)
    flat = order.flattened(ramp)
    assert float(flat[..., 32:-32].std()) < 0.02 < float(ramp[..., 32:-32].std())
    assert float(flat.mean()) == pytest.approx(0.5, abs=0.03)
