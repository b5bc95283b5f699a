"""The Python API: fit files or data sets, in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

from safetensors.torch import save

from metapp.apps import presentation_of
from metapp.learning.app import App
from metapp.learning.task import Params, Task
from metapp.runs.checkpoints import find_checkpoint
from metapp.runs.checks import check_export, recipe_of_tasks
from metapp.runs.fits import fit_tasks
from metapp.runs.inputs import tasks_of_objects, tasks_to_fit
from metapp.runs.outputs import export_fit
from metapp.runs.plan import plan
from metapp.runs.request import Request
from metapp.runs.surroundings import threads, threads_of
from metapp.storage.files import write_atomically


class Fit:
    """A task that was fitted.

    Attributes:
        app: the application, at its recipe and protocol.
        task: what was fitted.
        parameters: of the network, by name, without a task axis.
        error: as tables print it; None where the task holds no reference.
        errors: all measures, by name.
        seconds: of inference.
        warning: what is doubtful about the fit; "" for nothing.
        steps: of gradient descent.
        guarded: whether the guard acted, as the learned rule failed.
        settings: what it was made by, as records have it.
    """

    def __init__(
        self, app: App, task: Task, settings: dict[str, Any], record: dict[str, Any], parameters: Params
    ) -> None:
        self.app, self.task, self.settings, self.parameters = app, task, settings, parameters
        self.error: float | None = record["error"]
        self.seconds: float = record["seconds"]
        self.warning: str = record.get("warning", "")
        self.guarded: bool = record.get("guarded", False)
        self.steps: int = record.get("steps", settings["steps"])
        fields = ("name", "seconds", "threads", "counts", "note", "warning", "guarded", "steps")
        self.errors = {key: value for key, value in record.items() if key not in fields and value is not None}

    @property
    def name(self) -> str:
        """What tables and files call the task."""
        return self.task.name

    def __repr__(self) -> str:
        error = "no reference" if self.error is None else f"error {self.error:.3f}"
        return f"<Fit of {self.app.name} {self.name}: {error}, {self.seconds:.4f} s>"

    def pictures(self) -> dict[str, Any]:
        """Return linear RGB pictures [H, W, 3 or 4] of the fit and its reference, by name."""
        return presentation_of(self.app).outputs(self.parameters, self.task)

    def save(self, path: str | PathLike[str]) -> Path:
        """Write the parameters as safetensors, whole or not at all.

        Raises:
            OSError: the file cannot be written.
        """
        content = save({key: value.detach().cpu().contiguous() for key, value in self.parameters.items()})
        write_atomically(Path(path), lambda partial: partial.write_bytes(content))
        return Path(path)

    def export(self, form: str, path: str | PathLike[str]) -> None:
        """Write the fit in another form, such as "merl" of a BRDF or "gltf" of a material; `path` needs no suffix.

        Raises:
            BadOption: fits of this application cannot be written so, or a library for it is missing.
        """
        check_export(form, self.app.name)
        export_fit(presentation_of(self.app), self.task, self.parameters, Path(path), form, self.settings)


def fit(app: str, source: Any, *, paradigm: str = "meta", **options: Any) -> Fit:
    """Fit one file, a material, a texture, a map, a scene; or a BRDF in memory.

    Args:
        app: brdf, texture, svbrdf_stationary, svbrdf_nonstationary, illumination or transport.
        source: what `metapp meta APP INPUT` takes, holding one task; of "brdf" also f(wi, wo) -> reflectance, arrays
            (wi, wo, reflectance) or a BSDF of Mitsuba, as of `data_tools.readers.brdf_objects.from_object`.
        paradigm: general, overfit, finetune, quickft or meta.
        options: as `fit_all` takes them.

    Raises:
        ValueError: a bad file, or one with several tasks; an option that the application does not have.
    """
    fits = fit_all(app, [source], paradigm=paradigm, **options)
    if len(fits) != 1:
        raise ValueError(f"{source}: {len(fits)} tasks, expected one; take metapp.fit_all for several.")
    return fits[0]


def fit_all(
    app: str,
    sources: Sequence[Any] = (),
    *,
    paradigm: str = "meta",
    fov: float = 0.0,
    **options: Any,
) -> list[Fit]:
    """Fit files and folders, or the test tasks of a data set.

    Args:
        app: the application.
        sources: files and folders, or BRDFs in memory; none: the test tasks of `data`, else of the embedded set.
        paradigm: general, overfit, finetune, quickft or meta.
        fov: of flash photos, the camera's field of view along the shorter side in degrees; 0: as EXIF says, else 45.
        options: observe, rule, recipe, steps, budget, detail, data, checkpoint, seed, device, as on the command line;
            `out` is where checkpoints that were trained here are looked for.

    Raises:
        ValueError: a bad file, no checkpoint; an option that the application does not have.
        FloatingPointError: a fit is not finite.
    """
    for key in ("data", "out", "checkpoint"):
        if options.get(key) is not None:
            options[key] = Path(options[key])
    in_memory = [source for source in sources if not isinstance(source, str | PathLike)]
    if 0 < len(in_memory) < len(sources):
        raise ValueError(f"{len(in_memory)} of {len(sources)} sources are no paths, expected all or none of them.")
    inputs = [] if in_memory else [Path(source) for source in sources]
    request = Request(app, paradigm, inputs, fov=fov, quiet=True, **options)
    planned = plan(request)
    with threads(threads_of(planned.app)):
        found = tasks_of_objects(planned.app, in_memory) if in_memory else tasks_to_fit(planned.app, planned.request)
        tasks, label = found
        if in_memory and not request.recipe:
            planned = plan(replace(request, recipe=recipe_of_tasks(request, tasks)))
        planned = find_checkpoint(planned)
        settings = planned.settings(label)
        results = fit_tasks(planned, tasks, warns=True)
        return [Fit(planned.app, task, settings, *result) for task, result in zip(tasks, results, strict=True)]
