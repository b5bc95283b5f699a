"""Baselines of pictures: quilting, a photo as a flat material, a map of what a mirror ball shows, harmonics of maps."""

import math
from typing import cast

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y
from torch import Generator, Tensor
from torch.nn.functional import interpolate

from metapp.appearance.flash import camera_position, relighting_positions
from metapp.appearance.latlong import texel_directions
from metapp.appearance.quilting import cut_mask
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.exemplar.exemplar_sight import JUDGED_PICTURES
from metapp.apps.illumination.mirror import MirrorLight
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, decode_flash, render_photo
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import BaselineFit, CostLimits
from metapp.extensions.baselines.harmonics import count_orders, from_harmonics, to_harmonics
from metapp.extensions.baselines.illumination import SphericalHarmonics, UnwrappedBall, fill_unseen
from metapp.extensions.baselines.svbrdf_nonstationary import flat_maps
from metapp.extensions.baselines.svbrdf_stationary import quilt_maps
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task, Tasks
from tests.recipe_apps import app_by_recipe, application


def test_a_cut_is_the_path_of_least_cost() -> None:
    cost = np.array([[9.0, 1, 9, 9], [9, 9, 1, 9], [9, 1, 9, 9], [1, 9, 9, 9]])
    expected = [[0, 1, 1, 1], [0, 0, 1, 1], [0, 1, 1, 1], [1, 1, 1, 1]]
    assert np.array_equal(cut_mask(cost), np.array(expected, dtype=bool))


def test_a_flat_matt_material_is_read_from_its_photo(rng: Generator) -> None:
    """But for the highlight of the F0 that is assumed; a photo at which the flash falls off is not of darker edges."""

    def noise(channels: int) -> Tensor:
        return interpolate(torch.rand(1, channels, 5, 5, generator=rng), size=(32, 32), mode="bicubic").clamp(0.05, 0.9)

    flat = torch.cat([torch.zeros(1, 2, 32, 32), torch.ones(1, 1, 32, 32)], 1)
    matt = Maps(noise(3), torch.zeros(1, 3, 32, 32), noise(1), flat)
    found = flat_maps(render_photo(matt, decode_flash(torch.zeros(1, FLASH_NUMBERS))))
    torch.testing.assert_close(found.diffuse, matt.diffuse, atol=1e-3, rtol=0.01)
    assert torch.equal(found.normal, flat)


def test_unseen_directions_repeat_the_seen_ones_mirrored() -> None:
    towards = texel_directions(32, 64)
    lamp = ((torch.einsum("c,chw->hw", torch.tensor([0.6, 0.0, 0.8]), towards) - 1) * 200).exp()
    light = 0.2 + 0.1 * towards[:1] + 40 * lamp * torch.tensor([1.0, 0.5, 0.25])[:, None, None]
    front = (towards[2] > 0).float()
    result = fill_unseen(MirrorLight(light[None], torch.stack([front, 0 * front])[None]))
    torch.testing.assert_close(result[0][:, front > 0], light[:, front > 0])
    torch.testing.assert_close(result, result.flip(-1).roll(32, -1))


def test_a_glossy_sphere_is_refused(rng: Generator) -> None:
    """Nothing is certain in its photograph: what was said before is that the error is not finite."""
    data = {"seen": torch.zeros(1, 3, 8, 16), "certain": torch.zeros(1, 2, 8, 16)}
    tasks = Tasks(("garden",), data, torch.arange(1))
    with pytest.raises(ValueError, match="garden: a photo of a glossy sphere, expected a mirror ball's"):
        UnwrappedBall(app_by_recipe("illumination", observes="photo")).fit(tasks, rng, CostLimits(1, 1))


@pytest.fixture
def numbers() -> np.random.Generator:
    return np.random.default_rng(0)


def basis_of(order: int, height: int, width: int) -> np.ndarray:
    """Real spherical harmonics at the texels' centres of a lat-long map, [(order + 1)^2, H, W], by definition."""
    theta = ((np.arange(height) + 0.5) * (math.pi / height))[:, None]
    phi = (np.arange(width) + 0.5) * (math.tau / width)
    found = []
    for degree in range(order + 1):
        found.append(sph_harm_y(degree, 0, theta, phi).real)
        for m in range(1, degree + 1):
            complex_one = math.sqrt(2) * sph_harm_y(degree, m, theta, phi)
            found += [complex_one.real, complex_one.imag]
    return np.stack(found)


@pytest.mark.parametrize(("height", "width"), [(8, 16), (9, 18), (9, 12), (5, 31), (7, 11)])
def test_harmonics_are_those_of_weighted_least_squares(height: int, width: int, numbers: np.random.Generator) -> None:
    maps = numbers.normal(size=(3, height, width))
    root = np.sqrt(np.sin((np.arange(height) + 0.5) * (math.pi / height)))[:, None]
    for order in range(count_orders(height, width)):
        basis = basis_of(order, height, width)
        a, b = ((root * pictures).reshape(len(pictures), -1).T for pictures in (basis, maps))
        expected = np.linalg.lstsq(a, b, rcond=None)[0].T
        found = to_harmonics(maps, order)
        np.testing.assert_allclose(found, expected, atol=1e-13)
        result = from_harmonics(found, height, width)
        np.testing.assert_allclose(result, np.tensordot(found, basis, 1), atol=1e-13)


@pytest.mark.parametrize(("height", "width", "count"), [(8, 16, 8), (9, 12, 6), (4, 64, 4), (1, 1, 1)])
def test_number_of_texels_limits_the_orders_of_harmonics(height: int, width: int, count: int) -> None:
    assert count_orders(height, width) == count
    for order in (count - 1, count):
        columns = basis_of(order, height, width).reshape((order + 1) ** 2, -1)
        assert (np.linalg.matrix_rank(columns) == len(columns)) == (order < count)


def _task(radiance: np.ndarray) -> Tasks:
    return Tasks(("m",), {"map": torch.from_numpy(radiance).float()[None]}, torch.tensor([0]))


def test_errors_fall_with_more_bytes_to_the_map_itself(numbers: np.random.Generator, rng: Generator) -> None:
    radiance = np.exp(numbers.normal(size=(3, 16, 32)))
    tasks, expected = _task(radiance), torch.from_numpy(radiance).float()
    sizes = (1, 10, 100, 400, 10**6)
    baseline = SphericalHarmonics(app_by_recipe("illumination"))
    fitted = [baseline.fit(tasks, rng, CostLimits(1, size)) for size in sizes]
    errors = [(harmonic_fit.prediction()[0] - expected).square().mean().item() for harmonic_fit in fitted]  # type: ignore[index]
    assert errors[0] == errors[1] > errors[2] > errors[3] > errors[4]
    assert [harmonic_fit.kept_numbers for harmonic_fit in fitted] == [3, 3, 48, 192, 768]  # of orders 0, 0, 3, 7, 15
    assert all(harmonic_fit.kept_bytes == 4 + 2 * harmonic_fit.kept_numbers for harmonic_fit in fitted)
    assert all(harmonic_fit.kept_bytes <= size for harmonic_fit, size in zip(fitted[1:], sizes[1:], strict=True))


# Maps quilted of a flash photo of materials whose truth is known


SIZE = 64  # of recipe quick
DIFFUSE, F0, ROUGHNESS = (0.3, 0.2, 0.1), 0.04, 0.3


@pytest.fixture(scope="module")
def app() -> SvbrdfStationary:
    return cast("SvbrdfStationary", app_by_recipe("svbrdf_stationary"))


def material(pattern: Tensor | None = None) -> Maps:
    """Flat and even but for a pattern [SIZE, SIZE] that multiplies its diffuse colour."""
    ones = torch.ones(1, SIZE, SIZE)
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, SIZE, SIZE)
    colour = torch.tensor(DIFFUSE)[:, None, None] * (ones if pattern is None else pattern)
    return Maps(colour, F0 * ones, ROUGHNESS * ones, up)


def task_of(app: SvbrdfStationary, maps: Maps) -> Task:
    def as_bytes(light: Tensor, view: Tensor) -> Tensor:
        return (255 * app.judge.photograph(maps, light, view)).round().to(torch.uint8)

    relit = torch.stack([as_bytes(*pair) for pair in relighting_positions().values()])
    return Task("known", {"image": as_bytes(camera_position(), camera_position()), "relit": relit})


def quilting(app: SvbrdfStationary, tasks: Tasks, seed: int = 0) -> BaselineFit:
    (baseline,) = [baseline for baseline in baselines_of(application(app.name), app) if baseline.name == "quilting"]
    return baseline.fit(tasks, Generator().manual_seed(seed), CostLimits(64, 1))


def waves(period: float) -> Tensor:
    wave = torch.sin(torch.arange(SIZE) * (2 * torch.pi / period))
    return 1 + 0.3 * wave[:, None] * wave


def test_a_flat_even_material_comes_back_with_its_colour_and_gloss(app: SvbrdfStationary) -> None:
    tasks = stack_tasks(app, [task_of(app, material())])
    fitted = quilting(app, tasks)
    maps = fitted.prediction()
    assert maps.diffuse.shape == (1, JUDGED_PICTURES, 3, SIZE, SIZE)
    torch.testing.assert_close(maps.diffuse.mean((0, 1, 3, 4)), torch.tensor(DIFFUSE), rtol=0.1, atol=0)
    assert float(maps.diffuse.std((3, 4)).max()) < 0.01
    assert float(maps.roughness.mean()) == pytest.approx(ROUGHNESS, rel=0.12)
    assert float(maps.specular.mean()) == pytest.approx(F0, rel=0.5)
    assert float(maps.normal[..., 2, :, :].min()) > 0.999
    errors = app.errors_of(maps, tasks)
    assert errors["brightness"] < 0.01
    assert errors["relit"] < 0.1
    assert (fitted.kept_numbers, fitted.kept_bytes) == (3 * SIZE * SIZE + 5, 3 * SIZE * SIZE + 20)


def test_maps_tile_and_go_on_across_their_edges(app: SvbrdfStationary) -> None:
    tasks = stack_tasks(app, [task_of(app, material(waves(9.7)))])  # no whole number of waves
    diffuse = quilting(app, tasks).prediction().diffuse
    for axis in (-1, -2):
        steps = (diffuse - diffuse.roll(1, axis)).abs().mean((0, 1, 2, -1 if axis == -2 else -2))
        assert float(steps[0]) < 1.5 * float(steps[1:].mean())


def test_the_same_seed_makes_the_same_maps(app: SvbrdfStationary) -> None:
    noise = torch.rand(SIZE, SIZE, generator=Generator().manual_seed(0))
    tasks = stack_tasks(app, [task_of(app, material(0.5 + noise))])
    photo, light = tasks.data["image"].float() / 255, tasks.data["light"]
    first, same, other = (quilt_maps(photo, light, Generator().manual_seed(seed)) for seed in (0, 0, 1))
    torch.testing.assert_close(first, same)
    assert not torch.equal(first.diffuse, other.diffuse)
    mean = [float(maps.diffuse.mean()) for maps in (first, other)]
    assert mean == pytest.approx([sum(DIFFUSE) / 3] * 2, rel=0.1)
