"""The files of one fit for its user: pictures and maps, renderings of its scene, and exports in other file formats.

What pictures show is decided by the asset of the fit, how a format lies on disk by the extension that has it.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from torch import Generator

from metapp.appearance.colour import stretch_to_unit_range, tone_map
from metapp.appearance.pictures import Picture, ScenePictures
from metapp.learning.app import App, stack_tasks
from metapp.learning.task import Params, Task
from metapp.options import OUTPUT
from metapp.paradigms.methods import fit_tasks, make_method
from metapp.runs.checkpoints import read_checkpoint
from metapp.runs.reporter import format_number, say
from metapp.runs.resolve import complete, recipe_of
from metapp.runs.spec import Spec
from metapp.storage.files import move_files, name_file_in_errors, partial_path
from metapp.storage.image_writers import write_exr, write_png
from metapp.storage.shipped_checkpoints import QUICK_RECIPE_NAME

SCENE_SUFFIXES = (".usda", ".mtlx", ".xml", ".html")  # suffixes of a file in a folder that names all others in it
WRITER_THREADS = 2  # number of pictures that are compressed at a time


def render_outputs(spec: Spec, app: App, task: Task, theta: Params) -> ScenePictures:
    """Render the outputs that options ask for, such as --render of transport.

    Args:
        spec: the specification of the fit.
        app: the network of the fit.
        task: the task that was fitted.
        theta: the parameters of the fit, without a task axis.

    Returns:
        The pictures by name, and lines about them for the user.
    """
    output_options, outputs = spec.app_options.non_default_values(OUTPUT), ScenePictures({}, [])
    for name, entry in spec.application.outputs.items():
        if name in output_options:
            pictures, lines = entry.load()(app, task, theta, output_options[name])
            outputs = ScenePictures(outputs.files | pictures, [*outputs.lines, *lines])
    return outputs


def write_pictures(files: dict[str, Picture], folder: Path) -> None:
    """Write pictures as <folder>/<name>.png with 8 bits, several compressed at a time.

    Colours are sRGB; data such as roughness, normals and heights are linear. The PNG's text `encoding` says which of
    both. Heights h in texels are written as (h - minimum) / (maximum - minimum); the texts `height_minimum` and
    `height_maximum` have these two. Radiance is written as <name>.exr, with a tone-mapped PNG beside it.

    Args:
        files: the pictures by name.
        folder: the folder to write to.
    """
    with ThreadPoolExecutor(WRITER_THREADS) as pool:
        list(pool.map(_write_picture, [folder / f"{name}.png" for name in files], files.values()))


def _write_picture(file: Path, picture: Picture) -> None:
    pixels, kind = picture
    texts = {"encoding": "linear" if kind in ("data", "height") else "sRGB"}
    if kind == "height":
        pixels, low, high = stretch_to_unit_range(pixels)
        texts |= {"height_minimum": f"{low:.9g}", "height_maximum": f"{high:.9g}", "height_unit": "texels"}
    if kind == "radiance":
        write_exr(pixels, file.with_suffix(".exr"))
        pixels = tone_map(pixels / pixels.mean().clamp_min(1e-20))  # of mean 1, since its unit is not known
    write_png(pixels, texts, file)


def export_path(folder: Path, form: str, out: Path | None = None) -> Path:
    """Return the path of an export of a fit, without suffix.

    Args:
        folder: the folder of the fit.
        form: the name of the file format.
        out: the folder to write to; None for a folder of the format's name in the folder of the fit.
    """
    return (out or folder / form) / folder.name


def file_to_open(path: Path) -> Path:
    """Return the file that a user opens of an export, or the folder if it has several files of equal rank.

    Args:
        path: the path that the export was written to, without suffix, see :func:`export_path`.
    """
    if path.is_dir():
        return next((file for suffix in SCENE_SUFFIXES if (file := path / f"{path.name}{suffix}").is_file()), path)
    files = [file for file in sorted(path.parent.iterdir()) if file.name.startswith(path.name)]
    candidates = [file for file in files if file.stem == path.name] or files
    return candidates[0] if len(candidates) == 1 else path.parent


def export_to_new_files(write: Callable[[Path], object], path: Path, *, overwrite: bool) -> Path:
    """Write an export of one fit without replacing files, unless that is asked for.

    Which files a format writes is known once they are written. So they are written into a folder beside their place,
    and then moved.

    Args:
        write: a function that writes the export to the path that it is given, without suffix.
        path: the path of the export, without suffix.
        overwrite: whether existing files are replaced.

    Returns:
        The file, or the folder of several files.

    Raises:
        FileExistsError: a file of the export is there already.
        ValueError: the format cannot hold this fit.
        OSError: the files cannot be written.
    """
    partial = partial_path(path)
    try:
        with name_file_in_errors(path):
            partial.mkdir(parents=True)
            write(partial / path.name)
            written = sorted(partial.iterdir())
            move_files(partial, path.parent, overwrite=overwrite)
    except ValueError as error:
        raise ValueError(str(error).replace(str(partial), str(path.parent))) from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return path.with_name(written[0].name) if len(written) == 1 else path.parent


def distill(app_name: str, asset: Any, task: Task, error: float | None) -> Any:
    """Distill an asset into the application's usual network, and say by how much the error grows.

    Finetune fits the usual network to values of the asset, as many as the task has samples. It sees no sample of the
    task itself.

    Args:
        app_name: the name of the application.
        asset: the asset, which a method `sample` turns into a task.
        task: the task that was fitted.
        error: the error of the asset in the unit of tables; None if it is not known.

    Returns:
        The asset of the usual network.

    Raises:
        KeyError: the task has no data.
        ValueError: the usual network cannot be like this asset.
    """
    spec = complete(Spec(app=app_name, paradigm="finetune", recipe=QUICK_RECIPE_NAME))
    recipe, make_asset = recipe_of(spec), next(iter(spec.application.assets.values())).load()
    app, sampled_task = recipe.app, asset.sample(task)
    method = make_method(spec.paradigm, app, recipe, read_checkpoint(spec, app, recipe), steps=spec.steps)
    theta = fit_tasks(method, stack_tasks(app, [sampled_task]), Generator().manual_seed(spec.seed))
    error_after = app.error_measure.scale * float(app.errors(theta, stack_tasks(app, [task]))["error"][0])
    errors = f"error {format_number(error_after, '.3f')}, of the fit {format_number(error, '.3f')}"
    say(f"{task.name}: distilled into the network of the format; {errors}")
    return make_asset(app, {key: value[0] for key, value in theta.items()}, task, None)
