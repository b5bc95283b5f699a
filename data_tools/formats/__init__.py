"""The formats of files that tasks come from or fits are written in.

Each module here holds records of some, FORMATS: what a format is called, whose tasks it holds, which options its
conversion takes; commands and help texts are made of these. What finds, reads and writes the files is a module of
`data_tools.readers`, imported on first use. EXPORTS are the forms that fits of flat surfaces are written in and that
nothing reads; `data_tools.assets` writes them.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import pkgutil
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, cast

if TYPE_CHECKING:
    from metapp.appearance.surface import Surface
    from metapp.learning.app import App
    from metapp.learning.task import Params, Task

MATERIALS = ("svbrdf_stationary", "svbrdf_nonstationary")  # applications whose fits are maps of a material
TEXTURES = ("texture",)
AUTO = "auto"  # the split by a rule: train and test tasks
SPLIT = "Where the tasks belong. auto: of the sorted names, every fifth is a test task (80 give 64 + 16)."


class Files(Protocol):
    """What finds and reads the files of a format, a module.

    Its `read_task` also takes what `Format.takes` and the command's settings name. Where it converts files it has
    UNITS, of the tasks' tensors by name, and where that takes more than these, `conversion(paths, split, **settings)`.
    """

    def recognises(self, path: Path, /) -> bool:
        """Return whether a path is of this format, or a folder with such files."""

    def find(self, paths: Iterable[Path], /) -> tuple[list[Path], list[str]]:
        """Return sources, and a line for each file of a folder that is none; ValueError for a bad path."""

    def read_task(self, path: Path, /) -> Task:
        """Read one source; ValueError where it is damaged."""


class Writer(Protocol):
    """What writes fits in a format, a module."""

    def export(self, app: App, theta: Params, path: Path, /) -> None:
        """Write the parameters of one fit beside or below `path`, with the format's own suffix."""


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


class Label(NamedTuple):
    """What a task is called, of which group it is (tasks that show the same), and its split where AUTO is asked for.

    "" for no group; a split of "" is that of the rule of `metapp.storage.shards.split_auto`.
    """

    name: str
    group: str = ""
    split: str = ""


def label_of_stem(source: Path) -> Label:
    """A task that is named by its file's stem."""
    return Label(source.stem)


class Conversion(NamedTuple):
    """How the files of one conversion become tasks.

    Attributes:
        app: the application of the tasks.
        noun: what one source is called, such as "MERL file".
        units: of the tasks' tensors, by name.
        find: paths -> sources, and a line for each file of a folder that is none; ValueError for a bad named path.
        read: source -> the task; ValueError where it is damaged.
        notes: what the manifest should say about the conversion.
        label: source -> the task's name, group and split.
        remarks: what a person should know about the split.
    """

    app: str
    noun: str
    units: Mapping[str, str]
    find: Callable[[Iterable[Path]], tuple[list[Path], list[str]]]
    read: Callable[[Path], Task]
    notes: Mapping[str, object]
    label: Callable[[Path], Label] = label_of_stem
    remarks: tuple[str, ...] = ()


class Command(NamedTuple):
    """What `metapp data NAME` is.

    Attributes:
        help: paragraphs and examples.
        noun: what one source is called, such as "MERL file".
        metavar, paths: of its arguments, and their help.
        settings: its own options.
        split_help: of --split, where files or names tell more than the general rule.
    """

    help: str
    noun: str
    metavar: str
    paths: str
    settings: tuple[Setting, ...] = ()
    split_help: str = SPLIT


class OwnRecipe(NamedTuple):
    """A recipe for the inputs of one format.

    Attributes:
        name: of the recipe.
        has: what these inputs have and the application's others lack, in words.
        tensor: the one that their tasks alone hold; "" where there is none, and data sets do not choose it.
        tells: the function of the format's module that tells which of its sources these are; "" for all. Where there is
            no such tensor, the one of this name and `_task` tells which tasks in memory are.
        paradigms: those that its checkpoints serve; () for all.
    """

    name: str
    has: str
    tensor: str = ""
    tells: str = ""
    paradigms: tuple[str, ...] = ()


class Format(NamedTuple):
    """A format of files.

    Attributes:
        name: of its command and, where fits are written in it, the value of --export.
        app: the application whose tasks its files hold.
        module: of what finds, reads and writes them.
        inputs: what the files are, in words, for help and errors; "" where fits do not take them as INPUT.
        takes: what fits may tell `read_task`: "size", px a side or rows of what the file becomes; "least", what
            smaller photos are enlarged to; "fov_rad", the camera's field of view along the shorter side; "exposure", by
            how many stops photos are too bright; "roots", folders that files named in a file may come from.
        exports: whether fits are written in it.
        holds: the parameters that a written file holds; a fit of another network is distilled into them first; () for
            a format that is written from what a fit evaluates to.
        command: that converts files, if any.
        own: recipes that fits of such inputs take where none is asked for, the first that is for all of them.
    """

    name: str
    app: str
    module: str
    inputs: str = ""
    takes: tuple[str, ...] = ()
    exports: bool = False
    holds: tuple[str, ...] = ()
    command: Command | None = None
    own: tuple[OwnRecipe, ...] = ()

    def files(self) -> Files:
        """What finds and reads the files."""
        return cast(Files, importlib.import_module(self.module))

    def writer(self) -> Writer:
        """What writes fits."""
        return cast(Writer, importlib.import_module(self.module))

    def recognises(self, path: Path) -> bool:
        """Whether a path is of this format, or a folder with such files."""
        return self.files().recognises(path)

    def find(self, paths: Iterable[Path]) -> tuple[list[Path], list[str]]:
        """Sources, and a line for each file of a folder that is none; ValueError for a bad path."""
        return self.files().find(paths)

    def read(self, source: Path, **known: object) -> Task:
        """Read one source; of what is known beside it (`takes`), what is empty or not taken is left out."""
        taken = {name: value for name, value in known.items() if value and name in self.takes}
        read: Callable[..., Task] = self.files().read_task
        return read(source, **taken)

    def conversion(self, paths: list[Path], split: str, settings: Mapping[str, object]) -> Conversion:
        """How files become tasks by the command's options; ValueError for bad paths."""
        assert self.command is not None
        files = importlib.import_module(self.module)
        if hasattr(files, "conversion"):
            made: Conversion = files.conversion(paths, split, **settings)
            return made
        read = functools.partial(files.read_task, **settings)
        notes = {"made_by": f"metapp data {self.name}", **settings}
        return Conversion(self.app, self.command.noun, files.UNITS, files.find, read, notes)


class Export(NamedTuple):
    """A form that fits of flat surfaces are written in for other programs.

    Attributes:
        name: the value of --export; `write_<name>` is what writes it, of
        module: of `data_tools.assets`.
        apps: the applications whose fits are written in it.
        needs: the module and the package of a library that is not always installed; () for none.
    """

    name: str
    module: str
    apps: tuple[str, ...] = MATERIALS
    needs: tuple[str, str] | tuple[()] = ()

    def write(self, surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
        """Write a surface as or below `path`, whose last part is its name; the file may state the provenance."""
        getattr(importlib.import_module(f"data_tools.assets.{self.module}"), f"write_{self.name}")(
            surface, path, provenance
        )

    def missing(self) -> str:
        """One line about a library that is not installed; "" where nothing is missing."""
        if not self.needs or importlib.util.find_spec(self.needs[0]):
            return ""
        return f'--export {self.name} needs {self.needs[1]}: pip install "metapp[export]"'


EXPORTS = (
    Export("asset", "pictures", MATERIALS + TEXTURES),
    Export("blender", "pictures"),
    Export("exr", "pictures", MATERIALS + TEXTURES),
    Export("gltf", "gltf"),
    Export("materialx", "materialx"),
    Export("mitsuba", "mitsuba"),
    Export("png16", "pictures", MATERIALS + TEXTURES),
    Export("usd", "usd", needs=("pxr", "usd-core")),
)


@functools.cache
def formats() -> tuple[Format, ...]:
    """Return all formats that tasks come from, by name, found by listing this folder."""
    return tuple(sorted((form for module in _modules() for form in module.FORMATS), key=lambda form: form.name))


def _modules() -> list[ModuleType]:
    return [importlib.import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__)]


def inputs_of(app: str) -> tuple[Format, ...]:
    """Return the formats that fits of an application take as INPUT."""
    return tuple(form for form in formats() if form.app == app and form.inputs)


def merge_of(app: str) -> Callable[..., Task] | None:
    """Return what makes one task of an application of photos of different exposures, `merge(paths, exposures, ...)`."""
    return _function_of(app, "MERGES")


def objects_of(app: str) -> Callable[[object, str, Mapping[str, Any]], Task] | None:
    """Return what makes a task of an application of something in memory, `from_object(source, name, how)`.

    `how` has what fits tell readers, as of `Format.takes`, and `observe`.
    """
    return _function_of(app, "OBJECTS")


def _function_of(app: str, table: str) -> Callable[..., Any] | None:
    """The function that a table of this folder's modules names for an application; None where none does."""
    tables = [getattr(module, table, {}) for module in _modules()]
    module, _, name = next((names[app] for names in tables if app in names), "").partition(":")
    return getattr(importlib.import_module(module), name) if module else None


def exports_of(app: str) -> dict[str, Format | Export]:
    """Return the forms that fits of an application can be written in, by name."""
    written = {form.name: form for form in formats() if form.app == app and form.exports}
    return written | {form.name: form for form in EXPORTS if app in form.apps}
