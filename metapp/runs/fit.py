"""A fit of one input: its specification, its figures and its parameters, with all that can be made of it.

A :class:`Fit` is plain data, which a record holds, and what can be computed of them. How inputs are fitted is decided
in `metapp.runs.fitting`.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from html import escape
from os import PathLike
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from PIL.Image import Image
from torch import Tensor
from typing_extensions import override

from data_tools.readers.numbers import unit_vectors
from metapp.appearance.geometry import directions_to_four_angles
from metapp.appearance.presenter import Presenter
from metapp.learning.app import App
from metapp.learning.task import Params, Task
from metapp.registry import registry
from metapp.runs.data_sets.embedded import embedded_folders
from metapp.runs.environment import torch_defaults
from metapp.runs.inputs.finding import content_of, data_label, find
from metapp.runs.outputs.contact_sheet import Tiles, place_side_by_side, srgb_image, to_display_values
from metapp.runs.outputs.fit_files import distill, export_to_new_files, render_outputs, write_pictures
from metapp.runs.records import convert_record
from metapp.runs.resolve import app_of, presenter_of
from metapp.runs.spec import Spec, check_export
from metapp.storage import Document
from metapp.storage.files import require_new_file, to_json_value, write_bytes
from metapp.storage.fit_folders import RECORD, pack_fit, read_params, read_record, write_fit_folder
from metapp.storage.image_writers import png_data_url
from metapp.storage.parameters import check_params


class Fit(msgspec.Struct, kw_only=True, dict=True, rename={"spec": "settings"}):
    """A fit of one input. Its fields are its record, `record.json` in its folder; its parameters lie beside it.

    Extensions add methods, such as `view` of the viewer.

    Attributes:
        name: the name of the fit, in tables and files.
        spec: all that the error and the seconds depend on.
        error: the error in the unit of tables (BRDF x100); None if the task holds no reference.
        scale: the factor by which `error` was multiplied.
        photo_error: the mean difference between the fit and its photographs in percent of display values; None if the
            error says more, or the fit saw no photograph.
        further_errors: further errors by name, in their own units; the entry `errors` of records.
        seconds: the time of inference in seconds, from the samples of the task to the final parameters; None for an
            answer that was made elsewhere. Of fits side by side each has its share.
        cpu_seconds: the CPU time of inference in seconds; None where a GPU computed.
        threads: the number of threads, by which figures differ in their last digits.
        counts: how many things of a kind the fit saw.
        note: what is said of the fit, in a clause.
        guarded: whether the guard of a learned rule acted; None if there was no guard.
        warning: clauses that doubt the fit, joined by "; "; "" for none.
        batch: the number of fits that were made side by side.
        figures: what the application says of the fit besides, by name.
        source: the path of the input, or its name in a data set.
        format: the name of the input's format.
        content: a digest of the task's values.
        stamp: a digest of sizes and times of change of the input's files; "" if it is not known.
        group: the name that tasks of one thing have in common.
        inputs: the paths, as the user gave them, by which a later command finds the input again.
    """

    name: str
    spec: Spec
    error: float | None = None
    scale: float | None = None
    photo_error: float | None = None
    further_errors: dict[str, float | None] = msgspec.field(name="errors", default_factory=dict)
    seconds: float | None = None
    cpu_seconds: float | None = None
    threads: int | None = None
    counts: dict[str, int] = {}
    note: str = ""
    guarded: bool | None = None
    warning: str = ""
    batch: int = 1
    figures: dict[str, Any] = {}
    source: str = ""
    format: str = ""
    content: str = ""
    stamp: str = ""
    group: str = ""
    inputs: list[str] = []

    # What is read or made when it is needed

    @functools.cached_property
    def is_earlier(self) -> bool:
        """Whether the fit was made before and kept by --resume, instead of being made by this command."""
        return False

    @functools.cached_property
    def place(self) -> Path | None:
        """The folder or the file that the fit was written to or read from; None if it is in memory alone."""
        return None

    @property
    def folder(self) -> Path:
        """The folder of the fit, which a command has written."""
        assert self.place is not None, f"{self.name}: not written"
        return self.place

    @functools.cached_property
    def app(self) -> App:
        """The network of the fit, what it saw, and how it is judged."""
        return app_of(self.spec)

    @functools.cached_property
    def presenter(self) -> Presenter[Any]:
        """What people look at of the fit."""
        return presenter_of(self.spec, self.app)

    @functools.cached_property
    def parameters(self) -> Params:
        """The parameters of the network by name, without a task axis, on the CPU.

        Raises:
            ValueError: the file of the parameters is missing or damaged, or holds another network's.
        """
        place = str(self.folder)
        theta = read_params(place)
        check_params(theta, self.app, place)
        return theta

    @functools.cached_property
    def task(self) -> Task:
        """The task that was fitted, read again from its place; without data if it is gone or has changed."""
        return find_tasks([self]).get(self.name, Task(self.name, {}))

    def forget(self) -> None:
        """Drop the parameters and the task of a fit that was written: they are read again where they are needed."""
        for name in ("parameters", "task", "maps", "presenter", "asset", "_distilled"):
            vars(self).pop(name, None)

    # Figures

    @property
    def settings(self) -> Document:
        """The specification as records state it."""
        return self.spec.document()

    @property
    def rule(self) -> str:
        """The name of the learned rule, "adam", or "none" without steps."""
        return self.spec.rule or ("adam" if self.spec.steps else "none")

    @property
    def errors(self) -> dict[str, float]:
        """The error, further errors and the error of photographs, in their own units, by name."""
        named = {"error": self.error, **self.further_errors, "photo_error": self.photo_error}
        return {name: value for name, value in named.items() if value is not None}

    def error_text(self, prefix: str = "") -> str:
        """Return the error as a text, or the difference from the photo if there is no reference; "" for neither.

        Args:
            prefix: what stands before an error.
        """
        if self.error is not None:
            return f"{prefix}{self.error:.3f}"
        return "" if self.photo_error is None else f"|fit - photo| {self.photo_error:.2f} %"

    def document(self) -> Document:
        """Return the record of the fit as JSON holds it, without what is not set."""
        fields = {field.encode_name: getattr(self, field.name) for field in msgspec.structs.fields(Fit)}
        fields |= {"settings": self.spec.document(), "batch": self.batch if self.batch > 1 else None}
        always = ("name", "error", "settings")
        kept = {key: value for key, value in fields.items() if key in always or value not in (None, "", {}, [])}
        document: Document = to_json_value(kept)
        return document

    def record(self, name: str = "") -> bytes:
        """Return the record of the fit as JSON, with another name if one is given."""
        document = self.document() | ({"name": name} if name else {})
        return json.dumps(document, allow_nan=False, indent=1).encode()

    # For programs and notebooks

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
        return f"<Fit of {self.spec.app} {self.name}: {error}, {self.seconds or 0:.4f} s>"

    @override
    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the parameters and the task, too, as programs that fit in several processes send them back."""
        held = {name: vars(self)[name] for name in ("parameters", "task", "place") if name in vars(self)}
        return _unpickle_fit, (self.record(), held)

    def _repr_html_(self) -> str:
        """Return the page that notebooks show: the picture of the fit and one line about it."""
        error = "no reference" if self.error is None else f"error{self.app.error_measure.factor} {self.error:.3f}"
        line = f"{self.name}: {self.presenter.title}, {self.spec.paradigm}, {error}, {self.seconds or 0:.3g} s"
        line += f", {self.spec.steps} steps" + (f"; warning: {self.warning}" if self.warning else "")
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
        if "reflectance" not in self.spec.application.assets:
            raise ValueError(
                f"{self.name}: a fit of {self.spec.app}, expected one of brdf; take fit.maps or fit.picture()."
            )
        with torch_defaults(single=self.app.small_tensors), torch.no_grad():
            values: Tensor = self.asset.evaluate(directions_to_four_angles(light, viewer).float())
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
            maps = self.asset.linear_maps()
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
        lamps = unit_vectors(self.name, directions, "directions").float()
        if "surface" not in self.spec.application.assets:
            raise ValueError(
                f"{self.name}: a fit of {self.spec.app}, expected one of svbrdf_nonstationary; take fit.picture()."
            )
        if not self.task.data:
            raise ValueError(f"{self.name}: no photos any more, expected those that were fitted; bring them back.")
        with torch_defaults(single=self.app.small_tensors), torch.no_grad():
            pictures = self._relightable.relight(lamps)
        return np.ascontiguousarray(pictures.permute(0, 2, 3, 1).numpy())

    def preview(self) -> dict[str, Tensor]:
        """Return linear RGB pictures [H, W, 3 or 4] of the fit and its reference, by name."""
        with torch_defaults(single=self.app.small_tensors):
            return self.presenter.preview(self.parameters, self.task)

    @functools.cached_property
    def renders(self) -> dict[str, np.ndarray]:
        """The renderings that options ask for, such as `render` of transport: linear pictures [H, W, 3] by name."""
        with torch_defaults(single=self.app.small_tensors):
            pictures, _ = render_outputs(self.spec, self.app, self.task, self.parameters)
        return {name: picture.pixels.numpy() for name, picture in pictures.items()}

    @functools.cached_property
    def tiles(self) -> Tiles:
        """The pictures of the fit and its error, which are its row in the contact sheet of a run."""
        with torch_defaults(single=self.app.small_tensors), torch.no_grad():
            pictures = to_display_values(self.presenter.tiles(self.parameters, self.task))
        return Tiles(pictures, self.name, {"": self.error_text("error ")})

    def picture(self) -> Image:
        """Return a picture of PIL in 8 bits of sRGB, with the reference, if there is one, left of the fit."""
        previews = self.preview()
        with torch_defaults(single=self.app.small_tensors):
            return place_side_by_side(
                [srgb_image(linear) for name, linear in previews.items() if name in ("reference", "fit")]
            )

    # Files

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
        write_bytes(file, pack_fit(self.record(), self.parameters))
        return file

    def keep(self, run_folder: Path, draw: Callable[[Path], object] = lambda folder: None) -> None:
        """Write the parameters, pictures and the record into a folder of the fit in the folder of a run.

        A method without a network may have no parameters.

        Args:
            run_folder: the folder of the run.
            draw: a function that writes pictures into the folder that it is given.

        Raises:
            OSError: a file cannot be written, for example to a full disk.
        """
        theta = vars(self).get("parameters")
        self.place = write_fit_folder(run_folder, self.name, self.source, self.record, theta, draw)
        self.name = read_fit(self.place).name
        for form in registry().exports_of(self.spec.application):  # those of a fit that this one has replaced
            shutil.rmtree(self.place / form, ignore_errors=True)

    def draw(self, folder: Path) -> list[str]:
        """Write the pictures of the fit into a folder, and return lines about renderings that options ask for.

        Raises:
            ValueError: the fit cannot be drawn.
            OSError: a file cannot be written.
        """
        with torch.no_grad():
            renders, lines = render_outputs(self.spec, self.app, self.task, self.parameters)
            pictures = self.asset.pictures() if self.spec.application.assets else {}
            write_pictures(pictures | renders, folder)
        return [f"{self.name}: {line}" for line in lines]

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
        check_export(form, self.spec.application)
        return export_to_new_files(
            lambda partial: self.write_export(form, partial), Path(os.fsdecode(path)), overwrite=overwrite
        )

    def write_export(self, form: str, path: Path) -> None:
        """Write the fit in another file format, in place of files that are there.

        A format for another network gets the fit distilled into that network.

        Args:
            form: the name of the format.
            path: the file to write, without suffix; its last part names an asset.

        Raises:
            KeyError: the format holds something of the input, too, which is not at hand.
            ValueError: the format cannot hold this fit.
            OSError: the files cannot be written.
        """
        kind, entry = registry().exports_of(self.spec.application)[form]
        with torch_defaults(single=self.app.small_tensors), torch.no_grad():
            asset = self.make_asset(kind)
            if entry.holds and set(asset.theta) != set(entry.holds):
                asset = self._distilled
            entry.load()(asset, path, {"task": self.name, **self.settings})

    def make_asset(self, kind: str) -> Any:
        """Return an asset of the fit, at the size of files.

        Args:
            kind: the name of the type of asset, a key of `Application.assets`.

        Raises:
            KeyError: the asset needs data of the input, which is not at hand.
            ValueError: the fit has no such asset.
        """
        if "asset" in vars(self) and self.asset.kind == kind:
            return self.asset
        if not self.spec.paradigm:
            raise ValueError(
                f"{self.name}: the answer of a baseline, which only its own command can write, expected a {kind} of a "
                "fit; give metapp baseline the option --export."
            )
        make, options = self.spec.application.assets[kind].load(), self.spec.app_options
        with torch.no_grad():
            return options.adapt_asset(make(self.app, self.parameters, self.task, getattr(options, "size", None)))

    @functools.cached_property
    def asset(self) -> Any:
        """What the fit is for, a :class:`metapp.appearance.assets.Asset` at the size of files.

        Raises:
            KeyError: the asset needs data of the input, which is not at hand.
        """
        return self.make_asset(next(iter(self.spec.application.assets)))

    @property
    def _relightable(self) -> Any:
        """The photographs under many lamps that the fit saw, or else its surface, which can be relit, too."""
        if "lit photos" in self.spec.application.assets:
            with contextlib.suppress(ValueError):
                return self.make_asset("lit photos")
        return self.make_asset("surface")

    @functools.cached_property
    def _distilled(self) -> Any:
        """The asset of the application's usual network, distilled from the fit."""
        return distill(self.spec.app, self.asset, self.task, self.error)


def _unpickle_fit(record: bytes, held: Mapping[str, Any]) -> Fit:
    """Return the fit that `Fit.__reduce__` took apart."""
    fit = _decode(record)
    vars(fit).update(held)
    return fit


def read_fit(place: Path) -> Fit:
    """Read a fit, of this or an earlier version, from its folder or from a file of `Fit.save`.

    Parameters and task are read when they are needed.

    Raises:
        FileNotFoundError: the folder holds no record.
        ValueError: the record, which anybody may have written, holds something else.
    """
    file = place if place.is_file() else place / RECORD
    try:
        stored = read_record(place)
        if stored is None:
            raise FileNotFoundError(f"{place}: no {RECORD}, expected the folder of a fit.")
        fit = _decode(stored)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise ValueError(f"{file}: no record, expected one of a fit ({error}); fit again.") from None
    fit.place = place
    return fit


def _decode(record: bytes) -> Fit:
    """Read a record from JSON.

    Raises:
        msgspec.MsgspecError: it is no record.
    """
    document = msgspec.json.decode(record)
    if isinstance(document, Mapping):
        document = convert_record(document)
    fit: Fit = msgspec.convert(document, Fit, dec_hook=lambda kind, value: kind(value))
    fit.source = fit.source or fit.name
    return fit


def find_tasks(fits: Sequence[Fit], inputs: Sequence[Path] = (), data: Path | None = None) -> dict[str, Task]:
    """Find the tasks that were fitted, and read them.

    They are looked for in the given inputs or data set, else at the places that records state, else in the embedded
    data set.

    Args:
        fits: the fits.
        inputs: files and folders, or a data set, that were fitted; () if they are not given.
        data: the data set that was fitted; None if it is not given.

    Returns:
        Tasks by the name of their fit, without those that are not found, or that have changed since they were fitted.
    """
    tasks: dict[str, Task] = {}
    groups: dict[tuple[str, tuple[str, ...]], list[Fit]] = {}
    given = [*inputs, *([data] if data else [])]
    for fit in fits:
        places = tuple(map(str, given)) or tuple(dict.fromkeys([*fit.inputs, fit.source]))
        groups.setdefault((fit.spec.key, places), []).append(fit)
    for (_, places), group in groups.items():
        wanted = {Path(fit.source).name for fit in group} | {fit.name for fit in group}
        spec = group[0].spec
        present = [Path(place) for place in places if os.path.exists(place)] or [
            folder for folder in embedded_folders(spec.application) if data_label(folder) == spec.data
        ]
        by_content: dict[str, Task] = {}
        with contextlib.suppress(ValueError, OSError):
            for one in find(spec, present) if present else ():
                if {one.name, Path(one.path).name} & wanted:
                    with contextlib.suppress(ValueError, OSError):  # a file that was damaged since is not found
                        task = one.read_task(spec, group[0].app)
                        by_content[content_of(task)] = task
        found = [(fit.name, by_content.get(fit.content)) for fit in group]
        tasks |= {name: task._replace(name=name) for name, task in found if task}
    return tasks
