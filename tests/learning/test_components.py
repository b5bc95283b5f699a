"""Applications made of components: what steps and outer losses see, and training tasks that lack the truth."""

from dataclasses import replace

import pytest
import torch
from torch import Generator

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.feature_network import Featured
from metapp.apps.brdf.sample_sight import DistinctSampleSight, SampleSight
from metapp.learning.app import stack_tasks
from metapp.learning.components import name_tensors
from metapp.learning.task import Task, Tasks
from tests.paradigms.small import SMALL_APPLICATIONS, SMALL_PHOTO_APPS, seeded_generator

APPS = {name: small.app for name, small in SMALL_APPLICATIONS.items()}


def tasks_of(name: str) -> list[Task]:
    return SMALL_APPLICATIONS[name].tasks()[:2]


@pytest.mark.parametrize("name", APPS)
def test_steps_see_what_the_sight_shows_alone(name: str) -> None:
    """Sights of a varying number of tensors show a dictionary, which has none of the truth."""
    app = APPS[name]
    tasks = stack_tasks(app, tasks_of(name))
    batch = app.sample(tasks, seeded_generator(), 8)
    assert set(batch) == set(name_tensors(app.sight.read(batch)))
    outer_batch = app.outer_sample(tasks, seeded_generator(), 8)
    assert set(outer_batch) >= set(name_tensors(app.judge.sample(tasks, seeded_generator(), 8)))
    assert (set(outer_batch) >= set(batch)) or app.judge.trains_by_sight


@pytest.mark.parametrize("name", ["illumination", "svbrdf_nonstationary"])
def test_training_tasks_without_the_truth_are_refused_in_a_line(name: str) -> None:
    truth = {"illumination": "map", "svbrdf_nonstationary": "maps"}[name]
    app = SMALL_PHOTO_APPS[name]
    known, unknown = tasks_of(name)
    unknown = unknown._replace(data={key: value for key, value in unknown.data.items() if key != truth})
    for tasks in (stack_tasks(app, [known, unknown]), stack_tasks(app, [unknown])):
        assert app.errors(app.init(seeded_generator(), len(tasks)), tasks) == {}
        for train in (app.augment, lambda tasks, rng: app.outer_sample(tasks, rng, 1)):
            with pytest.raises(
                ValueError, match=rf"^[\w-]+: no {truth} in this or another training task, expected the truth"
            ):
                train(tasks, seeded_generator())


def test_a_component_is_exchanged_by_itself() -> None:
    app = Brdf()
    assert type(app.sight) is SampleSight
    assert type(Brdf(Featured()).sight) is DistinctSampleSight
    with pytest.raises(ValueError, match="SampleSight, expected a DistinctSampleSight for this network"):
        replace(app, decoder=Featured())
    assert replace(app, decoder=Featured(), sight=None) == Brdf(Featured())


def test_fits_of_brdfs_see_the_first_half_alone() -> None:
    app = Brdf()
    tasks: Tasks = stack_tasks(app, tasks_of("brdf"))
    seen, truth = app.sight.gather(tasks), app.judge.gather(tasks)
    half = tasks.data["where"].shape[1] // 2
    assert torch.equal(seen.where, tasks.data["where"][:, :half].mT)
    assert torch.equal(truth.where, tasks.data["where"][:, half:].mT)
    drawn = app.sample(tasks, Generator().manual_seed(0), 64)
    places = {tuple(place) for place in seen.where[0].T.tolist()}
    assert all(tuple(place) in places for place in drawn["where"][0].T.tolist())
