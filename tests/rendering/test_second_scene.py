"""The second scene: linear, without loss or gain, with its shadows and reflections in place, as Mitsuba renders it."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from metapp.appearance import latlong
from metapp.rendering.second_scene import geometry, relighting
from metapp.rendering.second_scene.geometry import second_scene_dict
from metapp.rendering.second_scene.relighting import relight, transfer_matrix
from metapp.rendering.variant import load_mitsuba
from tests.marked import long
from tests.needs_mitsuba import skip_without_mitsuba

ROWS, COLUMNS = 16, 32
FINER = 8  # a texel becomes so many, squared, for Mitsuba's `envmap`, which would else blend it with its neighbours


@pytest.fixture(scope="module")
def cache_with_matrix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache with the matrix of small maps."""
    skip_without_mitsuba()
    folder = tmp_path_factory.mktemp("matrix")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("METAPP_CACHE", str(folder))
        patch.setattr(relighting, "PATHS_PER_PIXEL", 4096)
        transfer_matrix(ROWS, COLUMNS)
    return folder


@pytest.fixture
def matrix(cache_with_matrix: Path, monkeypatch: pytest.MonkeyPatch) -> Tensor:
    """[64, 96, 16, 32]; `relight` finds it too."""
    monkeypatch.setenv("METAPP_CACHE", str(cache_with_matrix))
    return transfer_matrix(ROWS, COLUMNS).view(geometry.PICTURE_HEIGHT_PX, geometry.PICTURE_WIDTH_PX, ROWS, COLUMNS)


def sun(row: int, column: int) -> Tensor:
    """A map [3, 16, 32] with one texel 10,000 times as bright as the rest."""
    light = torch.full((3, ROWS, COLUMNS), 0.01)
    light[:, row, column] *= 1e4
    return light


def direct(illumination: Tensor, spp: int) -> Tensor:
    """The picture [3, 64, 96] by Mitsuba's path tracer, under one map [3, H, W] that is constant in each texel."""
    mi = load_mitsuba()
    texels = illumination.repeat_interleave(FINER, -2).repeat_interleave(FINER, -1)
    bitmap = mi.Bitmap(texels.movedim(0, -1).float().cpu().contiguous().numpy())
    scene = mi.load_dict({**second_scene_dict(mi), "light": {"type": "envmap", "bitmap": bitmap}})
    return torch.from_numpy(mi.render(scene, spp=spp).numpy()).movedim(-1, 0)


@pytest.mark.long
def test_light_adds_up_and_is_never_negative(matrix: Tensor, rng: torch.Generator) -> None:
    assert (matrix >= 0).all()
    assert matrix.isfinite().all()
    maps = torch.rand(3, 3, ROWS, COLUMNS, generator=rng)
    maps[2] = 2 * maps[0] + 0.5 * maps[1]
    first, second, both = relight(maps, height=ROWS, width=COLUMNS)
    torch.testing.assert_close(both, 2 * first + 0.5 * second)
    by_hand = torch.einsum("hwrc,krc->khw", matrix.double(), maps[0].double())
    torch.testing.assert_close(first.double(), by_hand, rtol=1e-5, atol=0)


@pytest.mark.long
def test_maps_of_any_size_give_the_same_picture(matrix: Tensor, rng: torch.Generator) -> None:
    maps = torch.rand(1, 3, ROWS, COLUMNS, generator=rng)
    larger = maps.repeat_interleave(2, -2).repeat_interleave(2, -1)
    # a texel's halves above and below differ in solid angle, but not in radiance
    assert relight(larger, height=ROWS, width=COLUMNS).shape == (
        1,
        3,
        geometry.PICTURE_HEIGHT_PX,
        geometry.PICTURE_WIDTH_PX,
    )
    torch.testing.assert_close(*(relight(lights, height=ROWS, width=COLUMNS) for lights in (maps, larger)))


@pytest.mark.long
def test_a_furnace_shows_the_albedo_of_the_open_floor(matrix: Tensor) -> None:
    picture = matrix.sum((-2, -1))
    assert picture.max() < geometry.GLOSSY_REFLECTANCE * 1.03  # noise
    torch.testing.assert_close(picture[0], torch.full_like(picture[0], geometry.FLOOR_ALBEDO), rtol=0.03, atol=0)


@pytest.mark.long
@pytest.mark.parametrize(("illumination", "spp", "within"), [("soft", 256, 0.05), long("sunny", 1024, 0.1)])
def test_pictures_agree_with_mitsubas_path_tracer(matrix: Tensor, illumination: str, spp: int, within: float) -> None:
    soft = 1 + 0.5 * latlong.texel_directions(ROWS, COLUMNS)
    light = soft if illumination == "soft" else sun(3, 12) * soft
    expected = direct(light, spp)
    (picture,) = relight(light[None], height=ROWS, width=COLUMNS)
    assert ((picture - expected).abs() / expected).mean() < within
    torch.testing.assert_close(picture.mean((1, 2)), expected.mean((1, 2)), rtol=0.02, atol=0)


def test_the_matrix_is_built_once_and_again_if_damaged(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[int, int]] = []
    result = torch.rand(6, 8)
    monkeypatch.setattr(relighting, "_build_matrix", lambda height, width: calls.append((height, width)) or result)
    for size in ((2, 4), (2, 4), (4, 2)):
        assert torch.equal(transfer_matrix(*size), result)
    assert calls == [(2, 4), (4, 2)]
    assert len(list(cache.iterdir())) == 2  # and no unfinished file
    (file,) = cache.glob("*-2x4-*")
    file.write_bytes(b"damaged")
    assert torch.equal(transfer_matrix(2, 4), result)
    assert len(calls) == 3


@pytest.mark.parametrize(("height", "width"), [(3, 6), (0, 4), (2, 0)])
def test_maps_that_the_horizon_cuts_are_refused(height: int, width: int) -> None:
    with pytest.raises(ValueError, match="even number of rows"):
        transfer_matrix(height, width)
