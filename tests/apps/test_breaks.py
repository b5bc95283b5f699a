"""Whether rows of relief that break at a cut are told from rows that go on: drawn stitches, in step and out of step."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d

from metapp.appearance.doubts import BROKEN_ROWS
from metapp.appearance.height_fields import normal_from_height
from metapp.apps.exemplar.breaks import break_strength
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.svbrdf_stationary.app import compose_svbrdf
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task
from metapp.networks.generators import Pyramid
from metapp.networks.quilted import fetch_pieces
from tests.recipe_apps import presenter_of

SIDE = 192  # px of a photograph and cells of its tile
COLUMN_PX, ROW_PX = 16, 12  # of stitches, whole numbers of which fill the tile


def own_places() -> Tensor:
    """Return the places of a tile that is the photograph itself, [2, SIDE, SIDE]."""
    centres = (torch.arange(SIDE) + 0.5) / SIDE
    return torch.stack(torch.meshgrid(centres, centres, indexing="ij"))


def stitches(noise: float) -> Tensor:
    """Return the heights of V-shaped stitches in columns, with noise, [1, SIDE, SIDE]."""
    y, x = torch.meshgrid(torch.arange(float(SIDE)), torch.arange(float(SIDE)), indexing="ij")
    across = (x % COLUMN_PX - COLUMN_PX / 2).abs()
    grain = noise * torch.randn(SIDE, SIDE, generator=Generator().manual_seed(0))
    return (torch.sin(math.tau * (y - across) / ROW_PX) + grain)[None]


def slopes(noise: float) -> Tensor:
    """Return the slopes of stitches, [2, SIDE, SIDE]."""
    return normal_from_height(stitches(noise), 0.7)[:2]


def move_half(places: Tensor, count: int, axis: int) -> Tensor:
    """Move the right half of a tile down (axis 1), or its lower half to the right (axis 2), by a number of cells."""
    first, second = places.chunk(2, 3 - axis)
    return torch.cat([first, second.roll(count, axis)], 3 - axis)


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize(("axis", "period"), [(1, ROW_PX), (2, COLUMN_PX)])
def test_rows_that_break_at_a_cut_are_told_from_rows_that_go_on(axis: int, period: int, noise: float) -> None:
    relief = slopes(noise)
    for count in (period, 3 * period):
        assert break_strength(relief, move_half(own_places(), count, axis)) < 1.1
    for count in (period // 2, period + period // 2):
        assert break_strength(relief, move_half(own_places(), count, axis)) > BROKEN_ROWS.limit


def test_a_break_along_a_part_of_a_cut_is_told() -> None:
    places = own_places()
    places[:, 64:128, 64:128] = places[:, 64 + ROW_PX // 2 : 128 + ROW_PX // 2, 64:128].clone()
    assert break_strength(slopes(0.3), places) > BROKEN_ROWS.limit


def test_a_photograph_that_tiles_by_itself_does_not_break() -> None:
    assert break_strength(slopes(0.3), own_places()) < 1.1


def test_relief_without_rows_does_not_break() -> None:
    places = move_half(own_places(), 7, 1)
    noise = torch.randn(2, SIDE, SIDE, generator=Generator().manual_seed(0))
    for relief in (noise, avg_pool2d(noise, 5, 1, 2), torch.zeros_like(noise)):
        assert math.isnan(break_strength(relief, places))


def test_a_fit_has_a_line_on_rows_only_where_they_break() -> None:
    octaves = Octaves(SIDE, SIDE, ("relu1_1", "relu2_1"), count=1, shares=())
    app = compose_svbrdf(Pyramid(4, 3, noise=0, code=8, outputs=6, quilt=3), octaves, 1, expects_gloss=True)
    app = replace(app, sight=replace(app.sight, candidates=0))
    picture = (0.4 + 0.075 * stitches(0.1)).expand(3, -1, -1)
    tasks = stack_tasks(app, [Task("knit", {"image": (picture.clamp(0, 1) * 255).to(torch.uint8)})])
    theta = app.init(Generator().manual_seed(0), 1)
    for count, breaks in ((COLUMN_PX, False), (COLUMN_PX // 2, True)):
        places = move_half(own_places(), count, 2)
        quilt = fetch_pieces(picture, places, (SIDE, SIDE), (SIDE, SIDE))
        quilted = theta | {"places": places[None], "quilt": quilt[None]}
        (clauses,) = presenter_of(app).quality_warnings(quilted, tasks)
        assert any("breaks rows of the relief" in clause for clause in clauses) is breaks
