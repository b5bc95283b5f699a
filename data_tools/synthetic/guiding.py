"""Tasks of guide priors: what caches of random rooms know after so many paths, and what many more find.

Each room is rendered at 64 px by `guided_path`, whose cache is looked at on the way.
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from data_tools.synthetic.rooms import random_room
from metapp.learning.task import Task
from metapp.rendering import equal_time
from metapp.rendering.guide_cache import halved, moments, voxels_of
from metapp.rendering.guide_prior import Prior, init, taught
from metapp.rendering.guided_path import PathTracer, Settings
from metapp.rendering.guided_picture import GuidedPicture, Part
from metapp.rendering.guided_plugin import RR_DEPTH
from metapp.rendering.path_space import DEPTH
from metapp.rendering.scene_loading import load_scene

SIZE = 64  # px
# samples a pixel between looks: after 2^14 paths of the survey, 2^16, 2^17, 2^18, 2^19 and 2^21
PARTS = ((12,), (16,), (32,), (64,), (128, 256))
NAMES = ("2^14", "2^16", "2^17", "2^18")
ROWS = 192  # places of a task, drawn by how many paths met them

Sums = tuple[Tensor, Tensor]  # of squares and counts in the places that a survey saw, [P, SIDE, SIDE] each


def guide_tasks(kind: str, seed: int) -> list[Task]:
    """A room's tasks, one for each of NAMES.

    Args:
        kind, seed: as of `random_room`.

    Raises:
        ValueError: as `random_room`, or Mitsuba cannot be loaded.
    """
    mi, scene, _ = load_scene(random_room(kind, seed))
    equal_time.resize(mi, scene, SIZE)
    path = mi.load_dict({"type": "path", "max_depth": DEPTH})
    tracer = PathTracer(mi, Settings(DEPTH, RR_DEPTH))
    picture = GuidedPicture(path, tracer, scene, scene.sensors()[0], seed, init(Generator()))
    prior = picture.cache.expects
    assert isinstance(prior, Prior)
    looks = [_sums(picture, prior)]
    for parts in PARTS:
        for spp in parts:
            picture.pays = True  # the guard has no say
            picture.add(Part(spp, learns=True))
        looks.append(_sums(picture, prior))
    voxels = prior.seen.voxels
    rng = Generator().manual_seed(seed)
    last = looks[-1]
    tasks = []
    for number, name in enumerate(NAMES):
        now, later = looks[number], looks[number + 1]
        around = moments(*now, voxels)
        features = torch.cat([prior.seen.features, taught(*now, around)], 1)
        visible, truth = ((b[0] - a[0]).clamp_min(0).flatten(1) for a, b in ((now, later), (later, last)))
        usable = ((visible.sum(1) > 0) & (truth.sum(1) > 0)) * last[1].flatten(1).sum(1)
        rows = torch.multinomial(usable, ROWS, replacement=True, generator=rng)
        data = {"features": features[rows].half()}
        data |= {key: _shares(value[rows]) for key, value in (("visible", visible), ("truth", truth))}
        tasks.append(Task(f"{kind}-{seed}-{name}", data, f"{kind}-{seed}"))
    return tasks


def _sums(picture: GuidedPicture, prior: Prior) -> Sums:
    """The cache's sums in the places that the survey saw."""
    seen, squares, counts = picture.cache.taught()
    total, count, coarse, _ = halved(squares, counts, voxels_of(seen))
    known, rows = prior.seen.find(coarse)
    first, second = (each.new_zeros(len(prior.seen.features), *each.shape[1:]) for each in (total, count))
    first[rows], second[rows] = total[known], count[known]
    return first, second


def _shares(values: Tensor) -> Tensor:
    return (values / values.sum(1, keepdim=True)).float()
