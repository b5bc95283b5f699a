"""Reliefs under distant lamps: a plane as theory has it, and shadows where something stands in the way."""

import math

import pytest
import torch

from metapp.appearance.svbrdf_maps import Maps
from metapp.rendering.relief import light_relief
from tests.needs_mitsuba import needs_mitsuba

pytestmark = [needs_mitsuba, pytest.mark.long]
SIDE = 16
LAMPS = torch.tensor([[0.0, 0.0, 1.0], [0.8, 0.0, 0.6], [-0.8, 0.0, 0.6]])


def matt_maps(side: int) -> Maps:
    gray = torch.full((3, side, side), 0.5)
    up = torch.tensor([0.0, 0, 1])[:, None, None].expand(3, side, side)
    return Maps(gray, torch.full((3, side, side), 0.04), torch.ones(1, side, side), up)


def test_a_matt_plane_is_as_bright_as_its_albedo_and_the_cosine_say() -> None:
    lit = light_relief(matt_maps(32), torch.zeros(32, 32), LAMPS, SIDE, 0)
    assert lit.radiance.shape == (3, 3, SIDE, SIDE)
    means = lit.radiance.mean((1, 2, 3)).tolist()
    assert means[0] == pytest.approx(0.5, abs=0.08)  # the principled BSDF's body is not quite Lambertian
    assert means[1] == pytest.approx(0.6 * means[0], abs=0.08)
    torch.testing.assert_close(
        lit.normal, torch.tensor([0.0, 0, 1])[:, None, None].expand(3, SIDE, SIDE), atol=1e-3, rtol=0
    )


def test_a_wall_throws_its_shadow_away_from_the_lamp_and_slopes_face_it() -> None:
    height = torch.zeros(64, 64)
    height[:, 30:34] = 0.3
    lit = light_relief(matt_maps(64), height, LAMPS, SIDE, 0)
    columns = lit.radiance.mean((1, 2))  # [lamps, columns], x to the right
    middle, reach = SIDE // 2, math.floor(0.3 * 0.8 / 0.6 / 2 * SIDE * 0.6)
    left, right = slice(middle - 1 - reach, middle - 1), slice(middle + 1, middle + 1 + reach)
    assert float(columns[1, left].mean()) < 0.4 * float(columns[1, right].mean())
    assert float(columns[2, right].mean()) < 0.4 * float(columns[2, left].mean())


def test_normals_have_y_up() -> None:
    rows = torch.linspace(0, 2 * math.pi, 65)[:-1]
    height = (0.1 * rows.cos())[:, None].expand(64, 64).contiguous()  # highest at the upper and lower edges
    lit = light_relief(matt_maps(64), height, LAMPS[:1], SIDE, 0)
    assert float(lit.normal[1, : SIDE // 2 - 1].mean()) < -0.1  # above the valley the surface faces down the picture
    assert float(lit.normal[1, SIDE // 2 + 1 :].mean()) > 0.1
