"""A fit of one task, as Python programs get it: its parameters and figures, maps, pictures and files.

A :class:`Fit` is plain data and what can be computed of them. How tasks are fitted is decided in `metapp.runs.fitter`.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from html import escape
from os import PathLike
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from PIL.Image import Image
from torch import Tensor
from typing_extensions import override

from data_tools.readers.numbers import unit_vectors
from metapp.appearance.geometry import directions_to_four_angles
from metapp.learning.app import App
from metapp.learning.task import Params, Task
from metapp.registry import registry
from metapp.runs.choice import Choice
from metapp.runs.environment import torch_defaults
from metapp.runs.fit_options import check_export
from metapp.runs.outputs.contact_sheet import place_side_by_side, srgb_image
from metapp.runs.outputs.fit_files import export_to_new_files, render_outputs
from metapp.storage import Document
from metapp.storage.files import require_new_file, write_bytes
from metapp.storage.fit_records import FitRecord
from metapp.storage.fit_store import pack_fit
from metapp.storage.image_writers import png_data_url
from metapp.storage.parameters import read_checked_params


@runtime_checkable
class HasReflectance(Protocol):
    """An application whose fits are BRDFs, which :class:`Fit` evaluates for any pairs of directions."""

    def reflectance(self, theta: Params, angles: Tensor) -> Tensor:
        """Return the reflectance of a fitted BRDF.

        Args:
            theta: the parameters of the fit, without a task axis.
            angles: half and difference angles and phi_h, [..., 4] in rad.

        Returns:
            Reflectance in 1/sr without the cosine, linear RGB [..., 3].
        """


@runtime_checkable
class CanRelight(Protocol):
    """An application of materials and objects that :class:`Fit` relights."""

    def relight(self, theta: Params, task: Task, directions: Tensor) -> Tensor:
        """Return a fit under distant lamps, one at a time, linear RGB [K, 3, H, W] in [0, 1].

        Args:
            theta: the parameters of the fit, without a task axis.
            task: the task of the fit, with its photographs.
            directions: unit vectors towards K lamps, [K, 3]: x right, y up, z towards the camera.
        """


class Fit:
    """A fit of one task.

    Extensions add methods, such as `view` of the viewer.

    Attributes:
        choice: the options of the fit, with the application, the recipe and the paradigm.
        task: the task that was fitted.
        record: the record in `record.json` of the fit's folder. Its `figures` are what the application says of a fit
            besides errors.
    """

    def __init__(self, choice: Choice, task: Task, record: FitRecord, parameters: Params | None = None) -> None:
        """Make a fit.

        Args:
            choice: the options of the fit, with the application, the recipe and the paradigm.
            task: the task that was fitted.
            record: its record.
            parameters: its parameters, without a task axis; None to read them from the folder in the record where they
                are needed.
        """
        self.choice, self.task, self.record = choice, task, record
        if parameters is not None:
            self.parameters = {key: value.detach().cpu() for key, value in parameters.items()}

    @functools.cached_property
    def parameters(self) -> Params:
        """The parameters of the network by name, without a task axis, on the CPU.

        Raises:
            ValueError: the file of the parameters is missing or damaged, or holds another network's.
        """
        return read_checked_params(self.record, self.app)

    @property
    def app(self) -> App:
        """The application of the fit, with the network of its recipe."""
        return self.choice.app

    @property
    def name(self) -> str:
        """The name of the task in tables and files."""
        return self.task.name

    @property
    def settings(self) -> Document:
        """The settings in the record: all that the error and the seconds depend on."""
        return self.record.settings.document()

    @property
    def error(self) -> float | None:
        """The error in the unit of tables (BRDF x100); None if the task holds no reference."""
        return self.record.error

    @property
    def errors(self) -> dict[str, float]:
        """The error, further errors and the error of photographs, in their own units, by name."""
        named = {"error": self.record.error, **self.record.errors, "photo_error": self.record.photo_error}
        return {name: value for name, value in named.items() if value is not None}

    @property
    def seconds(self) -> float:
        """The time of inference in seconds: from the samples of the task to the final parameters."""
        assert self.record.seconds is not None  # only answers of methods without a network may lack a time
        return self.record.seconds

    @property
    def warning(self) -> str:
        """The clauses that doubt the fit, joined by "; "; "" for none."""
        return self.record.warning

    def __getattr__(self, name: str) -> Callable[..., object]:
        """Return a method that an extension adds, bound to this fit."""
        if name in registry().methods:
            return functools.partial(registry().methods[name].load(), self)
        raise AttributeError(f"'Fit' object has no attribute '{name}'")

    @override
    def __dir__(self) -> list[str]:
        """List the methods that extensions add, too."""
        return [*super().__dir__(), *registry().methods]

    @override
    def __repr__(self) -> str:
        error = "no reference" if self.error is None else f"error {self.error:.3f}"
        return f"<Fit of {self.app.name} {self.name}: {error}, {self.seconds:.4f} s>"

    def _repr_html_(self) -> str:
        """Return the page that notebooks show: the picture of the fit and one line about it."""
        error = "no reference" if self.error is None else f"error{self.app.error_measure.factor} {self.error:.3f}"
        line = f"{self.name}: {self.choice.presenter.title}, {self.settings['paradigm']}, {error}, {self.seconds:.3g} s"
        line += f", {self.settings['steps']} steps" + (f"; warning: {self.warning}" if self.warning else "")
        return f'<img src="{png_data_url(self.picture())}"><div>{escape(line)}</div>'

    def __call__(self, wi: object, wo: object) -> Tensor | np.ndarray:
        """Evaluate a fitted BRDF.

        Args:
            wi: unit vectors to the light, [N, 3], in the frame of the surface, whose normal is z; an array or a tensor.
            wo: unit vectors to the viewer, [N, 3], in the same frame.

        Returns:
            Reflectance in 1/sr without the cosine, linear RGB [N, 3], float32: a tensor if `wi` is one, else an array.
            It is 0 where a direction is not above the surface.

        Raises:
            ValueError: the fit is of another application, or the vectors have another length or shape.
        """
        light, viewer = unit_vectors(self.name, wi, "wi"), unit_vectors(self.name, wo, "wo")
        if len(light) != len(viewer):
            raise ValueError(f"{self.name}: {len(light)} wi and {len(viewer)} wo, expected as many of both.")
        app: object = self.app
        with torch_defaults(single=self.app.small_tensors), torch.no_grad():
            angles = directions_to_four_angles(light, viewer).float()
            values = app.reflectance(self.parameters, angles) if isinstance(app, HasReflectance) else None
        if values is None:
            raise ValueError(
                f"{self.name}: a fit of {self.app.name}, expected one of brdf; take fit.maps or fit.picture()."
            )
        values = values * ((light[:, 2:] > 0) & (viewer[:, 2:] > 0))
        return values if isinstance(wi, Tensor) else values.numpy()

    @functools.cached_property
    def maps(self) -> dict[str, np.ndarray]:
        """The maps of the fit by name, linear, float32, with rows from the top; {} for brdf and transport.

        svBRDFs have `diffuse` and `specular` [H, W, 3], `roughness` [H, W] and `normal` [H, W, 3] (unit vectors: x
        right, y up, z out of the surface); stationary svBRDFs have `height` [H, W] in texels, too. Textures have
        `basecolor` [H, W, 3], illumination has `radiance` [H, 2 H, 3]. The maps are as fine as the files that
        `metapp meta` writes.
        """
        with torch_defaults(single=self.app.small_tensors):
            maps = self.choice.presenter.linear_maps(self.parameters, self.task)
        return {name: np.ascontiguousarray(values.float().numpy()) for name, values in maps.items()}

    def relight(self, directions: object) -> np.ndarray:
        """Return a fit of a non-stationary svBRDF under distant lamps, one at a time, from straight above.

        Objects that were photographed under many lamps (RTI) are shown as these photographs predict them, with shadows
        and reflections of one part on another; materials from other photographs as their maps show them.

        Args:
            directions: unit vectors towards K lamps, [K, 3]: x right, y up, z towards the camera; an array or a tensor.

        Returns:
            Linear RGB pictures [K, H, W, 3] in [0, 1], float32, as large as the photographs that the fit saw.

        Raises:
            ValueError: the fit is of another application, or its photographs are no longer there; the vectors have
                another length or shape.
        """
        lamps, app = unit_vectors(self.name, directions, "directions"), self.app
        if not isinstance(app, CanRelight):
            raise ValueError(
                f"{self.name}: a fit of {self.app.name}, expected one of svbrdf_nonstationary; take fit.picture()."
            )
        if not self.task.data:
            raise ValueError(f"{self.name}: no photos any more, expected those that were fitted; bring them back.")
        with torch_defaults(single=self.app.small_tensors):
            pictures = app.relight(self.parameters, self.task, lamps.float())
        return np.ascontiguousarray(pictures.permute(0, 2, 3, 1).numpy())

    def preview(self) -> dict[str, Tensor]:
        """Return linear RGB pictures [H, W, 3 or 4] of the fit and its reference, by name."""
        with torch_defaults(single=self.app.small_tensors):
            return self.choice.presenter.preview(self.parameters, self.task)

    @functools.cached_property
    def renders(self) -> dict[str, np.ndarray]:
        """The renderings that options ask for, such as `render` of transport: linear pictures [H, W, 3] by name."""
        with torch_defaults(single=self.app.small_tensors):
            pictures, _ = render_outputs(self.choice, self.task, self.parameters)
        return {name: picture.pixels.numpy() for name, picture in pictures.items()}

    def picture(self) -> Image:
        """Return a picture of PIL in 8 bits of sRGB, with the reference, if there is one, left of the fit."""
        previews = self.preview()
        with torch_defaults(single=self.app.small_tensors):
            return place_side_by_side(
                [srgb_image(linear) for name, linear in previews.items() if name in ("reference", "fit")]
            )

    def save(self, path: str | bytes | PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the parameters and the record as a safetensors file, which :func:`metapp.load` reads.

        The file is there whole or not at all.

        Args:
            path: the file to write.
            overwrite: whether an existing file is replaced.

        Returns:
            The file.

        Raises:
            FileExistsError: the file is there already.
            OSError: the file cannot be written.
        """
        file = Path(os.fsdecode(path))
        require_new_file(file, overwrite=overwrite)
        write_bytes(file, pack_fit(self.record, self.parameters))
        return file

    def export(self, form: str, path: str | bytes | PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the fit in another file format.

        Args:
            form: the name of the format, such as "merl" for a BRDF or "gltf" for a material.
            path: the file to write, or the folder for formats of several files, without suffix.
            overwrite: whether existing files are replaced.

        Returns:
            The file that was written, with its suffix, or the folder of the files.

        Raises:
            BadOption: fits of this application cannot be written in this format, or a library for it is missing.
            FileExistsError: a file of the export is there already.
            ValueError: the format cannot hold this fit.
            OSError: the files cannot be written.

        >>> import metapp, tempfile
        >>> gray = metapp.fit("brdf", lambda wi, wo: np.full((len(wi), 3), 0.1))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     gray.export("merl", f"{folder}/gray").name
        'gray.binary'
        """
        check_export(form, self.choice.application)
        with torch_defaults(single=self.app.small_tensors):
            return export_to_new_files(
                *(self.choice, self.task, self.parameters, Path(os.fsdecode(path)), form, self.record.settings),
                overwrite=overwrite,
            )
