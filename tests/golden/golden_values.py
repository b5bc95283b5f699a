"""Functions that compute golden values: errors and parameters of fits, rows of a table, tensors of tasks from files.

`python -m tests.golden` writes the values again, after a change that is meant to change them.
"""

import contextlib
import io
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import torch
from torch import Tensor

from data_tools.readers.nbrdf_files import NBRDF_ARRAY_SHAPES
from metapp.cli.command_process import run_command
from metapp.cli.command_tree import app as commands
from metapp.runs.api import fit_all

PARADIGMS = ("general", "overfit", "finetune", "quickft", "meta")
APPS = ("brdf", "texture", "svbrdf_stationary", "svbrdf_nonstationary", "illumination", "transport")
SIZE_OPTIONS = {
    "texture": ("--size", "128"),
    "svbrdf_stationary": ("--size", "128"),
    "svbrdf_nonstationary": ("--size", "64"),
    "illumination": ("--rows", "32"),
}
ADAM_STEPS = {"overfit": 4, "finetune": 4}  # the other paradigms take the steps of their checkpoints
Values = dict[str, list[float]]


def run_metapp(*words: object) -> None:
    """Run a `metapp` command, which must succeed."""
    code = run_command(lambda: commands([str(word) for word in words], standalone_mode=False))
    assert int(code) == 0, words


def summarize(tensor: Tensor) -> list[float]:
    """Return the mean, the root mean square, and the mean product with a cosine of a tensor, in double precision."""
    values = tensor.detach().double().flatten()
    if not len(values):
        return [0.0, 0.0, 0.0]
    waves = torch.cos(torch.arange(len(values), dtype=torch.float64) * 0.7)
    return [float(values.mean()), float(values.square().mean().sqrt()), float((values * waves).mean())]


def measure_fits(app: str, folder: Path) -> Values:
    """Fit an application's test tasks by all paradigms; return errors and summaries of parameters of the first two."""
    data = folder / app
    run_metapp("data", "synth", app, "--count", 10, *SIZE_OPTIONS.get(app, ()), "--out", data, "--quiet")
    values: Values = {}
    protocols = ("reference", "photo") if app in ("svbrdf_nonstationary", "illumination") else ("",)
    for observe in protocols:
        for paradigm in PARADIGMS:
            options = {"observe": observe} if observe else {}
            found_fits = fit_all(
                app, paradigm=paradigm, recipe="quick", data=data, steps=ADAM_STEPS.get(paradigm), **options
            )
            for fit in found_fits[:2]:
                key = " ".join(filter(None, (app, observe, paradigm, fit.name)))
                values[f"{key} error"] = [fit.error if fit.error is not None else -1.0]
                whole = torch.cat([fit.parameters[name].flatten() for name in sorted(fit.parameters)])
                values[f"{key} theta"] = summarize(whole)
    return values


def measure_table(folder: Path) -> Values:
    """Return errors and task counts in the rows of a table that `metapp evaluate --json` prints."""
    data = folder / "table"
    run_metapp("data", "synth", "brdf", "--count", 10, "--out", data, "--quiet")
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        words = ("--data", data, "--out", folder / "runs", "--quiet", "--json")
        run_metapp("evaluate", "brdf", "--which", "quickft", *words)
    rows = json.loads(out.getvalue().splitlines()[-1])["rows"]
    return {f"table {row['paradigm']}": [row["error"], float(row["tasks"])] for row in rows}


def write_input_files(folder: Path) -> Iterator[tuple[str, Path, dict[str, object]]]:
    """Write a file of every kind that fits take; yield the application, the path and the options of its fit."""
    run_metapp("examples", "--make", folder)
    names = {"brdf": "paint.csv", "texture": "bricks.png", "svbrdf_stationary": "leather.png"}
    yield from ((app, folder / name, {}) for app, name in names.items())
    yield "svbrdf_nonstationary", folder / "mosaic.png", {"observe": "photo"}
    yield "illumination", folder / "ball.png", {"observe": "photo"}
    yield "illumination", folder / "lobby.exr", {}
    yield "transport", folder / "box.xml", {}
    for suffix, kind in ((".hdr", oiio.FLOAT), (".tif", oiio.HALF)):
        picture = oiio.ImageBuf(str(folder / "lobby.exr"))
        picture.write(str(folder / f"lobby{suffix}"), kind)
        yield "illumination", folder / f"lobby{suffix}", {}
    oiio.ImageBuf(str(folder / "bricks.png")).write(str(folder / "sixteen.tif"), oiio.UINT16)
    yield "texture", folder / "sixteen.tif", {}
    run_metapp("data", "synth", "brdf", "--count", 2, "--as", "merl", "--out", folder / "merl", "--quiet")
    table = sorted((folder / "merl").rglob("*.binary"))[0]
    yield "brdf", table, {}
    (folder / "network").mkdir()
    for index, (part, shape) in enumerate(NBRDF_ARRAY_SHAPES.items()):
        weights = 0.3 * np.cos(np.arange(np.prod(shape)) * (index + 1.0)).reshape(shape)
        np.save(folder / "network" / f"{part}.npy", weights.astype(np.float32))
    yield "brdf", folder / "network", {}
    run_metapp("meta", "brdf", folder / "network", "--export", "bsdf", "--out", folder / "bsdf", "--quiet")
    (table,) = (folder / "bsdf").rglob("*.bsdf")
    yield "brdf", table, {}
    run_metapp(
        "meta", "svbrdf_stationary", folder / "leather.png", "--recipe", "quick", "--out", folder / "maps", "--quiet"
    )
    (maps,) = (folder / "maps").rglob("meta*/leather")
    yield "svbrdf_nonstationary", maps / "diffuse.png", {}
    placed = folder / "placed"
    placed.mkdir()
    for index in range(3):
        shutil.copy(folder / "mosaic.png", placed / f"{index}.png")
    places = "".join(f"{i},0,16\n" for i in range(3))
    (placed / "camera_pos.txt").write_text(places)
    (placed / "light_pos.txt").write_text(places)
    (placed / "light_power.txt").write_text("1500,1500,1500\n")
    (placed / "image_size.txt").write_text("8\n")
    yield "svbrdf_nonstationary", placed, {"observe": "photo"}


def measure_tasks_of_files(folder: Path) -> Values:
    """Return shapes and summaries of the tensors that tasks have after they are read from files."""
    values: Values = {}
    for app, path, options in write_input_files(folder):
        (fit,) = fit_all(app, [path], paradigm="overfit", steps=1, recipe="quick", **options)
        for name, tensor in sorted(fit.task.data.items()):
            values[f"file {app} {path.name} {name} shape"] = [*map(float, tensor.shape)]
            values[f"file {app} {path.name} {name}"] = summarize(tensor)
    return values


def measure_default_fits(folder: Path) -> Values:
    """Fit the example inputs by Meta and the default recipe; return summaries of parameters, and errors."""
    run_metapp("examples", "--make", folder)
    names = {"brdf": "paint.csv", "texture": "bricks.png", "svbrdf_stationary": "leather.png"}
    names |= {"svbrdf_nonstationary": "mosaic.png", "illumination": "lobby.exr", "transport": "box.xml"}
    values: Values = {}
    for app, name in names.items():
        (fit,) = fit_all(app, [folder / name], **({"observe": "photo"} if name == "mosaic.png" else {}))
        whole = torch.cat([fit.parameters[name].flatten() for name in sorted(fit.parameters)])
        values[f"best {app} theta"] = [*summarize(whole), -1.0 if fit.error is None else fit.error]
    return values


PARTS: dict[str, Callable[[Path], Values]] = {
    **{app: lambda folder, app=app: measure_fits(app, folder) for app in APPS},
    "table": measure_table,
    "read": measure_tasks_of_files,
    "best": measure_default_fits,
}
