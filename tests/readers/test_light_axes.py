"""The axes of light directions are found by photographs of relief, and are left as they are where nothing tells."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from data_tools.readers import rti_photos
from data_tools.readers.light_axes import find_axes
from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.height_fields import normal_from_height
from tests.pictures import write_image

AXES = [  # by which a text's x and y differ from the truth, and what is found
    ([[1, 0], [0, 1]], "", 1), ([[-1, 0], [0, -1]], "", -1),
    ([[1, 0], [0, -1]], "y points down", 1), ([[-1, 0], [0, 1]], "y points down", -1),
    ([[0, 1], [1, 0]], "x and y are swapped", 1), ([[0, -1], [-1, 0]], "x and y are swapped", -1),
    ([[0, 1], [-1, 0]], "x and y are turned by 90 degrees", 1),
    ([[0, -1], [1, 0]], "x and y are turned by 90 degrees", -1),
]  # fmt: skip


def dome(count: int) -> Tensor:
    """Directions to lamps, at two heights, around an object."""
    turn, tilt = torch.arange(count) * 2.4, torch.tensor([0.5, 0.9]).repeat(count)[:count]
    return torch.stack([turn.cos() * tilt.sin(), turn.sin() * tilt.sin(), tilt.cos()], 1)


def photograph(lamps: Tensor, slope: float, gloss: float = 0.0, height: int = 64, width: int = 96) -> Tensor:
    """Photographs [N, height, width] of bumps and dents of this slope, with attached shadows, a pattern and noise."""
    rng = torch.Generator().manual_seed(0)
    y, x = torch.meshgrid(torch.linspace(0, 4, height), torch.linspace(0, 6, width), indexing="ij")
    waves = 6 * torch.rand(12, 3, generator=rng) - 3
    relief = sum((a * x + b * y + c).cos() / math.hypot(a, b) for a, b, c in waves.tolist())
    assert isinstance(relief, Tensor)
    normal = normal_from_height(relief[None, None] * slope * 16, periodic=False)[0]
    albedo = 0.3 + 0.2 * ((3 * x).floor() + (2 * y).floor()).remainder(2)
    half = torch.nn.functional.normalize(lamps + torch.tensor([0.0, 0, 1]), dim=1)
    cosine, highlight = (torch.einsum("nc,chw->nhw", way, normal).clamp_min(0) for way in (lamps, half))
    photos = albedo * cosine + gloss * highlight**60
    return (photos + 0.01 * torch.randn(photos.shape, generator=rng)).clamp(0, 1)


@pytest.mark.parametrize(("stated", "name", "sign"), AXES)
def test_axes_that_differ_are_found_but_for_half_a_turn(stated: list[list[int]], name: str, sign: int) -> None:
    for count, gloss in itertools.product((4, 6, 60), (0.0, 0.3)):
        lamps = dome(count)
        text = torch.cat([lamps[:, :2] @ torch.tensor(stated).float().T, lamps[:, 2:]], 1)
        found = find_axes(photograph(lamps, 0.15, gloss), text)
        assert found.name == name
        torch.testing.assert_close(text @ found.axes.T, lamps * torch.tensor([sign, sign, 1]))
        assert found.curl < 0.2
        assert (found.stated_curl > 2 * found.curl) == bool(name)


def test_where_nothing_tells_the_text_is_kept() -> None:
    lamps = dome(9)
    flipped = lamps * torch.tensor([1, -1, 1])
    rows = photograph(lamps, 0.3)[:, :1].expand(-1, 64, -1)  # slopes along x alone belong to a surface either way
    flat, noise = photograph(lamps, 0.0), torch.rand(9, 64, 64, generator=torch.Generator().manual_seed(1))
    for photos in (flat, noise, rows, torch.zeros(9, 8, 8), torch.ones(9, 1, 5)):
        found = find_axes(photos, flipped)
        assert (found.name, found.curl) == ("", found.stated_curl)
        assert torch.equal(found.axes, torch.eye(3))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_text_whose_y_points_down_gives_the_lights_of_the_right_one(
    tmp_path: Path, recwarn: pytest.WarningsRecorder, sign: int
) -> None:
    lamps = dome(8)
    for number, photo in enumerate(photograph(lamps, 0.15)):
        pixels = (linear_to_srgb(photo) * 255).round().numpy().astype(np.uint8)
        write_image(tmp_path / f"{number}.png", np.ascontiguousarray(pixels[..., None].repeat(3, 2)))
    rows = [f"{number}.png {x} {sign * y} {z}\n" for number, (x, y, z) in enumerate(lamps.tolist())]
    (tmp_path / "coin.lp").write_text("8\n" + "".join(rows))
    torch.testing.assert_close(rti_photos.read_task(tmp_path).data["lamps"], lamps)
    warnings = [str(warning.message) for warning in recwarn]
    assert len(warnings) == (sign < 0)
    assert all("coin.lp" in text and "y points down" in text and "correct the text" in text for text in warnings)
