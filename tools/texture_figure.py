"""Draw textures of the embedded test set: texture_figure.py PICTURE TASK...

A column a task, by the recipe `full`, 160 px each: the exemplar, image quilting, General, QuickFT, Meta. TASK is the
beginning of a name, such as bricks.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from photos_figure import write
from torch import Generator, Tensor
from torch.nn.functional import interpolate

from metapp.appearance.order import lattice_of, order_kept
from metapp.apps import presentation_of
from metapp.apps.texture import Texture
from metapp.baselines.texture import quilt
from metapp.learning.app import stack
from metapp.learning.task import Task
from metapp.networks.presentation import ExemplarPresentation
from metapp.runs.checkpoints import find_checkpoint
from metapp.runs.inputs import tasks_of_data
from metapp.runs.plan import plan
from metapp.runs.request import Request

GAP, SIDE = 4, 160  # px


def fitted(paradigm: str, task: Task) -> Tensor:
    """A texture of the exemplar's size [3, H, W], sRGB in [0, 1]."""
    by = find_checkpoint(plan(Request("texture", paradigm, recipe="full", quiet=True)))
    theta = by.paradigm.fit(by.job, by.prepared, stack(by.app, [task]), Generator().manual_seed(0))
    shown = presentation_of(by.app)
    assert isinstance(shown, ExemplarPresentation)
    assert isinstance(by.app, Texture)
    texture: Tensor = shown.generated({key: value[0] for key, value in theta.items()}, by.app.generate, shown.once())
    return texture[0, 0]


def column(task: Task) -> Tensor:
    """Exemplar, quilting, General, QuickFT, Meta, one below the other, [3, H, W]."""
    exemplar = task.data["image"].float() / 255
    copy = torch.from_numpy(quilt(exemplar.permute(1, 2, 0).numpy(), np.random.default_rng(0))).permute(2, 0, 1)
    made = {"quilting": copy, **{name: fitted(name, task) for name in ("general", "quickft", "meta")}}
    lattice = lattice_of(exemplar)
    kept = ", ".join(f"{name} {order_kept(lattice, picture):.2f}" for name, picture in made.items())
    print(f"{task.name}: order {kept}", flush=True)
    gap = torch.ones(3, GAP, SIDE)
    small = [interpolate(picture[None], size=SIDE, mode="area")[0] for picture in (exemplar, *made.values())]
    parts = [part for picture in small for part in (picture, gap)]
    return torch.cat(parts[:-1], 1)


def main(picture: Path, names: list[str]) -> None:
    """Draw the columns of the tasks that were named."""
    tasks, _ = tasks_of_data(find_checkpoint(plan(Request("texture", "general", quiet=True))).app, None, True)
    columns = [column(next(task for task in tasks if task.name.startswith(name))) for name in names]
    gap = torch.ones(3, columns[0].shape[1], GAP)
    whole = torch.cat([part for each in columns for part in (each, gap)][:-1], 2)
    write(picture, whole)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
