"""The metallic-roughness workflow: exact where it can be, and what it loses elsewhere."""

from __future__ import annotations

import torch

from metapp.appearance.workflow import DIELECTRIC, from_metallic, to_metallic


def drawn(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def test_it_is_inverted_where_such_maps_exist() -> None:
    base, metallic = DIELECTRIC + (1 - DIELECTRIC) * drawn(3, 16, 16), drawn(1, 16, 16)
    found = to_metallic(*from_metallic(base, metallic))
    assert torch.allclose(found.metallic, metallic, atol=1e-9)
    assert torch.allclose(found.base, base, atol=1e-9)


def test_metals_and_dielectrics_are_what_they_are() -> None:
    gold, plaster = torch.tensor([1.0, 0.77, 0.34])[:, None, None], torch.full((3, 1, 1), 0.8)
    dielectric = torch.full((1, 1, 1), DIELECTRIC)
    assert torch.allclose(to_metallic(torch.zeros(3, 1, 1), gold).metallic, torch.ones(1, 1, 1), atol=1e-4)
    assert torch.allclose(to_metallic(torch.zeros(3, 1, 1), gold).base, gold, atol=1e-4)
    assert torch.equal(to_metallic(plaster, dielectric).metallic, torch.zeros(1, 1, 1))
    assert torch.allclose(to_metallic(plaster, dielectric).base, plaster)


def test_what_no_such_material_reflects_stays_in_range() -> None:
    diffuse, specular = drawn(3, 32, 32), drawn(3, 32, 32).flip(0)
    for each in to_metallic(diffuse, specular):
        assert each.isfinite().all()
        assert each.min() >= 0
        assert each.max() <= 1


def test_all_that_is_reflected_is_kept_where_nothing_clips() -> None:
    diffuse, specular = 0.4 * drawn(3, 16, 16), DIELECTRIC + 0.4 * drawn(1, 16, 16)
    again = from_metallic(*to_metallic(diffuse, specular))
    assert torch.allclose(again[0] + again[1], diffuse + specular, atol=1e-12)
