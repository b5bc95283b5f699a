"""Textures of pieces of a photograph: where a fit begins, what steps change, and what files hold."""

import itertools
import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d

from metapp.appearance.doubts import BROKEN_LINES_OF_TEXTURE
from metapp.appearance.lattice import find_lattice, kept_order_share, remove_quadratic_trend
from metapp.appearance.lines import compare_lines
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.exemplar.quilts import ResizedTile, lost_order, make_piece_source, quilt_places
from metapp.apps.texture.app import compose_texture
from metapp.extensions.baselines.texture import baselines
from metapp.learning.app import stack_tasks
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params, Task, Tasks
from metapp.networks.quilted import LightGrid, fetch_pieces
from metapp.paradigms.methods import fit_tasks, make_method
from tests.recipe_apps import asset_of, presenter_of, recipes_of

ROOT = Path(__file__).parent.parent.parent / "metapp"
APP = compose_texture(LightGrid(8, 8), Octaves(64, 64, ("relu1_1", "relu2_1"), count=2), candidates=4)
CELLS = (64, 64)


def pavement(side: int) -> Tensor:
    """Draw stones of several colours in courses, of which eight fill the height, with noise, uint8 [3, side, side]."""
    at = torch.arange(side) * 64 // side
    rng = Generator().manual_seed(1)
    colours = torch.randint(90, 200, (8, 8), generator=rng)
    stones = colours[at[:, None] // 8, (at[None] + 4 * (at[:, None] // 8 % 2)) // 8 % 8]
    joints = (at[:, None] % 8 == 0) | ((at[None] + 4 * (at[:, None] // 8 % 2)) % 8 == 0)
    picture = torch.where(joints, 30, stones).expand(3, -1, -1)
    return (picture + torch.randint(-20, 20, (3, side, side), generator=rng)).clamp(0, 255).to(torch.uint8)


@pytest.fixture(scope="module")
def task() -> Task:
    return Task("pavement", {"image": pavement(192)})


@pytest.fixture(scope="module")
def tasks(task: Task) -> Tasks:
    return stack_tasks(APP, [task])


@pytest.fixture(scope="module")
def theta(tasks: Tasks) -> Params:
    recipe = replace(recipes_of("texture")["full"], app=APP)
    overfit = make_method("overfit", APP, recipe, MetaParameters(), steps=8)
    return fit_tasks(overfit, tasks, Generator().manual_seed(0))


def test_fits_begin_with_the_error_of_the_quilt_and_lower_it(tasks: Tasks, theta: Params) -> None:
    first = APP.init(Generator().manual_seed(0), 1) | APP.task_parameters(tasks)
    quilt = APP.errors_of(first["quilt"][:, None].clamp(0, 1), tasks)["error"]
    begun, ended = (float(APP.errors(parameters, tasks)["error"]) for parameters in (first, theta))
    assert begun == pytest.approx(float(quilt), rel=0.3)  # of pictures that are moved, whose borders differ
    assert ended < 0.95 * begun


def test_no_step_changes_the_quilt(tasks: Tasks, theta: Params) -> None:
    for name, value in APP.task_parameters(tasks).items():
        assert torch.equal(theta[name], value)
    change = (APP.decoder.network(theta, theta["quilt"]) - theta["quilt"].clamp(0, 1)).square().mean().sqrt()
    assert 0.001 < float(change) < 0.04


def test_pieces_are_copies_of_the_exemplar_and_tile(task: Task, tasks: Tasks) -> None:
    """All values of a quilt stand in the exemplar, and edges of the tile continue at the opposite ones."""
    even = remove_quadratic_trend(APP.decoder.octaves.take_exemplar(task.data["image"][None].float() / 255)[0])
    source = make_piece_source(even, CELLS, stretches=False)
    places = quilt_places(source, CELLS, (16, 5), np.random.default_rng(4))
    rows, columns = ((places * 64 - 0.5).round().long()).unbind()
    assert 0 <= int(min(rows.min(), columns.min())) <= int(max(rows.max(), columns.max())) < 64
    picture = even[:, rows, columns]
    inside, across = (picture.diff(dim=1).abs().mean(), (picture[:, 0] - picture[:, -1]).abs().mean())
    assert float(across) < 1.5 * float(inside)


def test_the_best_candidate_is_taken(task: Task) -> None:
    """Of four quilts the chosen one has the least error at half the size, with the penalty on lost order."""
    exemplar = APP.decoder.octaves.take_exemplar(task.data["image"][None].float() / 255)
    lattice = find_lattice(remove_quadratic_trend(exemplar[0]))
    small_targets = APP.judge.describe(avg_pool2d(exemplar, 2), 1)
    errors = []
    for candidates in (1, 4):
        quilts = APP.sight.describe(exemplar, candidates)["quilt"]
        distance = APP.judge.gram_distance(avg_pool2d(quilts, 2)[:, None], small_targets)
        errors.append(float(distance) + 0.3 * lost_order(lattice, quilts[0], 0.9))
    assert errors[1] <= errors[0]


def test_order_is_kept(task: Task, theta: Params) -> None:
    exemplar = APP.decoder.octaves.take_exemplar(task.data["image"][None].float() / 255)[0]
    lattice = find_lattice(remove_quadratic_trend(exemplar))
    assert kept_order_share(lattice, APP.decoder.network(theta, theta["quilt"])[0]) > 0.8


@pytest.mark.parametrize("candidate", [0, 1, 2])
def test_lost_order_costs(candidate: int) -> None:
    exemplar = pavement(64).float() / 255
    lattice = find_lattice(exemplar)
    assert lost_order(lattice, exemplar, 0.9) == 0
    scattered = exemplar.flatten(1)[:, torch.randperm(64 * 64, generator=Generator().manual_seed(candidate))]
    assert lost_order(lattice, scattered.unflatten(1, (64, 64)), 0.9) > 0.5


def test_files_have_the_resolution_of_the_photograph(task: Task, theta: Params) -> None:
    """A file has the photograph's size; reduced to the size of fits, it is the picture that was fitted."""
    batch = {key: value[:1] for key, value in theta.items()}
    tile = APP.draw_tile(batch, task, None)
    assert tile.shape == (3, 192, 192)
    small = avg_pool2d(tile[None], 3)[0]
    fitted = APP.decoder.network(theta, theta["quilt"])[0]
    assert float((small - fitted).abs().mean()) < 0.03
    detail = [float(picture.diff(dim=2).abs().mean()) for picture in (tile, task.data["image"].float() / 255)]
    assert 0.85 < detail[0] / detail[1] < 1.15  # as sharp as the photograph


@pytest.mark.parametrize("size", [(256, 128), (384, 384), (100, 300)])
def test_other_sizes_have_structures_of_equal_size(task: Task, theta: Params, size: tuple[int, int]) -> None:
    asset = asset_of(APP, {key: value[0] for key, value in theta.items()}, task, {"size": size})
    picture = asset.pictures()["texture"].pixels
    assert tuple(picture.shape) == (*size, 3)
    detail = [
        float(values.diff(dim=-1).abs().mean()) for values in (picture.movedim(-1, 0), task.data["image"].float() / 255)
    ]
    assert 0.7 < detail[0] / detail[1] < 1.3
    columns = picture.diff(dim=1).abs().mean((0, 2))
    assert float((picture[:, 0] - picture[:, -1]).abs().mean()) < 1.2 * float(columns.max())  # where joints stand


def test_augmented_exemplars_have_quilts_of_their_own(tasks: Tasks) -> None:
    augmented = APP.augment(tasks.select([0, 0]), Generator().manual_seed(0))
    assert augmented.data["quilt"].shape == (2, 3, 64, 64)
    assert not torch.equal(augmented.data["quilt"][0], augmented.data["quilt"][1])


# What is said of fits that lost structure


def test_lost_structure_is_said_with_a_remedy(tasks: Tasks, theta: Params, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is said of the fit; of scattered px and of broken lines one clause each."""
    presenter = presenter_of(APP)
    comparisons = iter([1.0, 0.834])
    monkeypatch.setattr("metapp.apps.exemplar.presenter.compare_lines", lambda *_: next(comparisons))
    assert presenter.quality_warnings(theta, tasks) == [[]]
    order = torch.randperm(64 * 64, generator=Generator().manual_seed(0))
    scattered = theta | {"quilt": theta["quilt"].flatten(2)[..., order].unflatten(2, (64, 64))}
    ((clause,),) = presenter.quality_warnings(scattered, tasks)
    assert re.fullmatch(
        r"keeps 0\.\d\d of the photo's regular structure \(a photo that shows it more often helps\)", clause
    )
    ((broken,),) = presenter.quality_warnings(theta, tasks)
    assert broken.startswith("breaks lines of the photo such as joints, cracks or threads (0.83 as strong, ")


def test_visible_cuts_and_repetitions_are_said(task: Task, tasks: Tasks, theta: Params) -> None:
    """Of blocks at random and of a large piece that comes back; a fit, and a photo that repeats itself, say nothing."""
    presenter = presenter_of(APP)
    exemplar = APP.decoder.octaves.take_exemplar(task.data["image"][None].float() / 255)[0]
    ordered, unordered = exemplar, torch.rand(3, 64, 64, generator=Generator().manual_seed(0))
    own = torch.stack(torch.meshgrid(*2 * [(torch.arange(64) + 0.5) / 64], indexing="ij"))
    blocks, twice, rng = own.clone(), own.clone(), Generator().manual_seed(1)
    for row, column in itertools.product(range(0, 64, 16), repeat=2):
        y, x = torch.randint(49, (2,), generator=rng).tolist()
        blocks[:, row : row + 16, column : column + 16] = own[:, y : y + 16, x : x + 16]
    twice[:, 32:62, :44] = own[:, :30, 10:54]

    def say(picture: Tensor, places: Tensor) -> list[str]:
        return presenter._find_visible_pieces(picture, fetch_pieces(picture, places, (64, 64), (64, 64)), places)

    fitted = APP.decoder.network(theta, theta["quilt"])[0]
    assert presenter._find_visible_pieces(exemplar, fitted, theta["places"][0]) == []
    assert presenter.quality_warnings(theta, tasks) == [[]]
    (cuts,) = say(ordered, blocks)
    assert re.fullmatch(r"shows the cuts between pieces of the photo \(changes across them are \d\.\d times .*\)", cuts)
    assert say(unordered, twice) == ["repeats 32% of itself (a photo of more of the material helps)"]
    assert say(unordered, own) == []
    assert not any("repeats" in clause for clause in say(ordered, twice))
    remarks = presenter.remarks({"places": twice, "quilt": torch.zeros(3, 64, 64)}, task)
    assert remarks["repeated"] == pytest.approx(30 * 44 / 64**2)


def test_methods_without_quilts_make_none(task: Task) -> None:
    methods = baselines(APP)
    assert len(methods) == 3
    for baseline in methods:
        assert not {"places", "quilt"} & stack_tasks(baseline.app, [task]).data.keys()


def test_lines_of_torn_pictures_are_weak_and_those_of_fits_are_not(task: Task) -> None:
    photo = pavement(256).float() / 255
    rng = Generator().manual_seed(3)
    torn = photo.clone()
    for row in range(0, 256, 16):
        for column in range(0, 256, 16):
            y, x = torch.randint(0, 240, (2,), generator=rng).tolist()
            torn[:, row : row + 16, column : column + 16] = photo[:, y : y + 16, x : x + 16]
    moved = photo.roll((64, 64), (1, 2))
    assert compare_lines(photo, torn) < BROKEN_LINES_OF_TEXTURE.limit < compare_lines(photo, moved)


def test_textures_without_the_photograph_have_the_size_of_the_quilt(theta: Params) -> None:
    batch = {key: value[:1] for key, value in theta.items()}
    with pytest.warns(UserWarning, match="gone: its photo is not at hand, .* the texture has 64 px a side") as warned:
        assert APP.draw_tile(batch, Task("gone", {}), None).shape == (3, 64, 64)
    assert Path(warned[0].filename).is_relative_to(ROOT)  # others of torch and Python are not shown


def test_tiles_of_another_size_say_whether_they_keep_the_order_of_the_photograph() -> None:
    photo = pavement(64).float() / 255
    shuffled = photo.unfold(1, 5, 5).unfold(2, 5, 5).reshape(3, 144, 5, 5)
    shuffled = shuffled[:, torch.randperm(144, generator=Generator().manual_seed(0))]
    shuffled = shuffled.reshape(3, 12, 12, 5, 5).permute(0, 1, 3, 2, 4).reshape(3, 60, 60)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ResizedTile(photo, photo.roll((3, 5), (1, 2)).repeat(1, 1, 2)).warn_of_lost_order(photo, "kept")
    with pytest.warns(UserWarning, match="lost: cut for --size: keeps 0.* of the photo's regular structure"):
        ResizedTile(photo, shuffled).warn_of_lost_order(photo, "lost")
