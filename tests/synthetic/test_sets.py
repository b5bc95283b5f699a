"""What all synthetic sets have in common: counts, names, tensors, and the same draws for a seed everywhere."""

import functools
import itertools
import json
import math
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from torch import Tensor

from data_tools.random_streams import random_stream
from data_tools.synthetic import brdf, svbrdf_nonstationary
from data_tools.synthetic.cornell import random_scene, to_xml
from data_tools.synthetic.examples import EXAMPLES, write_example
from data_tools.synthetic.illumination import draw_white_balance
from data_tools.synthetic.stationary.periodic_maps import PeriodicMaps
from data_tools.synthetic.svbrdf_stationary import FLAT_FAMILIES, map_statistics_of_sides, take_flash_photos
from data_tools.synthetic.svbrdf_stationary import synthetic_tasks as flash_tasks
from data_tools.synthetic.texture import synthetic_tasks
from metapp.appearance.colour import radiance_to_display
from metapp.appearance.flash import camera_position, render_maps, texel_positions
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.latlong import luminance, mean_luminance
from metapp.appearance.svbrdf_maps import Maps, unpack_maps
from metapp.learning.task import Task
from metapp.registry import registry
from metapp.runs.data_sets.embedded import make_embedded_set
from metapp.storage.shards import read_manifest
from tests.needs_mitsuba import needs_mitsuba
from tests.recipe_apps import app_names, application

TRAIN = {"texture": 100, "svbrdf_stationary": 64, "svbrdf_nonstationary": 48, "illumination": 48}  # tasks for training


class Drawn(NamedTuple):
    """A module of `data_tools.synthetic` and tasks of it: some for training, all for testing."""

    source: ModuleType
    train: list[Task]
    test: list[Task]

    @property
    def tasks(self) -> list[Task]:
        return self.train + self.test


def source_of(app: str) -> ModuleType:
    """The module that draws them."""
    return import_module(f"data_tools.synthetic.{app}")


@functools.cache
def drawn_set(app: str) -> Drawn:
    """The set of an application with images or maps."""
    source = source_of(app)
    sets = (source.synthetic_tasks("train", TRAIN[app]), source.synthetic_tasks("test", source.COUNTS["test"]))
    return Drawn(source, *map(list, sets))


Kind = tuple[torch.dtype, tuple[int, ...]]
IMAGE: Kind = (torch.uint8, (3, 256, 256))


class Expected(NamedTuple):
    """What a set has.

    Attributes:
        counts: tasks for training and for testing.
        names: some, by their place.
        tensors: of all tasks, by name; the first of them is compared.
        means: of its channels over all tasks.
        spread: standard deviations of the tasks' own means.
        tolerance: absolute, of both.
        apart: the least mean difference of two tasks at an eighth of their size, and of tasks of the same place by
            another seed.
    """

    counts: tuple[int, int]
    names: dict[int, str]
    tensors: dict[str, Kind]
    means: tuple[float, ...]
    spread: tuple[float, ...]
    tolerance: float
    apart: float


SETS = {
    "texture": Expected(
        (240, 20), {0: "bricks-000", 100: "bricks-t000"}, {"image": IMAGE},
        (136.20, 127.91, 115.55), (28.56, 24.97, 24.67), 0.05, 2.55,
    ),
    "svbrdf_stationary": Expected(
        (120, 16), {}, {"image": IMAGE}, (113.60, 102.12, 98.08), (27.89, 23.31, 26.08), 0.05, 2.55
    ),
    "svbrdf_nonstationary": Expected(
        (1200, 16), {0: "inlay-000", 48: "inlay-t000"},
        {"maps": (torch.float16, (10, 128, 128)), "photo": (torch.uint8, (3, 128, 128))},
        (0.0030, 0.0025, 0.9560, 0.2005, 0.1732, 0.1500, 0.4850, 0.2092, 0.1883, 0.1628),
        (0.0159, 0.0193, 0.0400, 0.1772, 0.1593, 0.1434, 0.1530, 0.2263, 0.2046, 0.1852), 0.0005, 0.02,
    ),
    "illumination": Expected(
        (900, 16), {0: "meadow-000", 1: "apartment-001", 48: "meadow-t000"},
        {"map": (torch.float32, (3, 64, 128)), "photos": (torch.uint8, (4, 3, 64, 64)), "scale": (torch.float32, ())},
        (1.0210, 0.9278, 0.8813), (0.2404, 0.1904, 0.2582), 0.0015, 0.15,
    ),
}  # fmt: skip


@pytest.fixture(params=SETS)
def app(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def data(app: str) -> Drawn:
    return drawn_set(app)


@pytest.mark.long
def test_sets_have_the_stated_counts_names_and_tensors(app: str, data: Drawn) -> None:
    counts, known_names, tensors = SETS[app][:3]
    assert (data.source.COUNTS["train"], data.source.COUNTS["test"]) == counts
    names = [task.name for task in data.tasks]
    assert len(set(names)) == len(names) == len(data.train) + counts[1]
    assert {place: names[place] for place in known_names} == known_names
    families = FLAT_FAMILIES if app == "svbrdf_stationary" else data.source.FAMILIES
    for split in (names[: len(families)], names[len(data.train) :]):
        assert {name.split("-")[0] for name in split} == set(families) or len(split) < len(families)
    for task in data.tasks:
        more = {"relit" if task in data.test else "truth"} if app == "svbrdf_stationary" else set()
        assert set(task.data) == tensors.keys() | more <= set(data.source.UNITS)
        assert {key: (task.data[key].dtype, task.data[key].shape) for key in tensors} == tensors


@pytest.mark.long
def test_a_larger_set_begins_with_the_smaller_one(app: str, data: Drawn) -> None:
    for first, two in zip(data.source.synthetic_tasks("train", 6), data.train, strict=False):
        assert first.name == two.name
        assert all(torch.equal(first.data[key], two.data[key]) for key in two.data)
    key = next(iter(SETS[app].tensors))
    for first, two in zip(data.source.synthetic_tasks("train", 8, seed=1), data.train, strict=False):
        assert (first.data[key].float() - two.data[key].float()).abs().mean() > SETS[app].apart


@pytest.mark.long
def test_draws_are_the_same_everywhere_and_no_two_are_alike(app: str, data: Drawn) -> None:
    """Whoever changes a draw changes the default data set, and with it all checkpoints and tables."""
    expected = SETS[app]
    tensors = torch.stack([task.data[next(iter(expected.tensors))] for task in data.tasks]).float()
    means = tensors.mean((2, 3))
    found = torch.stack([means.mean(0), means.std(0)])
    expected_values = torch.tensor([expected.means, expected.spread])
    torch.testing.assert_close(found, expected_values, atol=expected.tolerance, rtol=0)
    small = torch.nn.functional.avg_pool2d(tensors, 8).flatten(1)
    apart = torch.cdist(small, small, p=1).fill_diagonal_(float("inf")) / small.shape[1]
    assert apart.min() > expected.apart  # with that no test task is a training task


def test_the_embedded_set_has_all_units(app: str, tmp_path: Path) -> None:
    options = {"maps": True} if app == "svbrdf_stationary" else {}
    manifest = read_manifest(make_embedded_set(application(app), count=5, out=tmp_path, quiet=True, options=options))
    assert (manifest.app, manifest.units) == (app, source_of(app).UNITS)
    assert [entry.split for entry in manifest.tasks].count("test") >= 1


@pytest.mark.parametrize("arguments", [("validation", 1), ("train", -1), ("test", 5, -2)])
def test_impossible_sets_are_errors(app: str, arguments: tuple[Any, ...]) -> None:
    with pytest.raises(ValueError, match="expected"):
        next(source_of(app).synthetic_tasks(*arguments))
    with pytest.raises(ValueError, match="expected"):
        brdf.synthetic_materials(*arguments)


# The example inputs


@pytest.mark.parametrize("app", app_names())
def test_example_inputs_are_small_files_of_listed_names(app: str, tmp_path: Path) -> None:
    files = write_example(app, tmp_path / "new")
    assert files == [tmp_path / "new" / name for name in EXAMPLES[app].files]
    assert sorted((tmp_path / "new").iterdir()) == sorted(files)
    assert all(file.stat().st_size < 500_000 for file in files)


def test_an_application_without_example_inputs_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"smell: no example inputs, expected one of brdf, .*\.$"):
        write_example("smell", tmp_path)


# The synthetic environments


@pytest.mark.long
def test_maps_are_finite_lit_everywhere_and_of_mean_luminance_1() -> None:
    tasks = drawn_set("illumination").tasks
    light = torch.stack([task.data["map"] for task in tasks])
    assert light.isfinite().all()
    assert light.min() >= 0
    assert (mean_luminance(light) - 1).abs().max() < 1e-4
    assert (luminance(light) > 0).float().mean() > 0.98
    # kcd/m^2: from lamplight to sunlight
    scales = torch.stack([task.data["scale"] for task in drawn_set("illumination").train])
    assert scales.min() > 1e-3
    assert scales.max() < 50
    assert scales.max() > 300 * scales.min()


def test_cameras_take_away_strong_casts() -> None:
    red = torch.tensor([8.0, 1.0, 0.25]).expand(64, 128, 3).permute(2, 0, 1).numpy()
    for seed in range(50):
        gains = torch.from_numpy(draw_white_balance(red, random_stream(seed)))
        seen = gains * torch.tensor([8.0, 1.0, 0.25])
        assert 0.4 < seen[0] / seen[2] < 2 ** (1.2 + 0.6) * 1.01


# The synthetic textures and flash photographs


def test_tasks_have_the_size_asked_for(tmp_path: Path) -> None:
    large, again = (next(synthetic_tasks("train", 1, size=96)).data["image"] for _ in range(2))
    assert large.shape == (3, 96, 96)
    assert torch.equal(large, again)
    assert not torch.equal(large, next(synthetic_tasks("train", 1, seed=1, size=96)).data["image"])
    folder = make_embedded_set(
        registry().application("texture"), count=2, out=tmp_path / "large", quiet=True, options={"size": 64}
    )
    assert read_manifest(folder).notes["size"] == 64
    with pytest.raises(
        ValueError, match=r"^brdf: size 64, but its embedded set has no such option; leave --size out\.$"
    ):
        make_embedded_set(
            registry().application("brdf"), count=2, out=tmp_path / "no", quiet=True, options={"size": 64}
        )


# Under a flash


def test_true_map_reproduces_the_photograph_up_to_exposure() -> None:
    """Maps of one value each: a photograph of those that the statistics tell is the one that they belong to."""
    size, one = 64, np.ones((1, 64, 64), np.float32)
    plain = PeriodicMaps(0.3 * np.repeat(one, 3, 0), 0.06 * one, 0.5 * one, 0 * one)
    shots = take_flash_photos(plain, random_stream(3))
    photo, truth = shots.photo, map_statistics_of_sides(shots.maps)
    means, deviations = truth[:, 0], truth[:, 1]
    assert truth.shape == (3, 2, 6)
    assert means[:, :3].std() < 1e-4
    torch.testing.assert_close(deviations, torch.full((3, 6), 1e-4), rtol=0, atol=2e-3)
    torch.testing.assert_close(means[:, 4:], torch.tensor([0.5, 0.0]).expand(3, 2), rtol=0, atol=2e-3)
    albedo, specular = means[0, 0] ** 2.2, means[0, 3] ** 2.2
    torch.testing.assert_close(specular / albedo, torch.tensor(0.06 / 0.3))
    square = torch.ones(1, size, size)
    maps = Maps(albedo * square.expand(3, -1, -1), specular * square, 0.5 * square, normal_from_height(0 * square))
    again = radiance_to_display(
        render_maps(maps, texel_positions(size, size), camera_position(), camera_position(), falloff=1.0)
    )
    assert (again - photo / 255).abs().mean() < 0.02  # but for the flash's exact place and cone


def test_maps_of_flash_photographs_are_stored_where_they_are_asked_for() -> None:
    """They make the photograph, and their statistics are those that are stored; test tasks hold none."""
    (plain,), (task,) = (list(flash_tasks("train", 1, size=64, maps=maps)) for maps in (False, True))
    assert "maps" not in plain.data
    assert torch.equal(plain.data["image"], task.data["image"])
    assert "maps" not in next(flash_tasks("test", 1, size=64, maps=True)).data
    maps = unpack_maps(task.data["maps"].float())
    statistics = map_statistics_of_sides(maps._replace(specular=maps.specular[:1]))
    torch.testing.assert_close(statistics, task.data["truth"], atol=2e-3, rtol=0)
    position = camera_position()
    picture = radiance_to_display(render_maps(maps, texel_positions(64, 64), position, position, falloff=1.0))
    assert float((picture - task.data["image"] / 255).abs().mean()) < 0.03


# The synthetic non-stationary svBRDFs


@pytest.fixture(scope="module")
def maps() -> Maps:
    """Each [64, C, 128, 128]."""
    return unpack_maps(torch.stack([task.data["maps"] for task in drawn_set("svbrdf_nonstationary").tasks]).float())


def metal(maps: Maps) -> Tensor:
    """Return where maps are metal, [N, 128, 128]."""
    return maps.specular.mean(1) > 0.4


@pytest.mark.long
def test_maps_are_physical(maps: Maps) -> None:
    assert all(values.isfinite().all() for values in maps)
    assert (maps.normal.norm(dim=1) - 1).abs().max() < 2e-3  # of 16 bits
    assert maps.normal[:, 2].min() > 0
    for name, (low, high) in {"roughness": (0.0999, 0.9505), "specular": (0.0199, 1), "diffuse": (0, 0.8505)}.items():
        assert low <= getattr(maps, name).min() <= getattr(maps, name).max() <= high, name
    assert (maps.diffuse * (1 - maps.specular) + maps.specular).max() <= 1
    assert maps.diffuse.movedim(1, 0)[:, metal(maps)].mean() < 0.03
    dielectric = maps.diffuse.movedim(1, 0)[:, maps.specular.mean(1) < 0.1]
    assert dielectric.min() > 0.0199


def test_sets_of_larger_maps_hold_even_materials_too() -> None:
    families, side = len(svbrdf_nonstationary.FAMILIES), svbrdf_nonstationary.SIZE + 32
    large, usual = (
        list(svbrdf_nonstationary.synthetic_tasks("train", families + 1, size=size)) for size in (side, side - 32)
    )
    assert [task.name.startswith("even_") for task in large] == [False] * families + [True]
    assert not any(task.name.startswith("even_") for task in usual)
    assert large[-1].data["maps"].shape == (10, side, side)


# Random Cornell boxes, the same again from their JSON text


SCENES = [random_scene(seed) for seed in range(200)]
WALLS = {"floor", "ceiling", "back", "left", "right"}


def spheres(scene: dict[str, Any]) -> list[tuple[np.ndarray, float]]:
    """Centres and radii."""
    matrices = [np.array(part["to_world"]) for key, part in scene.items() if key.startswith("sphere-")]
    return [(matrix[:3, 3], float(np.linalg.norm(matrix[:3, 0]))) for matrix in matrices]


def corners(rectangle: dict[str, Any]) -> np.ndarray:
    """Return the corners of a rectangle, [4, 3]."""
    matrix = np.array(rectangle["to_world"])
    return np.array([(matrix @ [x, y, 0, 1])[:3] for x, y in itertools.product((-1, 1), (-1, 1))])


def facing(rectangle: dict[str, Any]) -> list[float]:
    return np.array(rectangle["to_world"])[:3, 2].tolist()


def check_balls(scene: dict[str, Any]) -> None:
    balls = spheres(scene)
    assert 1 <= len(balls) <= 5
    assert set(scene) == {"type", "sensor", "mirror", "light"} | WALLS | {f"sphere-{i}" for i in range(len(balls))}
    for centre, radius in balls:
        assert (np.abs(centre) + radius <= 1 + 1e-9).all()
        assert abs(centre[0]) + radius < 0.98  # in front of the mirror
        assert centre[1] + radius < 0.98  # below the light
    for (first, near), (second, far) in itertools.combinations(balls, 2):
        assert math.dist(first, second) > near + far


def check_mirror_and_light(scene: dict[str, Any]) -> None:
    mirror, light = corners(scene["mirror"]), corners(scene["light"])
    assert set(mirror[:, 0]) in ({0.99}, {-0.99})
    assert facing(scene["mirror"]) == pytest.approx([-np.sign(mirror[0, 0]), 0, 0])
    assert np.abs(mirror[:, 1:]).max() < 1
    assert set(light[:, 1]) == {0.99}
    assert facing(scene["light"]) == pytest.approx([0, -1, 0])
    assert np.abs(light[:, [0, 2]]).max() < 1
    radiance = scene["light"]["emitter"]["radiance"]["value"]
    assert np.prod(np.ptp(light[:, [0, 2]], axis=0)) * np.mean(radiance) == pytest.approx(4)  # any size gives as much
    for name in WALLS:
        assert np.dot(facing(scene[name]), corners(scene[name]).mean(0)) == pytest.approx(-1)


def test_spheres_mirror_and_light_of_a_box_lie_where_they_should() -> None:
    for scene in SCENES:
        check_balls(scene)
    for scene in SCENES[:50]:
        check_mirror_and_light(scene)


def test_each_seed_gives_one_scene() -> None:
    assert random_scene(3) == SCENES[3]
    assert len({json.dumps(scene) for scene in SCENES}) == len(SCENES)
    with pytest.raises(ValueError, match="seed -1, expected 0 or more"):
        random_scene(-1)


@needs_mitsuba
def test_a_scene_as_xml_is_the_same_as_its_dictionary() -> None:
    from metapp.rendering.paths.path_space import Tracer

    points = torch.rand(4000, 4, generator=torch.Generator().manual_seed(0))
    carried = [
        Tracer(scene).trace_radiance(points, torch.Generator().manual_seed(0))
        for scene in (SCENES[3], {"xml": to_xml(SCENES[3])})
    ]
    assert carried[0].any()
    torch.testing.assert_close(*carried, rtol=1e-4, atol=1e-5)
