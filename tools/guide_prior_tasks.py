"""Tasks of guide priors: what caches of random rooms know after so many paths, and what many more find.

Each room is rendered at 64 px by `guided_path`, whose cache is read on the way.
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from data_tools.synthetic.rooms import random_room
from metapp.extensions.guided import equal_time
from metapp.extensions.guided.histogram import coarsened, second_moments, voxels_of
from metapp.extensions.guided.integrator import RR_DEPTH
from metapp.extensions.guided.path_tracer import PathTracer
from metapp.extensions.guided.picture import GuidedPicture
from metapp.extensions.guided.prior import LearnedPrior, histogram_features, init
from metapp.learning.task import Task
from metapp.rendering.paths.path_space import DEPTH
from metapp.rendering.scenes.loading import load_scene

SIZE = 64  # px
# samples a pixel between readings: after 2^14 paths of the survey, 2^16, 2^17, 2^18, 2^19 and 2^21
PARTS = ((12,), (16,), (32,), (64,), (128, 256))
NAMES = ("2^14", "2^16", "2^17", "2^18")
ROWS = 192  # entries of a task, drawn by how many paths visited them

Sums = tuple[Tensor, Tensor]  # of squares and counts in the entries that were surveyed, [P, SIDE, SIDE] each


def guide_tasks(kind: str, seed: int) -> list[Task]:
    """A room's tasks, one for each of NAMES.

    Args:
        kind, seed: as of `random_room`.

    Raises:
        ValueError: as `random_room`, or Mitsuba cannot be loaded.
    """
    mi, scene, _ = load_scene(random_room(kind, seed))
    equal_time.resize(scene, SIZE)
    path = mi.load_dict({"type": "path", "max_depth": DEPTH})
    tracer = PathTracer(DEPTH, RR_DEPTH)
    picture = GuidedPicture(path, tracer, scene, scene.sensors()[0], seed, init(Generator()))
    prior = picture.cache.prior
    assert isinstance(prior, LearnedPrior)
    readings = [_sums(picture, prior)]
    for parts in PARTS:
        for spp in parts:
            picture.pays = True  # the guard has no say
            picture.add(spp, learns=True)
        readings.append(_sums(picture, prior))
    voxels = prior.survey.voxels
    rng = Generator().manual_seed(seed)
    last = readings[-1]
    tasks = []
    for number, name in enumerate(NAMES):
        now, later = readings[number], readings[number + 1]
        moments = second_moments(*now, voxels)
        features = torch.cat([prior.survey.features, histogram_features(*now, moments)], 1)
        visible, truth = ((b[0] - a[0]).clamp_min(0).flatten(1) for a, b in ((now, later), (later, last)))
        usable = ((visible.sum(1) > 0) & (truth.sum(1) > 0)) * last[1].flatten(1).sum(1)
        rows = torch.multinomial(usable, ROWS, replacement=True, generator=rng)
        data = {"features": features[rows].half()}
        data |= {key: _shares(value[rows]) for key, value in (("visible", visible), ("truth", truth))}
        tasks.append(Task(f"{kind}-{seed}-{name}", data, f"{kind}-{seed}"))
    return tasks


def _sums(picture: GuidedPicture, prior: LearnedPrior) -> Sums:
    """The cache's sums in the entries that were surveyed."""
    visited, squares, counts = picture.cache.statistics()
    total, count, coarse, _ = coarsened(squares, counts, voxels_of(visited))
    known, rows = prior.survey.lookup(coarse)
    surveyed = [sums.new_zeros(len(prior.survey.features), *sums.shape[1:]) for sums in (total, count)]
    surveyed[0][rows], surveyed[1][rows] = total[known], count[known]
    return surveyed[0], surveyed[1]


def _shares(values: Tensor) -> Tensor:
    return (values / values.sum(1, keepdim=True)).float()
