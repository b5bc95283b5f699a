"""Stationary svBRDFs of pieces of a photograph: maps follow the quilt, and files have the photograph's resolution."""

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, interpolate

from metapp.appearance.colour import radiance_to_display
from metapp.appearance.flash import camera_position, render_maps, texel_positions
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.lattice import even_out_contrast
from metapp.appearance.svbrdf_maps import Maps, pack_maps, unpack_maps
from metapp.apps.exemplar.exemplar_statistics import turn_picture
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary, compose_svbrdf
from metapp.apps.svbrdf_stationary.flash_statistics import fit_local_lines
from metapp.apps.svbrdf_stationary.material_codec import refine_relief, remove_slow_changes
from metapp.apps.svbrdf_stationary.true_maps import turn_maps
from metapp.learning.app import stack_tasks
from metapp.learning.task import Params, Task, Tasks
from metapp.networks.generators import Pyramid
from metapp.networks.quilted import fetch_pieces
from tests.recipe_apps import asset_of, presenter_of, recipes_of

APP = compose_svbrdf(
    Pyramid(4, 3, noise=0, code=8, outputs=6, quilt=3),
    Octaves(64, 64, ("relu1_1", "relu2_1"), count=2),
    candidates=1,
    expects_gloss=True,
)
CELLS = (64, 64)
SILENT_LEVELS = ("out0", "out1", "out2")


def draw_material(side: int) -> Maps:
    """Draw the maps of a tiled floor: stones of several colours, with joints that lie deeper."""
    at = torch.arange(side) * 64 // side
    colours = torch.rand(3, 8, 8, generator=Generator().manual_seed(1))[:, at[:, None] // 8, at // 8] * 0.4 + 0.2
    is_joint = ((at[:, None] % 8 < 2) | (at % 8 < 2)).float()[None]
    height = -2 * is_joint * side / 64
    ones = torch.ones(1, side, side)
    return Maps(colours * (1 - 0.7 * is_joint), 0.05 * ones, 0.5 + 0.2 * is_joint, normal_from_height(height))


def photograph(maps: Maps) -> Tensor:
    """Photograph a material under a flash beside the lens, uint8 [3, side, side]."""
    side, eye = maps.diffuse.shape[-1], camera_position()
    radiance = render_maps(maps, texel_positions(side, side), eye, eye, falloff=1.0)
    return (radiance_to_display(radiance * 0.35 / radiance.mean()) * 255).round().to(torch.uint8)


@pytest.fixture(scope="module")
def task() -> Task:
    maps = draw_material(128)
    return Task("floor", {"image": photograph(maps), "maps": pack_maps(maps)})


@pytest.fixture(scope="module")
def tasks(task: Task) -> Tasks:
    return stack_tasks(APP, [task])


def silent_fit(tasks: Tasks) -> Params:
    """Return a fit whose network adds nothing to the quilt."""
    theta = APP.init(Generator().manual_seed(0), len(tasks)) | APP.task_parameters(tasks)
    silent = {key: torch.zeros_like(theta[key]) for key in theta if key.split(".")[0] in SILENT_LEVELS}
    return theta | silent


def test_diffuse_colour_is_the_quilt_where_the_network_adds_nothing(tasks: Tasks) -> None:
    theta = silent_fit(tasks)
    maps = APP.decoder.generate(theta, torch.full((1, 1, 2, 64, 64), -9.0)).prediction
    display = maps.diffuse[0, 0] ** (1 / 2.2)
    torch.testing.assert_close(display, theta["quilt"][0].clamp(0.02, 0.98), atol=1e-4, rtol=0)
    assert float(maps.normal[:, :, 2].min()) == pytest.approx(1)


def test_files_have_the_resolution_of_the_photograph_and_tile(task: Task, tasks: Tasks) -> None:
    theta = silent_fit(tasks)
    maps, height = APP.draw_maps(theta, task, None)
    assert (maps.diffuse.shape, height.shape) == ((3, 128, 128), (1, 128, 128))
    photo = APP.judge.take_even_photo(task.data["image"])
    pieces = fetch_pieces(photo, theta["places"][0], (128, 128), CELLS).clamp(0.02, 0.98)
    torch.testing.assert_close(maps.diffuse ** (1 / 2.2), pieces, atol=1e-4, rtol=0)
    # shrunk to the size of fits, it is the quilt in the fit
    shades = torch.stack([avg_pool2d(pieces, 2).flatten(), theta["quilt"][0].flatten()])
    assert float(torch.corrcoef(shades)[0, 1]) > 0.95


def test_even_photographs_have_lost_the_light_of_the_flash(task: Task) -> None:
    photo, even = task.data["image"].float() / 255, APP.judge.take_even_photo(task.data["image"])
    for picture, low, high in ((photo, 1.15, 9.0), (even, 0.95, 1.05)):
        means = interpolate(picture[None], size=(4, 4), mode="area")[0].mean(0)
        assert low < float(means[1:3, 1:3].mean() / means[0].mean()) < high


def test_contrast_is_evened_out_where_a_veil_of_gloss_hides_it() -> None:
    rng = Generator().manual_seed(0)
    pattern = torch.rand(3, 128, 128, generator=rng) - 0.5
    strength = torch.linspace(0.1, 0.4, 128)
    even = even_out_contrast(0.5 + strength * pattern)
    left, right = (float(half.std()) for half in even.split(64, -1))
    assert left / right == pytest.approx(1, abs=0.1)
    uniform = 0.5 + 0.2 * pattern
    torch.testing.assert_close(even_out_contrast(uniform), uniform, atol=0.02, rtol=0)
    flat = torch.full((3, 64, 64), 0.3)
    torch.testing.assert_close(even_out_contrast(flat), flat)


def test_local_lines_carry_slow_changes_to_finer_pictures() -> None:
    fine = torch.rand(1, 3, 128, 128, generator=Generator().manual_seed(0))
    ramp = torch.linspace(0.5, 1, 128)
    coarse, target = avg_pool2d(fine, 2), avg_pool2d(ramp * fine + 0.1, 2)
    factor, offset = (
        interpolate(values, scale_factor=2, mode="bilinear") for values in fit_local_lines(coarse, target)
    )
    torch.testing.assert_close(factor * fine + offset, ramp * fine + 0.1, atol=0.03, rtol=0)
    flat = torch.full((1, 3, 64, 64), 0.2)
    factor, offset = fit_local_lines(flat, 1.5 * flat)
    torch.testing.assert_close(factor, torch.full_like(factor, 1.5), atol=5e-3, rtol=0)
    torch.testing.assert_close(factor * flat + offset, 1.5 * flat)


def test_highlights_alone_are_avoided() -> None:
    """The middle of a photograph of a glossy surface, and no px of a matte one."""
    ones, flat = torch.ones(1, 64, 64), normal_from_height(torch.zeros(1, 64, 64))
    for roughness, is_glossy in ((0.3, True), (0.9, False)):
        maps = Maps(0.2 * ones.expand(3, -1, -1), 0.08 * ones * is_glossy, roughness * ones, flat)
        photos = photograph(maps)[None].float() / 255
        (avoided,) = APP.judge.find_unusable(photos, {"light": APP.judge.find_light(photos)})
        assert avoided is not None
        assert bool(avoided[32, 32]) is is_glossy
        assert float(avoided.float().mean()) < (0.26 if is_glossy else 0.001)
        assert not avoided[:4].any()


def test_slow_changes_go_and_all_else_stays() -> None:
    y, x = torch.meshgrid(*2 * [2 * torch.pi * (torch.arange(64) + 0.5) / 64], indexing="ij")
    slow, fine = 0.7 + x.sin() * y.cos(), (16 * x).sin()
    torch.testing.assert_close(
        remove_slow_changes(slow[None, None]), torch.full((1, 1, 64, 64), 0.7), atol=0.06, rtol=0
    )
    torch.testing.assert_close(remove_slow_changes(fine[None, None]), fine[None, None], atol=1e-4, rtol=0)


def test_relief_goes_on_in_finer_detail_where_brightness_tells_of_it() -> None:
    """All finer bands have the factor of the finest one, which is small where brightness says nothing of the height."""
    rng = Generator().manual_seed(0)
    fine_quilt = 0.5 + 0.1 * torch.randn(1, 1, 256, 256, generator=rng).expand(-1, 3, -1, -1)
    quilt = avg_pool2d(fine_quilt, 4)
    raw = torch.zeros(1, 6, 64, 64)
    raw[:, 5] = 3 * quilt[:, 0]
    unrelated = raw.clone()
    unrelated[:, 5] = raw[:, 5].flip(-1)
    for maps, low, high in ((raw, 0.9, 1.1), (unrelated, -0.1, 0.1)):
        refined = refine_relief(maps, quilt, fine_quilt)
        assert torch.equal(refined[:, :5], torch.zeros(1, 5, 256, 256))
        detail = fine_quilt[:, 0] - avg_pool2d(fine_quilt, 4)[:, 0].repeat_interleave(4, -1).repeat_interleave(4, -2)
        slope = float((refined[:, 5] * detail).sum() / (3 * detail * detail).sum())
        assert low < slope < high
    assert refine_relief(raw, quilt, quilt) is raw


@pytest.mark.parametrize("size", [(96, 128), (256, 256)])
def test_other_sizes_have_structures_of_equal_size(task: Task, tasks: Tasks, size: tuple[int, int]) -> None:
    theta = silent_fit(tasks)
    maps, height = APP.draw_maps(theta, task, size)
    assert all(values.shape[-2:] == size for values in (*maps, height))
    diffuse_maps = (APP.draw_maps(theta, task, None)[0].diffuse, maps.diffuse)
    own_steps, steps = (float((diffuse - diffuse.roll(1, -1)).abs().mean()) for diffuse in diffuse_maps)
    assert steps == pytest.approx(own_steps, rel=0.3)
    torch.testing.assert_close(maps.normal, normal_from_height(height))


def test_maps_without_the_photograph_have_the_size_of_the_quilt(tasks: Tasks) -> None:
    with pytest.warns(UserWarning, match="floor: its photo is not at hand"):
        maps, _ = APP.draw_maps(silent_fit(tasks), Task("floor", {}), None)
    assert maps.diffuse.shape == (3, 64, 64)


def test_files_and_records_are_of_the_photograph(task: Task, tasks: Tasks) -> None:
    theta = {key: value[0] for key, value in silent_fit(tasks).items()}
    presenter = presenter_of(APP)
    assert asset_of(APP, theta, task).pictures()["diffuse"].pixels.shape[:2] == (128, 128)
    assert APP.photo_share(task, None) == 1
    assert APP.photo_share(task, (256, 256)) == 0.5
    assert 0.3 < presenter.remarks(theta, task)["copied"] <= 1  # type: ignore[operator]


def test_relief_is_said_to_be_a_guess_unless_it_is_flat(tasks: Tasks) -> None:
    flat = silent_fit(tasks)
    tilted = flat | APP.init(Generator().manual_seed(0), len(tasks))
    for theta, is_doubted in ((flat, False), (tilted, True)):
        (clauses,) = presenter_of(APP).quality_warnings(theta, tasks)
        assert any("degrees on average, is a guess" in clause for clause in clauses) is is_doubted


def test_true_maps_are_compared_at_the_places_of_the_quilt(tasks: Tasks) -> None:
    """Fits with the true maps of the pieces have a lower outer loss than fits with those of other pieces."""
    theta, rng = silent_fit(tasks), Generator().manual_seed(0)
    batch = APP.outer_sample(tasks, rng, 1)
    true_maps = unpack_maps(batch["maps"][0])
    places = theta["places"][0]
    expected = fetch_pieces(tasks.data["maps"][0], places, (64, 64), CELLS)
    torch.testing.assert_close(batch["maps"][0], expected)
    assert (true_maps.normal.norm(dim=0) - 1).abs().mean() < 0.1
    other = batch | {"maps": batch["maps"].roll(3, -1)}
    assert float(APP.outer_loss(theta, batch, {})) < float(APP.outer_loss(theta, other, {}))
    without = {key: value for key, value in batch.items() if key != "maps"}
    assert float(APP.outer_loss(theta, without, {})) < float(APP.outer_loss(theta, batch, {}))


@pytest.mark.parametrize("is_flipped", [False, True])
@pytest.mark.parametrize("is_transposed", [False, True])
def test_turned_maps_look_like_turned_photographs(is_flipped: bool, is_transposed: bool) -> None:
    maps = draw_material(32)
    channels = torch.tensor([2, 0, 1])
    turned = unpack_maps(turn_maps(pack_maps(maps), torch.tensor(is_flipped), torch.tensor(is_transposed), channels))
    expected = turn_picture(photograph(maps)[channels], is_flipped, is_transposed)
    difference = (photograph(turned).int() - expected.int()).abs()
    assert int(difference.max()) <= 1


def test_augmented_tasks_have_quilts_and_maps_of_their_own(tasks: Tasks) -> None:
    variant = APP.augment(tasks, Generator().manual_seed(3))
    assert variant.data["maps"].shape == tasks.data["maps"].shape
    assert not torch.equal(variant.data["quilt"], tasks.data["quilt"])
    changes = torch.tensor([True]), torch.tensor([False]), torch.tensor([[0, 1, 2]])
    flipped = APP.judge.vary_truth(tasks, *changes)["maps"]
    torch.testing.assert_close(flipped[0, 3:], tasks.data["maps"][0, 3:].flip(-1))


def test_shipped_recipe_reads_quilts_without_noise() -> None:
    app = recipes_of("svbrdf_stationary")["full"].app
    assert isinstance(app, SvbrdfStationary)
    decoder = app.decoder
    assert (decoder.network.noise, decoder.network.quilt, decoder.octaves.octave_size()) == (0, 3, (256, 256))
    assert decoder.reads_quilts
    assert app.sight.candidates == 12
    assert decoder.shown_noise(torch.zeros(1)).shape == (1, 1, 2, 256, 256)
