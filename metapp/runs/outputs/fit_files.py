"""Files of one fit or of a run, for its user: pictures and maps, renders of its scene, other formats."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from torch import Generator

from metapp.appearance.colour import stretch_to_unit_range, tone_map
from metapp.appearance.pictures import Picture, ScenePictures
from metapp.apps import presenter_of
from metapp.learning.app import App, stack_tasks
from metapp.learning.task import Params, Task
from metapp.names import exports_of
from metapp.options import OUTPUT
from metapp.registry import registry
from metapp.runs.checkpoint_selection import attach_checkpoint
from metapp.runs.fit_options import fit_options
from metapp.runs.inputs.run_inputs import task_digest
from metapp.runs.reporter import format_number, say
from metapp.runs.run import Run
from metapp.storage import Document
from metapp.storage.checkpoint_files import tensor_digest
from metapp.storage.image_writers import write_exr, write_png
from metapp.storage.shipped_checkpoints import QUICK_RECIPE_NAME

SCENE_SUFFIXES = (".usda", ".mtlx", ".xml", ".html")  # suffixes of the one file of a folder that names the others
WRITER_THREADS = 2  # pictures compressed at a time


def render_outputs(run: Run, task: Task, theta: Params) -> ScenePictures:
    """The pictures of a fit, parameters without a task axis, by the registered outputs whose options were given."""
    given, made = run.options.own.non_default_values(OUTPUT), ScenePictures({}, [])
    for name, output in registry().outputs.of(run.app.name).items():
        if name in given:
            files, lines = output.load()(run.app, task, theta, given[name])
            made = ScenePictures(made.files | files, [*made.lines, *lines])
    return made


def write_pictures(files: dict[str, Picture], folder: Path) -> None:
    """Write pictures as <folder>/<name>.png, 8 bits, compressed side by side.

    Colours are sRGB; data such as roughness, normals and heights are linear: the PNG's text `encoding` says which.
    Heights h, in texels, are kept as (h - minimum) / (maximum - minimum), of which the texts `height_minimum` and
    `height_maximum` tell. Radiance is kept as <name>.exr, and tone-mapped beside it.
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
        pixels = tone_map(pixels / pixels.mean().clamp_min(1e-20))  # whatever its unit
    write_png(pixels, texts, file)


def export_path(record: Document, form: str, out: Path | None = None) -> Path:
    """The path of a fit in a form, without suffix: in its own folder, else in another."""
    name = Path(record["folder"]).name
    return out / name if out else Path(record["folder"], form, name)


def file_to_open(path: Path) -> Path:
    """The file, or the folder of several, that a user opens of a fit in a form.

    Args:
        path: without suffix, as of `export_path`; its folder holds nothing else.
    """
    if path.is_dir():
        return next((file for suffix in SCENE_SUFFIXES if (file := path / f"{path.name}{suffix}").is_file()), path)
    files = [file for file in sorted(path.parent.iterdir()) if file.name.startswith(path.name)]
    alone = [file for file in files if file.stem == path.name] or files
    return alone[0] if len(alone) == 1 else path.parent


def export_fit(run: Run, task: Task, theta: Params, path: Path, name: str, settings: Document) -> None:
    """Write one fit in a form; if that holds another network, the fit is distilled into it first.

    Args:
        run: the run of the fit, with the size of surfaces.
        task: of the fit.
        theta: parameters, without a task axis.
        path: of the file, without suffix; its last part names an asset.
        name: of the form.
        settings: of the fit, as records have them: an asset's provenance.
    """
    app = run.app
    form = exports_of(app.name)[name]
    write = form.load()
    if form.of_surface:
        surface = run.presenter.surface(theta, task)
        assert surface is not None, f"{app.name} has no surface"
        write(surface, path, {"task": task.name, **settings})
        return
    if form.holds and set(theta) != set(form.holds):
        key = f"{app.name} {task_digest(task)} {tensor_digest(theta)}"
        if key not in _distilled:
            _distilled.clear()
            _distilled[key] = distill_fit(app, task, theta)
        theta = _distilled[key]
    write(app, theta, path)


_distilled: dict[str, Params] = {}  # of the last fit, for all forms that it is written in


def distill_fit(app: App, task: Task, theta: Params) -> Params:
    """The application's usual network, fitted by Finetune to values of another one.

    It sees as many values of the fit as the task has samples, and none of the task's own; the loss is printed.

    Args:
        app: with the network that the fit is of.
        task: of the fit.
        theta: parameters of one task, without a task axis.
    """
    by = attach_checkpoint(Run.of(fit_options(app.name, "finetune", recipe=QUICK_RECIPE_NAME, quiet=True)))
    evaluated = presenter_of(app).sample_fit(theta, task)
    assert evaluated is not None, f"{app.name} has one network"
    fitted = by.paradigm.fit(by.phi, stack_tasks(by.app, [evaluated]), Generator().manual_seed(by.options.seed))
    before, after = (
        format_number(app.error_measure.scale * float(of.errors(params, stack_tasks(of, [task]))["error"][0]), ".3f")
        for of, params in ((app, {key: value[None] for key, value in theta.items()}), (by.app, fitted))
    )
    say(f"{task.name}: distilled into the network of the format; error {after}, of the fit {before}")
    return {key: value[0] for key, value in fitted.items()}
