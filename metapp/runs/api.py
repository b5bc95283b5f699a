"""The Python API: fit files or data sets, in memory."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from html import escape
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from safetensors.torch import save
from torch import Tensor

from data_tools.readers.brdf_objects import unit_vectors
from metapp.appearance.geometry import directions_to_four_angles
from metapp.learning.task import Params, Task
from metapp.registry import WITHOUT, left_out_with, registry
from metapp.runs.checkpoints.finding import find_checkpoint
from metapp.runs.choosing import recipe_of_tasks
from metapp.runs.fits.fitter import fit_tasks
from metapp.runs.inputs.memory import in_memory
from metapp.runs.inputs.sources import tasks_to_fit
from metapp.runs.naming import factor_of, title_of
from metapp.runs.options import FitOptions, check_export, fit_options
from metapp.runs.outputs.files import export_fit, outputs_of
from metapp.runs.outputs.pictures import beside, image_of
from metapp.runs.outputs.recorded import plan_as, read_run, tasks_as
from metapp.runs.plan import Plan, plan
from metapp.runs.surroundings import threads_of
from metapp.runs.torch_state import threads
from metapp.storage import Document
from metapp.storage.files import write_atomically
from metapp.storage.fits import read_params
from metapp.storage.images import png_address, png_bytes

if TYPE_CHECKING:
    from PIL.Image import Image

# entries of records that are no errors
NO_ERRORS = {"name", "seconds", "threads", "counts", "note", "warning", "guarded"}
NO_ERRORS |= {"source", "content", "origin", "settings", "folder", "batch"}


class Fit:
    """A task that was fitted.

    Attributes:
        app: the application, at its recipe and protocol.
        task: what was fitted.
        parameters: of the network, by name, without a task axis, on the CPU.
        error: as tables print it; None where the task holds no reference.
        errors: all measures, by name.
        seconds: of inference.
        warning: what is doubtful about the fit; "" for nothing.
        steps: of gradient descent.
        guarded: whether the guard acted, as the learned rule failed.
        settings: what it was made by, as records have it.
        plan: that it was made by.

    Extensions add methods, such as `view` of the viewer.
    """

    def __init__(self, plan: Plan, task: Task, settings: Document, record: Document, parameters: Params) -> None:
        self.app, self.task, self.settings, self.plan = plan.app, task, settings, plan
        self.parameters: Params = {key: value.detach().cpu() for key, value in parameters.items()}
        self.error: float | None = record["error"]
        self.seconds: float = record["seconds"]
        self.warning: str = record.get("warning", "")
        self.guarded: bool = record.get("guarded", False)
        self.steps: int = settings["steps"]
        self.errors = {key: value for key, value in record.items() if key not in NO_ERRORS and value is not None}

    def __getattr__(self, name: str) -> Callable[..., object]:
        """A method that an extension adds."""
        if name in registry().methods:
            return functools.partial(registry().methods[name].load(), self)
        if extension := left_out_with("methods", name):
            left_out = f"a method of the extension {extension}, which {WITHOUT} leaves out; unset it."
            raise AttributeError(f"fit.{name}: {left_out}")
        raise AttributeError(f"'Fit' object has no attribute '{name}'")

    def __dir__(self) -> list[str]:
        """Its attributes, with the methods that extensions add."""
        return [*super().__dir__(), *registry().methods]

    @property
    def name(self) -> str:
        """The task's name in tables and files."""
        return self.task.name

    def __repr__(self) -> str:
        error = "no reference" if self.error is None else f"error {self.error:.3f}"
        return f"<Fit of {self.app.name} {self.name}: {error}, {self.seconds:.4f} s>"

    def _repr_html_(self) -> str:
        """The view in notebooks: the picture and one line."""
        error = "no reference" if self.error is None else f"error{factor_of(self.app)} {self.error:.3f}"
        line = f"{self.name}: {title_of(self.app)}, {self.settings['paradigm']}, {error}, {self.seconds:.3g} s"
        line += f", {self.steps} steps" + (f"; warning: {self.warning}" if self.warning else "")
        return f'<img src="{png_address(png_bytes(self.picture()))}"><div>{escape(line)}</div>'

    def __call__(self, wi: object, wo: object) -> Tensor | np.ndarray:
        """Evaluate a fitted BRDF.

        Args:
            wi, wo: unit vectors [N, 3] to light and viewer in the surface's frame, z its normal, arrays or tensors.

        Returns:
            Reflectance in 1/sr without the cosine, linear RGB [N, 3], float32: a tensor where `wi` is one, else an
            array; 0 where a direction is not above the surface.

        Raises:
            ValueError: a fit of another application; no unit vectors, another shape.
        """
        light, viewer = unit_vectors(self.name, wi, "wi"), unit_vectors(self.name, wo, "wo")
        if len(light) != len(viewer):
            raise ValueError(f"{self.name}: {len(light)} wi and {len(viewer)} wo, expected as many of both.")
        with threads(threads_of(self.app)), torch.no_grad():
            values = self.app.reflectance(self.parameters, directions_to_four_angles(light, viewer).float())
        if values is None:
            raise ValueError(
                f"{self.name}: a fit of {self.app.name}, expected one of brdf; take fit.maps or fit.picture()."
            )
        values = values * ((light[:, 2:] > 0) & (viewer[:, 2:] > 0))
        return values if isinstance(wi, Tensor) else values.numpy()

    @functools.cached_property
    def maps(self) -> dict[str, np.ndarray]:
        """The maps of the fit, linear, float32, rows from the top; {} of brdf and transport.

        Of svBRDFs `diffuse` and `specular` [H, W, 3], `roughness` [H, W], `normal` [H, W, 3] (unit vectors: x right, y
        up, z out of the surface), and of stationary ones `height` [H, W] in texels; of textures `basecolor` [H, W, 3];
        of illumination `radiance` [H, 2 H, 3]. They are as fine as the files of `metapp meta`.
        """
        with threads(threads_of(self.app)):
            maps = self.app.linear_maps(self.parameters, self.task)
        return {name: np.ascontiguousarray(values.float().numpy()) for name, values in maps.items()}

    def pictures(self) -> dict[str, Tensor]:
        """Return linear RGB pictures [H, W, 3 or 4] of the fit and its reference, by name."""
        with threads(threads_of(self.app)):
            return self.app.preview(self.parameters, self.task)

    @functools.cached_property
    def rendered(self) -> dict[str, np.ndarray]:
        """The outputs that options ask for, such as `render` of transport: pictures [H, W, 3] by name, linear."""
        made = outputs_of(self.plan.options)
        with threads(threads_of(self.app)):
            files = [output.load()(self.app, self.task, self.parameters, value).files for output, value in made]
        return {name: picture.pixels.numpy() for some in files for name, picture in some.items()}

    @functools.cached_property
    def _images(self) -> dict[str, Image]:
        """`pictures`, as screens show them."""
        return {name: image_of(linear) for name, linear in self.pictures().items()}

    def picture(self) -> Image:
        """Return a picture of PIL, 8 bits of sRGB: the reference left, where there is one, and the fit right."""
        return beside([image for name, image in self._images.items() if name in ("reference", "fit")])

    def save(self, path: str | bytes | PathLike[str]) -> Path:
        """Write the parameters as safetensors, whole or not at all.

        Raises:
            OSError: the file cannot be written.
        """
        content = save({key: value.contiguous() for key, value in self.parameters.items()})
        file = Path(os.fsdecode(path))
        write_atomically(file, lambda partial: partial.write_bytes(content))
        return file

    def export(self, form: str, path: str | bytes | PathLike[str]) -> None:
        """Write the fit in another form, such as "merl" of a BRDF or "gltf" of a material; `path` needs no suffix.

        Raises:
            BadOption: fits of this application cannot be written so, or a library for it is missing.
        """
        check_export(form, self.app.name)
        export_fit(self.app, self.task, self.parameters, Path(os.fsdecode(path)), form, self.settings)


def fit(app: str, source: object, *, paradigm: str = "meta", **options: object) -> Fit:
    """Fit one file, a material, a texture, a map, a scene; or one in memory.

    What is in memory is read as files are, at the same sizes and with the same checks. A picture is one of PIL, or an
    array or tensor [H, W, 3] or gray [H, W], rows from the top: integers of 8 or 16 bits are sRGB, floating-point
    values display values in [0, 1]. Maps of a material are a dictionary of pictures `diffuse`, `normal`, `roughness`,
    `specular`: integers as files hold them, colours sRGB, normals 0..255 for -1..1; floating-point values linear,
    colours and roughness in [0, 1], normals unit vectors, x right, y up, z out of the surface. Functions get float32
    arrays and return arrays or tensors, [N, 3], or gray [N].

    Args:
        app: brdf, texture, svbrdf_stationary, svbrdf_nonstationary, illumination or transport.
        source: what `metapp meta APP INPUT` takes, holding one task; or, in memory,
            of brdf f(wi, wo) -> reflectance, arrays (wi, wo, reflectance) or a BSDF of Mitsuba, as of
            `data_tools.readers.brdf_objects.from_object`;
            of texture a picture;
            of svbrdf_stationary a picture, the flash photo; or maps, of which a flash photo is rendered;
            of svbrdf_nonstationary maps; with observe="photo" also a picture, the flash photo;
            of illumination linear radiance [H, 2 H, 3], floating point, the middle looks to +z; with observe="photo"
            also a picture, the photo of a ball;
            of transport a scene as Mitsuba's `load_dict` takes it, or the text of an XML scene; files that it names
            are looked for in the current folder and in those of scene_root.
        paradigm: general, overfit, finetune, quickft or meta.
        options: as `fit_all` takes them.

    Raises:
        ValueError: a bad file or array, or a file with several tasks; an option that the application does not have.
    """
    fits = fit_all(app, [source], paradigm=paradigm, **options)
    if len(fits) != 1:
        raise ValueError(f"{source}: {len(fits)} tasks, expected one; take metapp.fit_all for several.")
    return fits[0]


def fit_all(
    app: str,
    sources: Sequence[Any] | None = None,
    *,
    paradigm: str = "meta",
    **options: object,
) -> list[Fit]:
    """Fit files and folders, things in memory, or the test tasks of a data set.

    Args:
        app: the application.
        sources: files and folders, or things in memory, as of `fit`; None: the test tasks of `data`, else of the
            embedded set.
        paradigm: general, overfit, finetune, quickft or meta.
        options: observe, rule, recipe, steps, data, checkpoint, seed, device, and those of the application,
            with the names of the command line.

    Returns:
        The fits.

    Raises:
        ValueError: a bad file or array, no checkpoint; an option that the application does not have.
        FloatingPointError: a fit is not finite.
    """
    if isinstance(sources, str | PathLike | Mapping | np.ndarray | Tensor) or not isinstance(sources or (), Iterable):
        raise ValueError(f"{type(sources).__name__}: one source, expected a list of them; take metapp.fit for one.")
    if sources is not None and not (sources := list(sources)):
        raise ValueError("0 sources, expected a list of one or more; leave it out to fit a data set's test tasks.")
    try:
        given = sources or []
        if not in_memory(given):
            given = [Path(source) for source in given]
        return _fitted(fit_options(app, paradigm, given, quiet=True, **options))
    except ValueError as error:
        if not os.environ.get("METAPP_TRACEBACK"):
            error.__traceback__ = None  # the message says what was given; frames of metapp would hide it
        raise


def load(folder: str | PathLike[str]) -> Fit:
    """Read a fit back from its folder, such as runs/brdf/meta/gold of `metapp meta brdf gold.binary`.

    Its task has data where the input is where it was, and as it was.

    Raises:
        ValueError: no fit, or several; damaged files.
    """
    run = read_run(Path(folder))
    if len(run.records) != 1:
        raise ValueError(f"{folder}: {len(run.records)} fits, expected the folder of one task; take one inside it.")
    (record,) = run.records
    planned, name = plan_as(record["settings"]), record["name"]
    task = tasks_as(run.records, planned.app, [], None).get(name, Task(name, {}))
    return Fit(planned, task, record["settings"], record, read_params(record["folder"]))


def _fitted(options: FitOptions) -> list[Fit]:
    """Fits of the inputs that options name."""
    planned = plan(options)
    with threads(threads_of(planned.app)):
        tasks, label = tasks_to_fit(planned)
        if options.objects and not options.recipe:
            planned = plan(replace(options, recipe=recipe_of_tasks(options, tasks)))
        planned = find_checkpoint(planned)
        settings = planned.settings(label)
        results = fit_tasks(planned, tasks, warns=True)
        return [Fit(planned, task, settings, *result) for task, result in zip(tasks, results, strict=True)]
