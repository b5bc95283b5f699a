"""Tasks of `bench_balls`: photographs of spheres under light that is known, read as the product reads them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Generator, Tensor

from data_tools.readers.latlong import find, read_map, read_task
from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.latlong import directions, mean_luminance, resample, solid_angles
from metapp.appearance.photograph import Camera, develop, exposures, mirror
from metapp.apps.illumination.mirror import REFLECTANCE
from metapp.extensions.capture.ball.capture import Settings, capture
from metapp.extensions.capture.ball.photo import photo_of, with_light
from metapp.extensions.capture.ball.shots import Shot
from metapp.extensions.capture.ball.view import Ball
from metapp.learning.task import Task

ACROSS = 400  # px of a mirror in a photograph
LEVELS = (0.4, 0.9)  # display value of the 90th percentile of a mirror
NEIGHBOURS = 16  # texels whose mean fills what no photograph shows


class RealBall(NamedTuple):
    """Photographs of one ball in a room.

    Attributes:
        name: of the folder.
        tasks: one a photograph; all have the same `map`.
        certain, clipped: shares of the sphere of directions that photographs show, and that are white in all.
        curve: of the camera, by which they were merged.
    """

    name: str
    tasks: list[Task]
    certain: float
    clipped: float
    curve: str

    @property
    def middle(self) -> Task:
        """The photograph of the middle exposure."""
        return self.tasks[len(self.tasks) // 2]


def glossy_tasks(folder: Path, rows: int) -> list[Task]:
    """Maps with photographs of the spheres that `--observe photo` has elsewhere."""
    return [read_task(path, rows) for path in find([folder])[0]]


def mirror_tasks(folder: Path, rows: int, seed: int = 0) -> list[Task]:
    """Maps, and what 8-bit photographs of mirrors under them show."""
    rng = Generator().manual_seed(seed)
    return [_mirror_task(path, rows, rng) for path in find([folder])[0]]


def _mirror_task(path: Path, rows: int, rng: Generator) -> Task:
    fine = read_map(path, 2 * rows)[None]
    balls = REFLECTANCE * mirror(fine, ACROSS)
    low, high = LEVELS
    level = low + (high - low) * torch.rand(1, generator=rng)
    camera = Camera(exposures(balls, level), torch.ones(1), torch.zeros(1))
    display = (develop(balls, camera).clamp(0, 1) * 255).round()[0] / 255
    shot = Shot(srgb_to_linear(display).numpy(), Ball(ACROSS / 2, ACROSS / 2, ACROSS / 2))
    return _shown(path.stem, shot, resample(fine[0], rows, 2 * rows))


def _shown(name: str, shot: Shot, light: Tensor) -> Task:
    """What a photograph of a mirror shows, and the light [3, H, W] that it shows it of."""
    task = Task(name, {"photos": photo_of(shot)[None], "map": light / mean_luminance(light)})
    return with_light(task, shot, light.shape[1])


def real_ball(folder: Path, rows: int) -> RealBall:
    """Photographs named by 1 over their seconds; the truth is merged from all of them.

    Each is taken as aligned with the others, so that their maps face the same way, and read by sRGB's curve.
    """
    paths = sorted(folder.glob("*.jpg"))
    found = capture(paths, Settings(exposures=tuple(1 / float(path.stem) for path in paths), rows=rows))
    area = solid_angles(rows, 2 * rows) / solid_angles(rows, 2 * rows).sum() / (2 * rows)
    certain, clipped = (float((share * area).sum()) for share in found.certain)
    light = filled(found.seen, found.certain.sum(0) > 0.5)
    shots = zip(paths, found.shots, strict=True)
    tasks = [_shown(f"{folder.name} 1/{int(path.stem)}", shot, light) for path, shot in shots]
    return RealBall(folder.name, tasks, certain, clipped, found.curve)


def filled(light: Tensor, known: Tensor) -> Tensor:
    """A map [3, H, W] whose unknown texels, bool [H, W], are the mean of the nearest known ones."""
    towards = directions(*light.shape[1:]).permute(1, 2, 0)
    _, nearest = cKDTree(towards[known].numpy()).query(towards[~known].numpy(), NEIGHBOURS)
    result = light.clone()
    result[:, ~known] = light[:, known][:, torch.from_numpy(np.asarray(nearest))].mean(-1)
    return result


def of_middle(balls: Sequence[RealBall]) -> list[Task]:
    """The photographs of middle exposures."""
    return [ball.middle for ball in balls]
