"""Draw what fits by the recipe `full` make: full_figure.py PICTURE APP TASK|FILE...

A column a task, 160 px each; TASK is the beginning of a name of the embedded test set, such as bricks. Of textures the
exemplar, image quilting, General, QuickFT, Meta; of stationary svBRDFs the photo, quilting, General, QuickFT and Meta
under its flash, then Meta's diffuse colour, roughness and normals, and lit from the left.
"""

import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import torch
from torch import Generator, Tensor
from torch.nn.functional import interpolate

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.flash import Maps
from metapp.appearance.order import lattice_of, order_kept
from metapp.apps import presentation_of
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary
from metapp.apps.texture.app import Texture
from metapp.extensions.baselines.svbrdf_stationary import quilted_maps
from metapp.extensions.baselines.texture import quilt
from metapp.learning.app import stack
from metapp.learning.task import Task
from metapp.networks.presentation import ExemplarPresentation
from metapp.runs.checkpoints.finding import find_checkpoint
from metapp.runs.inputs.sources import tasks_of_data, tasks_to_fit
from metapp.runs.requests.plan import plan
from metapp.runs.requests.request import Request

GAP, SIDE = 4, 160  # px
PARADIGMS = ("general", "quickft", "meta")


def fitted(app: str, paradigm: str, task: Task) -> dict[str, Tensor]:
    """What a fit makes, of the exemplar's size, by name: pictures [3, H, W], sRGB in [0, 1]."""
    by = find_checkpoint(plan(Request(app, paradigm, recipe="full", quiet=True)))
    theta = by.paradigm.fit(by.job, by.prepared, stack(by.app, [task]), Generator().manual_seed(0))
    own, shown = {key: value[0] for key, value in theta.items()}, presentation_of(by.app)
    assert isinstance(shown, ExemplarPresentation)
    if isinstance(by.app, Texture):
        return {"texture": shown.generated(own, by.app.generate, shown.once())[0, 0]}
    assert isinstance(by.app, SvbrdfStationary)
    return {name: linear_to_srgb(picture).permute(2, 0, 1) for name, picture in shown.outputs(own, task).items()}


def texture(task: Task) -> list[Tensor]:
    """Exemplar, quilting, General, QuickFT, Meta."""
    exemplar = task.data["image"].float() / 255
    copy = torch.from_numpy(quilt(exemplar.permute(1, 2, 0).numpy(), np.random.default_rng(0))).permute(2, 0, 1)
    made = {"quilting": copy, **{name: fitted("texture", name, task)["texture"] for name in PARADIGMS}}
    lattice = lattice_of(exemplar)
    kept = ", ".join(f"{name} {order_kept(lattice, picture):.2f}" for name, picture in made.items())
    print(f"{task.name}: order {kept}", flush=True)
    return [exemplar, *made.values()]


def quilted(task: Task) -> Tensor:
    """Quilted maps under the photo's flash, [3, H, W]."""
    app = plan(Request("svbrdf_stationary", "general", recipe="full", quiet=True)).app
    assert isinstance(app, SvbrdfStationary)
    photo = app.exemplar(task.data["image"][None].float() / 255)
    light = app.light_of(photo)
    maps = quilted_maps(photo, light, np.random.default_rng(0), 1)
    return app.photograph(Maps(*(part[0, 0] for part in maps)), light[0], light[0])


def material(task: Task) -> list[Tensor]:
    """The photo; quilting, General, QuickFT and Meta under its flash; Meta's maps, lit from the left."""
    made = {name: fitted("svbrdf_stationary", name, task) for name in PARADIGMS}
    print(task.name, flush=True)
    meta = made["meta"]
    under_flash = [meta["reference"], quilted(task), *(each["fit"] for each in made.values())]
    return [*under_flash, meta["diffuse"], meta["roughness"], meta["normal"], meta["lit_from_left"]]


def named(app: str, name: str) -> Task:
    """A file's task, or the embedded test task whose name begins so."""
    path = Path(name)
    planned = plan(Request(app, "general", [path] if path.exists() else [], recipe="full", quiet=True))
    if path.exists():
        return tasks_to_fit(planned)[0][0]
    return next(task for task in tasks_of_data(planned.app, None, True)[0] if task.name.startswith(name))


def write(picture: Path, whole: Tensor) -> None:
    """Write a picture [3, H, W], PNG or JPEG by its name."""
    pixels = (whole.permute(1, 2, 0) * 255).round().clamp(0, 255).byte().contiguous().numpy()
    image = oiio.ImageBuf(pixels)
    image.specmod().attribute("Compression", "jpeg:85")
    if not image.write(str(picture)):
        raise SystemExit(f"{picture}: not written ({image.geterror()}).")


def main(picture: Path, app: str, names: list[str]) -> None:
    """Draw the columns of the tasks that were named."""
    draw, columns = texture if app == "texture" else material, []
    for name in names:
        parts = [interpolate(each[None].float(), size=SIDE, mode="area")[0] for each in draw(named(app, name))]
        gap = torch.ones(3, GAP, SIDE)
        columns.append(torch.cat([part for each in parts for part in (each, gap)][:-1], 1))
    gap = torch.ones(3, columns[0].shape[1], GAP)
    write(picture, torch.cat([part for each in columns for part in (each, gap)][:-1], 2))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], sys.argv[3:])
