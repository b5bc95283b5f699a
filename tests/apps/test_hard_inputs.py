"""What ships, on inputs that learned rules were not trained for: suns, black, saturated and tiny ones.

The guard's promise: nothing that a fit sees is worse than at its initialisation, nor much worse than by QuickFT.
"""

import itertools
import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import pytest
import torch
from torch import Generator, Tensor

from data_tools.random_streams import random_stream
from data_tools.readers.brdf_task import make_brdf_task
from data_tools.readers.environment_maps import make_map_task
from data_tools.readers.svbrdf_task import make_svbrdf_task
from metapp.appearance.latlong import solid_angles, sphere_normals, texel_directions
from metapp.appearance.svbrdf_maps import Maps, pack_maps
from metapp.learning.app import App, stack_tasks
from metapp.learning.learn import DescentState, final_item
from metapp.learning.task import Params, Task, Tasks
from metapp.paradigms.methods import Method, descend_tasks, fit_tasks, make_method
from metapp.runs.checkpoints import read_checkpoint
from metapp.runs.resolve import complete
from metapp.runs.spec import Spec
from tests.marked import long
from tests.recipe_apps import app_by_recipe, recipes_of

WORSE = 1.2  # than QuickFT's


class Found(NamedTuple):
    """Fits of hard inputs: the initialisation, QuickFT's, the rule's own, and as it is guarded."""

    tasks: Tasks
    first: Params
    quickft: Params
    alone: Params
    guarded: DescentState


def fit_by_shipped_checkpoint(app: App, sources: Iterable[Task]) -> Found:
    """Fits by what ships, with the same draws."""
    recipe = recipes_of(app.name, app.observes)["quick"]
    tasks = stack_tasks(app, list(sources))

    def shipped(paradigm: str) -> Method:
        spec = complete(Spec(app=app.name, paradigm=paradigm, observe=app.observes, recipe="quick", device="cpu"))
        return make_method(paradigm, app, recipe, read_checkpoint(spec, app, recipe))

    meta, quickft = shipped("meta"), shipped("quickft")
    rng = [Generator().manual_seed(0) for _ in range(4)]
    return Found(
        tasks,
        meta.start(tasks, rng[0]),
        fit_tasks(quickft, tasks, rng[1]),
        fit_tasks(meta._replace(guard=None), tasks, rng[2]),
        final_item(descend_tasks(meta, tasks, rng[3])),
    )


def visible(app: App, theta: Params, tasks: Tasks) -> Tensor:
    """The plain loss of what fits see, on other samples than they drew, [T]."""
    rng, count = Generator().manual_seed(1), recipes_of(app.name)["quick"].samples
    batches = [app.sample(tasks, rng, count) for _ in range(1 if app.deterministic else 4)]
    with torch.no_grad():
        return torch.stack([app.loss(theta, batch, {}) for batch in batches]).mean(0)


def check(app: App, sources: Iterable[Task]) -> Found:
    found = fit_by_shipped_checkpoint(app, sources)
    first, quickft, alone, guarded = (
        visible(app, theta, found.tasks) for theta in (found.first, found.quickft, found.alone, found.guarded.theta)
    )
    names, acted = found.tasks.names, found.guarded.guarded
    above = {
        name: pair for name, *pair in zip(names, guarded.tolist(), first.tolist(), strict=True) if pair[0] > pair[1]
    }
    assert not above, f"above the initialisation: {above}"
    pairs = zip(names, guarded.tolist(), quickft.tolist(), strict=True)
    worse = {name: pair for name, *pair in pairs if pair[0] > WORSE * pair[1] + 1e-6}
    assert not worse, f"worse than QuickFT: {worse}"
    for key, value in found.alone.items():
        assert torch.equal(value[~acted], found.guarded.theta[key][~acted])
    assert (guarded[acted] < alone[acted]).all()
    return found


# BRDFs


def ggx(roughness: float, colour: list[float], diffuse: float = 0.0) -> Callable[[Tensor], Tensor]:
    """A GGX peak [N, 3] without shadowing at half angles, over a diffuse ground."""

    def evaluate(angles: Tensor) -> Tensor:
        cos2, a2 = angles[:, :1].cos().square(), roughness**2
        peak = a2 / (math.pi * (cos2 * (a2 - 1) + 1).square())
        return (diffuse + peak / 4 * torch.tensor(colour, dtype=angles.dtype)).float()

    return evaluate


MATERIALS: dict[str, Callable[[Tensor], Tensor]] = {
    "black": ggx(0.5, [0.0] * 3),
    "nearly black": ggx(0.5, [0.0] * 3, 1e-6),
    "white": ggx(0.5, [0.0] * 3, 1 / math.pi),
    "saturated": ggx(0.5, [0.0] * 3, 10.0),
    "gold": ggx(0.1, [1.0, 0.8, 0.4]),
    "mirror": ggx(0.005, [1.0, 0.8, 0.4]),
    "searchlight": ggx(0.05, [100.0] * 3),
    "lacquer": ggx(0.005, [0.04] * 3, 0.1 / math.pi),
    "black lacquer": ggx(0.005, [0.04] * 3, 1e-4),
}


def test_guard_keeps_extreme_brdfs_usable() -> None:
    sources = [make_brdf_task(name, evaluate, samples=8192) for name, evaluate in MATERIALS.items()]
    found = check(app_by_recipe("brdf"), sources)
    acted = dict(zip(found.tasks.names, found.guarded.guarded.tolist(), strict=True))
    assert acted["saturated"]
    assert acted["searchlight"]
    assert not acted["black"]
    assert not acted["white"]


# Environment maps


def map_of(name: str, light: Tensor) -> Task:
    return make_map_task(name, light, random_stream(0))


def sun(row: int, column: int, size: int, share: float, ground: Tensor) -> Tensor:
    """A map [3, 64, 128] with `share` of its light in size x size texels."""
    angles = solid_angles(64, 128)[:, :1]
    light = ground / (ground * angles).sum((1, 2)).mean()
    light[:, row : row + size, column : column + size] = share / (1 - share) / float(angles[row] * size * size)
    return light


def sky() -> Tensor:
    up = texel_directions(64, 128)[1]
    return torch.where(up > 0, (0.6 + 0.4 * up) * torch.tensor([0.6, 0.8, 1.0])[:, None, None], 0.15)


@pytest.mark.long
@pytest.mark.usefixtures("second_scene")
def test_guard_keeps_maps_with_suns_usable() -> None:
    """Small suns are known; what a wider one's fit ends at is chance, and the guard ends that where it sees it."""
    app = app_by_recipe("illumination")
    places = itertools.product((5, 8, 12, 24), (20, 64), (1, 2))
    suns = [(row, column, size, share) for (row, column, size), share in zip(places, 8 * (0.97, 0.997), strict=True)]
    found = check(
        app, [map_of(f"sun {place_and_light}", sun(*place_and_light, ground=sky())) for place_and_light in suns]
    )
    quickft, alone, guarded = (
        app.errors(theta, found.tasks)["error"] for theta in (found.quickft, found.alone, found.guarded.theta)
    )
    acted = found.guarded.guarded
    assert acted.any()
    assert guarded[acted].mean() < 0.6 * alone[acted].mean()
    assert guarded.mean() < 0.005  # .0074 until a map's known mean was taken, QuickFT .040 then and .012 now
    assert guarded.max() < 0.4 * quickft.max()


@pytest.mark.long
@pytest.mark.usefixtures("second_scene")
def test_guard_keeps_extreme_maps_usable() -> None:
    rng = Generator().manual_seed(0)
    black, ones = torch.zeros(3, 64, 128), torch.ones(3, 64, 128)
    lamp, lamps = black.clone(), sky()
    lamp[:, 20, 40] = 1.0
    lamps[:, torch.randint(64, (6,), generator=rng), torch.randint(128, (6,), generator=rng)] = 1e4
    lights = {
        "black but for a texel": lamp,
        "constant": ones,
        "tiny": 1e-6 * sky(),
        "red": ones * torch.tensor([1.0, 1e-4, 1e-4])[:, None, None],
        "half black": torch.cat([ones[:, :32], black[:, :32]], 1),
        "lamps": lamps,
        "noise": torch.randn(3, 64, 128, generator=rng).mul(3).exp(),
        "few pixels": torch.rand(3, 2, 4, generator=rng).repeat_interleave(32, 1).repeat_interleave(32, 2),
    }
    check(app_by_recipe("illumination"), [map_of(name, light) for name, light in lights.items()])


def ball(name: str, colour: float, spot: int = 0) -> Task:
    """A photograph of a sphere of one display value, with a white spot of so many px."""
    photo = colour * sphere_normals(64)[1].float().expand(3, -1, -1).clone()
    photo[:, 20 : 20 + spot, 30 : 30 + spot] = 255
    return Task(name, {"photos": photo.round().to(torch.uint8)[None]})


@pytest.mark.usefixtures("second_scene")
def test_guard_keeps_extreme_sphere_photos_usable() -> None:
    app = app_by_recipe("illumination", observes="photo")
    inputs = (
        ("black", 0, 0),
        ("nearly black", 1, 0),
        ("white", 255, 0),
        ("grey", 128, 0),
        ("sun", 0, 2),
        ("day", 80, 4),
    )
    check(app, [ball(name, colour, spot) for name, colour, spot in inputs])


# Materials that are photographed


@pytest.mark.parametrize("protocol", ["reference", "photo"])
def test_guard_keeps_flat_materials_usable(protocol: str) -> None:
    app = app_by_recipe("svbrdf_nonstationary", observes=protocol)

    def material(name: str, diffuse: float, specular: float, roughness: float) -> Task:
        flat = torch.ones(1, 128, 128)
        normal = torch.cat([0 * flat, 0 * flat, flat])
        maps = Maps(diffuse * flat.expand(3, -1, -1), specular * flat, roughness * flat, normal)
        return make_svbrdf_task(name, pack_maps(maps))

    check(app, [material("black", 0, 0, 1), material("white", 1, 0, 1), material("mirror", 0, 1, 0.1)])


@pytest.mark.usefixtures("vgg_weights")
@pytest.mark.parametrize("name", [long("texture"), pytest.param("svbrdf_stationary", marks=pytest.mark.slow)])
def test_guard_keeps_extreme_pictures_usable(name: str) -> None:
    few = torch.rand(3, 2, 2, generator=Generator().manual_seed(0))
    images = {
        "black": torch.zeros(3, 64, 64),
        "white": torch.ones(3, 64, 64),
        "few pixels": few.repeat_interleave(32, 1).repeat_interleave(32, 2),
    }
    check(app_by_recipe(name), [Task(kind, {"image": (255 * image).to(torch.uint8)}) for kind, image in images.items()])
