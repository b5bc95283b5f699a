"""Compare fits of flash photos with maps that another network predicts: published.py OUTPUTS TASKS PREDICTED.

OUTPUTS is the folder `outputs` of a run by `--observe photo`, TASKS the data set that it fitted, which has the true
maps, PREDICTED a folder of <number>_{N,D,R,S}.png (Nie et al. 2024): normals as 2 v - 1, diffuse colour, roughness and
specular colour, colours at gamma 2.2, of the central part of the strips of these numbers. Both are judged there.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from data_tools.readers.image_files import read_pixels
from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.flash import Maps, unpack
from metapp.apps import app_of, recipes_of
from metapp.apps.svbrdf_nonstationary import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import of_length_1
from metapp.learning.app import stack
from metapp.learning.task import Task
from metapp.runs.statistics import paired
from metapp.storage.shards import read_shard

GAMMA = 2.2
OURS = {"normal": "normal", "diffuse": "diffuse", "roughness": "roughness", "specular": "specular"}
PUBLISHED = {"normal": "N", "diffuse": "D", "roughness": "R", "specular": "S"}


def picture(path: Path) -> Tensor:
    """Values in [0, 1], [3, H, W]; grey ones three times."""
    values = torch.from_numpy(read_pixels(path).values)
    return (values.float() / (255 if values.dtype == torch.uint8 else 65535)).movedim(-1, 0)[:3]


def maps_in(prefix: str, names: dict[str, str], linear: Callable[[Tensor], Tensor]) -> Maps:
    """Maps [1, C, H, W] of the files <prefix><name>.png."""
    part = {key: picture(Path(f"{prefix}{name}.png"))[None] for key, name in names.items()}
    normal = of_length_1(2 * part["normal"] - 1)
    return Maps(linear(part["diffuse"]), linear(part["specular"]), part["roughness"][:, :1], normal)


def central(maps: Maps, side: int) -> Maps:
    """The middle of maps, side x side texels."""
    first = (maps.diffuse.shape[-1] - side) // 2
    return Maps(*(part[..., first : first + side, first : first + side] for part in maps))


def judged(app: SvbrdfNonstationary, maps: Maps, task: Task) -> dict[str, float]:
    """Errors of the table, and root mean squares of roughness and, at gamma 2.2, of colours."""
    errors = {key: float(value) for key, value in app.errors_of(maps, stack(app, [task])).items()}
    truth = unpack(task.data["maps"].float()[None])
    off = {
        "roughness RMSE": maps.roughness - truth.roughness,
        "diffuse RMSE": maps.diffuse ** (1 / GAMMA) - truth.diffuse ** (1 / GAMMA),
        "specular RMSE": maps.specular ** (1 / GAMMA) - truth.specular ** (1 / GAMMA),
    }
    shown = {key: errors[key] for key in ("error", "normal")}
    return shown | {key: float(value.square().mean().sqrt()) for key, value in off.items()}


def main(outputs: Path, tasks: Path, predicted: Path) -> None:
    """Print means over the tasks that both have, and the ratio of errors by paired bootstrap."""
    found: dict[str, dict[str, dict[str, float]]] = {"metapp": {}, "published": {}}
    recipe = recipes_of("svbrdf_nonstationary", "photo")["full"]
    app = app_of("svbrdf_nonstationary", recipe, "photo")
    assert isinstance(app, SvbrdfNonstationary)
    for task in read_shard(tasks):
        prefix = f"{predicted}/{task.name.split('_')[0]}_"
        if not Path(f"{prefix}N.png").exists() or not (outputs / task.name).is_dir():
            continue
        theirs = maps_in(prefix, PUBLISHED, lambda colour: colour**GAMMA)
        side = theirs.diffuse.shape[-1]
        first = (task.data["maps"].shape[-1] - side) // 2
        middle = {key: value[:, first : first + side, first : first + side] for key, value in task.data.items()}
        ours = central(maps_in(f"{outputs / task.name}/", OURS, srgb_to_linear), side)
        for name, maps in (("metapp", ours), ("published", theirs)):
            found[name][task.name] = judged(app, maps, Task(task.name, middle))
    for name, rows in found.items():
        means = {key: sum(row[key] for row in rows.values()) / len(rows) for key in next(iter(rows.values()))}
        print(name, len(rows), *(f"{key} {mean:.3f}" for key, mean in means.items()))
    groups = {name: name for name in found["metapp"]}
    for key in ("error", "normal"):
        each = [[{task: row[key] for task, row in found[name].items()}] for name in found]
        print(f"metapp over published, {key}:", paired(each[0], each[1], groups, logarithmic=False))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
