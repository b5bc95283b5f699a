"""What highlights leave in maps of one photograph: how much is told beneath them, what is removed and what stays."""

import pytest
import torch
from torch import Tensor

from metapp.appearance.flash import texel_positions
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.flashes import decode_flash, render_photo
from metapp.apps.svbrdf_nonstationary.pretrained.scars import hidden_share, remove_scars, trust_texels

SIDE = 128
FLASH = decode_flash(torch.zeros(1, 4))
UP = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(1, 3, SIDE, SIDE)


def even_maps(diffuse: float, specular: float, roughness: float) -> Maps:
    ones = torch.ones(1, 1, SIDE, SIDE)
    return Maps(diffuse * ones.expand(-1, 3, -1, -1), specular * ones.expand(-1, 3, -1, -1), roughness * ones, UP)


def trust_of(maps: Maps) -> Tensor:
    return trust_texels(maps, render_photo(maps, FLASH), FLASH)


def disc(radius: float = 0.25) -> Tensor:
    """1 beneath the flash, falling to 0 a few times the radius from it, [1, 1, SIDE, SIDE]."""
    squared: Tensor = texel_positions(SIDE, SIDE).square().sum(0)[None, None]
    return (-squared / radius**2).exp()


def test_texels_are_trusted_but_beneath_highlights() -> None:
    matte, glossy = trust_of(even_maps(0.5, 0.02, 0.9)), trust_of(even_maps(0.1, 0.05, 0.3))
    assert matte.min() > 0.9
    middle = glossy[0, 0, SIDE // 2, SIDE // 2]
    assert middle < 0.2
    assert glossy[0, 0, 0].min() > 0.95
    assert hidden_share(even_maps(0.5, 0.02, 0.9), FLASH) == 0
    assert 0.01 < float(hidden_share(even_maps(0.1, 0.05, 0.3), FLASH)) < 0.5
    assert hidden_share(even_maps(0.02, 0.5, 0.3), FLASH) == 0  # a metal


@pytest.mark.parametrize("kind", ["diffuse", "specular", "roughness"])
def test_a_scar_of_the_highlights_shape_is_removed(kind: str) -> None:
    clean = even_maps(0.1, 0.05, 0.3)
    scarred = clean._replace(**{kind: getattr(clean, kind) * (1 - 0.5 * disc())})
    found = remove_scars(scarred, render_photo(clean, FLASH).clamp(max=0.9), FLASH)
    error, left = ((getattr(maps, kind) - getattr(clean, kind)).abs().mean() for maps in (scarred, found))
    assert left < 0.4 * error
    for name in {"diffuse", "specular", "roughness"} - {kind}:
        torch.testing.assert_close(getattr(found, name), getattr(clean, name), atol=2e-3, rtol=0)
    assert found.normal is scarred.normal


def test_what_a_material_has_elsewhere_stays_beneath_its_highlight() -> None:
    clean = even_maps(0.1, 0.05, 0.3)
    third = SIDE // 3
    spots = sum(disc().roll((rows, columns), (2, 3)) for rows in (-third, 0, third) for columns in (-third, 0, third))
    spotted = clean._replace(diffuse=clean.diffuse * (1 - 0.5 * spots))
    photo = render_photo(spotted, FLASH).clamp(max=0.9)
    torch.testing.assert_close(remove_scars(spotted, photo, FLASH).diffuse, spotted.diffuse, atol=5e-3, rtol=0)


def test_matte_materials_stay_as_they_are() -> None:
    rng, matte = torch.Generator().manual_seed(0), even_maps(0.5, 0.0, 0.9)
    varied = matte._replace(
        diffuse=0.3 + 0.3 * torch.rand(matte.diffuse.shape, generator=rng),
        roughness=0.5 + 0.4 * torch.rand(matte.roughness.shape, generator=rng),
    )
    for part, expected in zip(remove_scars(varied, render_photo(varied, FLASH), FLASH), varied, strict=True):
        torch.testing.assert_close(part, expected)


def test_metals_stay_as_they_are() -> None:
    clean = even_maps(0.02, 0.4, 0.3)
    scarred = clean._replace(specular=clean.specular * (1 - 0.5 * disc()))
    found = remove_scars(scarred, render_photo(clean, FLASH), FLASH)
    for part, expected in zip(found, scarred, strict=True):
        torch.testing.assert_close(part, expected)


def test_details_beneath_a_highlight_stay() -> None:
    clean, checks = even_maps(0.1, 0.05, 0.3), torch.ones(SIDE, SIDE)
    checks[::2, ::2] = checks[1::2, 1::2] = 0.5
    detailed = clean._replace(diffuse=clean.diffuse * checks)
    photo = render_photo(detailed, FLASH).clamp(max=0.9)
    torch.testing.assert_close(remove_scars(detailed, photo, FLASH).diffuse, detailed.diffuse, atol=5e-3, rtol=0)
