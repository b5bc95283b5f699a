"""The peer of guided_path in the benchmark: its SD-tree is a density, its pictures have path's mean and less noise."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from benchmarks.guiding_scenes import scenes
from data_tools.synthetic.cornell import Scene
from metapp.rendering.scenes.instances import instantiate
from tests.needs_mitsuba import needs_mitsuba

pytestmark = needs_mitsuba
SIZE, SPP, RUNS, PAIRS = 32, 256, 8, 2**17


@pytest.fixture(autouse=True)
def module(mi: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module, for small pictures."""
    from benchmarks import practical_path_guiding

    practical_path_guiding.register()
    monkeypatch.setattr(practical_path_guiding, "FIRST", 2**11)
    return practical_path_guiding


def pictures(mi: Any, scene: Scene, kind: str, spp: int = SPP, runs: int = RUNS) -> Any:
    """Several pictures of other seeds, [runs, rows, columns, 3]."""
    scene["sensor"]["film"] |= {"width": SIZE, "height": SIZE}
    loaded = instantiate(mi, scene)
    integrator = mi.load_dict({"type": kind, "max_depth": 5})
    first = 100 if kind == "path" else 0
    made = [mi.render(loaded, integrator=integrator, spp=spp, seed=first + seed) for seed in range(runs)]
    return np.stack([np.array(each, np.float64)[..., :3] for each in made])


def deviation(mi: Any, scene: Scene) -> float:
    """How far the means of pictures guided and by path are from each other, in standard errors."""
    guided, regular = (pictures(mi, scene, kind).mean((1, 2, 3)) for kind in ("practical_path_guiding", "path"))
    error = math.sqrt((guided.var(ddof=1) + regular.var(ddof=1)) / RUNS)
    assert error < 0.01 * regular.mean()  # or it would say little
    return abs(float(guided.mean() - regular.mean())) / error


@pytest.mark.long
@pytest.mark.parametrize("name", ["box 101", "mitsuba"])
def test_the_mean_is_that_of_path(mi: Any, name: str) -> None:
    assert deviation(mi, scenes()[name]) < 3


@pytest.mark.long
def test_a_tree_that_is_wrong_about_itself_is_found_out(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.sd_tree import SDTree

    density = SDTree.density
    monkeypatch.setattr(SDTree, "density", lambda *arguments: 0.7 * density(*arguments))
    assert deviation(mi, scenes()["mitsuba"]) > 5


@pytest.mark.long
def test_there_is_less_noise_behind_a_baffle_in_the_same_samples(mi: Any) -> None:
    made = (pictures(mi, scenes()["baffle"], kind, 2048, 2) for kind in ("practical_path_guiding", "path"))
    guided, regular = ((np.abs(one - two) / (one + two + 0.02)).mean() for one, two in made)
    assert guided < 0.95 * regular  # 0.87 with two million paths, 0.53 with eight at 128 px


@pytest.fixture
def tree(mi: Any) -> Any:
    """A tree that has learned, in two iterations, a bright spot of directions where x is below 1/2, another above."""
    from benchmarks.sd_tree import SDTree

    made, rng = SDTree(np.zeros(3), np.ones(3)), np.random.default_rng(1)
    for _ in range(2):
        point = mi.Point3f(rng.random((3, PAIRS)).astype(np.float32))
        way = mi.warp.square_to_uniform_sphere(mi.Point2f(rng.random((2, PAIRS)).astype(np.float32)))
        bright = way.x * mi.Float(np.where(point.x.numpy() < 0.5, 1.0, -1.0).astype(np.float32)) > 0.95
        radiance = mi.Float(np.where(bright.numpy(), 10.0, 0.1).astype(np.float32))
        made.add(made.leaf(made.tree(point), way, True), mi.Float(1), radiance, radiance, True)
        made.learn(100)
    return made


def test_quadtrees_are_densities_of_what_they_sample(mi: Any, tree: Any) -> None:
    rng = np.random.default_rng(2)
    point = mi.Point3f(rng.random((3, PAIRS)).astype(np.float32))
    uniform = mi.warp.square_to_uniform_sphere(mi.Point2f(rng.random((2, PAIRS)).astype(np.float32)))
    numbers = (mi.Float(rng.random(PAIRS).astype(np.float32)), mi.Point2f(rng.random((2, PAIRS)).astype(np.float32)))
    within = tree.tree(point)
    everywhere = tree.density(tree.leaf(within, uniform, True), True).numpy() * 4 * np.pi
    assert everywhere.mean() == pytest.approx(1, abs=float(5 * everywhere.std() / math.sqrt(PAIRS)))
    leaf, way = tree.sample(within, *numbers, True)
    found = tree.leaf(within, way, True)
    assert (leaf.numpy() == found.numpy()).mean() > 0.999  # but at edges, by rounding
    # importance sampling of a function by them has the mean of uniform sampling
    weighed = way.x.numpy() ** 2 / (tree.density(leaf, True).numpy() * 4 * np.pi)
    assert weighed.mean() == pytest.approx(1 / 3, abs=float(5 * weighed.std() / math.sqrt(PAIRS)))


def test_trees_learn_where_light_comes_from(mi: Any, tree: Any) -> None:
    assert len(tree.corners) > 8
    rng = np.random.default_rng(3)
    numbers = (mi.Float(rng.random(PAIRS).astype(np.float32)), mi.Point2f(rng.random((2, PAIRS)).astype(np.float32)))
    for x, sign in ((0.2, 1.0), (0.8, -1.0)):
        _, way = tree.sample(tree.tree(mi.Point3f(x, 0.5, 0.5)), *numbers, True)
        # 10 from 1/40 of the sphere, 0.1 from the others
        assert (way.x.numpy() * sign > 0.95).mean() == pytest.approx(0.25 / 0.3475, abs=0.1)


@pytest.mark.parametrize("spp", [1, 3, 4, 17, 600])
def test_iterations_are_of_twice_the_samples(module: Any, spp: int) -> None:
    parts = module.iterations(spp, 256)
    assert sum(parts) == spp
    assert all(later == 2 * earlier for earlier, later in itertools.pairwise(parts[:-1]))
    assert all(isinstance(part, int) and part > 0 for part in parts)
