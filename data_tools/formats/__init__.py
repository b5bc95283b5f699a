"""The formats of files that tasks come from or fits are written in; one is a module here.

It defines FORMAT, or EXPORT where fits of flat surfaces are written for other programs and nothing is read. A record
says what a format is called, whose tasks it holds, and which settings its conversion takes: help texts and
commands are made of it. What reads and writes the files is a module of `data_tools.readers`, imported on first use.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import pkgutil
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

if TYPE_CHECKING:
    from metapp.appearance.surface import Surface
    from metapp.learning.task import Params, Task

MATERIALS = ("svbrdf_stationary", "svbrdf_nonstationary")  # applications whose fits are maps of a material
TEXTURES = ("texture",)
AUTO = "auto"  # the split by a rule: train and test tasks


class Files(Protocol):
    """What reads the files of a format, a module."""

    def recognises(self, path: Path, /) -> bool:
        """Return whether a path is of this format, or a folder with such files."""

    def find(self, paths: Iterable[Path], /) -> tuple[list[Path], list[str]]:
        """Return sources, and a line for each file of a folder that is none; ValueError for a bad path."""

    def read_task(self, path: Path, /) -> Task:
        """Read one source; ValueError where it is damaged."""


class Writer(Protocol):
    """What writes fits in a format, a module."""

    def export(self, app: Any, theta: Params, path: Path, /) -> None:
        """Write the parameters of one fit beside or below `path`, with the format's own suffix."""


class AssetWriter(Protocol):
    """What writes a fitted surface for another program, a module."""

    def write(self, surface: Surface, path: Path, provenance: Mapping[str, Any], /) -> None:
        """Write a surface as or below `path`, whose last part is its name; the provenance may be told in the file."""


class FilesAndWriter(Files, Writer, Protocol):
    """What does both, a module."""


class Setting(NamedTuple):
    """An option of a conversion.

    Attributes:
        name: without dashes.
        default: a number or a word, whose type is the option's.
        help: one sentence.
        metavar: what stands for the value.
        low, high: least and greatest value of a number.
        choices: the values of a word; () for any.
    """

    name: str
    default: int | float | str
    help: str
    metavar: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()


class Reader(NamedTuple):
    """How the files of one conversion become tasks.

    Attributes:
        app: the application of the tasks.
        noun: what one source is called, such as "MERL file".
        units: of the tasks' tensors, by name.
        find: paths -> sources, and a line for each file of a folder that is none; ValueError for a bad named path.
        name: source -> the task's name.
        read: source -> the task; ValueError where it is damaged.
        notes: what the manifest should say about the conversion.
        split_of: source -> its split where AUTO is asked for; None: by the rule of `metapp.storage.shards.split_auto`.
        remarks: what a person should know about the split.
    """

    app: str
    noun: str
    units: Mapping[str, str]
    find: Callable[[Iterable[Path]], tuple[list[Path], list[str]]]
    name: Callable[[Path], str]
    read: Callable[[Path], Task]
    notes: Mapping[str, Any]
    split_of: Callable[[Path], str] | None = None
    remarks: tuple[str, ...] = ()


class Conversion(NamedTuple):
    """What `metapp data NAME` does.

    Attributes:
        help: of the command; paragraphs and examples.
        reader: (paths, split, settings by name) -> how to read them.
        paths: the metavar of its arguments and their help.
        settings: its own options.
        split_help: of --split, where files or names tell more than the general rule.
    """

    help: str
    reader: Callable[..., Reader]
    paths: tuple[str, str]
    settings: tuple[Setting, ...] = ()
    split_help: str = "Where the tasks belong. auto: of the sorted names, every fifth is a test task (80 give 64 + 16)."


class Format(NamedTuple):
    """A format of files.

    Attributes:
        name: of its command and, where fits are written in it, the value of --export.
        app: the application whose tasks its files hold.
        inputs: what the files are, in words, for help and errors; "" where fits do not take them as INPUT.
        files: imports and returns what reads them; None where nothing does, which has no `inputs` either.
        writer: imports and returns what writes fits; None where nothing does.
        conversion: the command that makes data sets of them, if any.
        takes_roots: whether `read_task` takes `roots`, folders that files named in a file may come from.
        takes_fov: whether it takes `fov_rad`, the camera's field of view along the shorter side.
        takes_size: whether it takes `size`, px a side or rows of what the file becomes.
        holds: the parameters that a written file holds; a fit of another network is distilled into them first; () for
            a format that is written from what a fit evaluates to.
    """

    name: str
    app: str
    inputs: str
    files: Callable[[], Files] | None
    writer: Callable[[], Writer] | None = None
    conversion: Conversion | None = None
    takes_roots: bool = False
    takes_fov: bool = False
    takes_size: bool = False
    holds: tuple[str, ...] = ()


class Export(NamedTuple):
    """A form that fits of flat surfaces are written in for other programs.

    Attributes:
        name: the value of --export.
        apps: the applications whose fits are written in it.
        writer: imports and returns what writes it.
        needs: the module and the package of a library that is not always installed; () for none.
    """

    name: str
    apps: tuple[str, ...]
    writer: Callable[[], AssetWriter]
    needs: tuple[str, str] | tuple[()] = ()

    def missing(self) -> str:
        """One line about a library that is not installed; "" where nothing is missing."""
        if not self.needs or importlib.util.find_spec(self.needs[0]):
            return ""
        return f'--export {self.name} needs {self.needs[1]}: pip install "metapp[export]"'


@functools.cache
def _records() -> tuple[Format | Export, ...]:
    """All records, found by listing this folder."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    modules = [importlib.import_module(f"{__name__}.{name}") for name in names]
    return tuple(getattr(module, "FORMAT", None) or module.EXPORT for module in modules)


def formats() -> tuple[Format, ...]:
    """Return all formats that tasks come from."""
    return tuple(each for each in _records() if isinstance(each, Format))


def inputs_of(app: str) -> tuple[Format, ...]:
    """Return the formats that fits of an application take as INPUT."""
    return tuple(each for each in formats() if each.app == app and each.inputs)


def exports_of(app: str) -> dict[str, Format | Export]:
    """Return the forms that fits of an application can be written in, by name."""
    written = {each.name: each for each in formats() if each.app == app and each.writer}
    return written | {each.name: each for each in _records() if isinstance(each, Export) and app in each.apps}
