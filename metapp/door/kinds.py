"""The records that extensions offer: what a thing is called, and "module:attribute" of what does the work.

All are cheap to import; what a reference names is imported on first use, by `metapp.door.load`.
"""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from metapp.door.finding import module_of

Task = Any  # metapp.learning.task.Task, which imports torch


class Option(NamedTuple):
    """An option of what has it: an application, a format, an output, a conversion.

    Attributes:
        name: on the command line, with _ for -.
        default: a number, a word or False for a flag, whose type is the option's; None for a path.
        help: one or two sentences.
        metavar: what stands for the value.
        low, high: least and greatest value of a number.
        choices: the values of a word; () for any.
        several: whether it may be given several times.
        panel: of --help.
        convert: what was given -> what the owner takes; ValueError states what is expected.
        adapt: of an application, `adapt(recipe, value) -> recipe`, ValueError where the recipe has no such choice; ""
            for an option that its presentation takes as a keyword. What adapts is in the name of a run's folder, and
            checkpoints are never trained with it.
        passed_as: the keyword that the owner takes it by; "" for the option's name.
        protocol: the value of --observe that it needs; "" for any.
        of_inputs: whether it is about INPUT alone.
    """

    name: str
    default: int | float | str | bool | None
    help: str
    metavar: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    several: bool = False
    panel: str = "Input"
    convert: Callable[[Any], Any] | None = None
    adapt: str = ""
    passed_as: str = ""
    protocol: str = ""
    of_inputs: bool = False

    @property
    def flag(self) -> str:
        """What it is called on the command line."""
        return "--" + self.name.replace("_", "-")


def keyword_of(option: Option) -> str:
    """The keyword that an option's owner takes it by."""
    return option.passed_as or option.name


class Application(NamedTuple):
    """An application.

    Attributes:
        name: as on the command line.
        app: its subclass of `metapp.learning.app.App`.
        presentation: its subclass of `metapp.appearance.presentation.Presentation`.
        protocols: the values of --observe, the default first; () where there is no choice.
        options: that change its recipe or what its presentation makes.
        examples: what follows `metapp` ({} stands for a folder of input files), and what that makes.
        files: the input files of the examples, `files(app, folder) -> paths written`; "" for none.
        needs_vgg: whether its fits read features of VGG.
    """

    name: str
    app: str
    presentation: str
    protocols: tuple[str, ...] = ()
    options: tuple[Option, ...] = ()
    examples: tuple[tuple[str, str], ...] = ()
    files: str = ""
    needs_vgg: bool = False


class Chosen(NamedTuple):
    """The inputs that take a recipe where none is asked for.

    Attributes:
        formats: the names of the formats that such inputs have.
        has: what these inputs have and the application's others lack, in words.
        tensor: the one that their tasks alone hold; "" where there is none, and data sets do not choose it.
        tells: the function `tells(path) -> bool` of the formats' modules, which sources these are; "" for all. Where
            there is no such tensor, the one of this name and `_task` tells which tasks in memory are.
        paradigms: those that its checkpoints serve; () for all.
    """

    formats: tuple[str, ...]
    has: str
    tensor: str = ""
    tells: str = ""
    paradigms: tuple[str, ...] = ()


class Recipe(NamedTuple):
    """A recipe of an application.

    Attributes:
        app: its name.
        name: the value of --recipe.
        recipe: a `metapp.learning.recipe.Recipe`.
        protocol: that it is for; "" where there is but one.
        chosen: the inputs that choose it; None where it must be named.
        checkpoints: the package whose folder <name> holds its checkpoints; "" for those that ship.
    """

    app: str
    name: str
    recipe: str
    protocol: str = ""
    chosen: Chosen | None = None
    checkpoints: str = ""


def recipes_in(app: str, table: str, *names: str, protocols: tuple[str, ...] = ()) -> tuple[Recipe, ...]:
    """The recipes of an application that a table holds by name, or by protocol and name."""
    if not protocols:
        return tuple(Recipe(app, name, f"{table}.{name}") for name in names)
    return tuple(Recipe(app, name, f"{table}.{protocol}.{name}", protocol) for protocol in protocols for name in names)


class Part(NamedTuple):
    """A part of learned rules.

    Attributes:
        name: as in compositions, adam+curvature.
        part: a class of `metapp.learning.rules.part.Part` that takes no arguments.
    """

    name: str
    part: str


class Rule(NamedTuple):
    """A name of a composition of parts, as of "adam+loss".

    Attributes:
        name: the value of --rule.
        parts: names of parts and of rules, with + between them.
        short: whether it is a name for compositions alone, and no rule by itself.
    """

    name: str
    parts: str
    short: bool = False


class Engine(NamedTuple):
    """Takes steps of learning faster than torch's loop, with the same results.

    Attributes:
        name: of it.
        engine: `engine(compiles) -> metapp.learning.adjoint.Engine`, as of `fastest` there.
    """

    name: str
    engine: str


class Label(NamedTuple):
    """What a task is called, of which group it is (tasks that show the same), and its split where auto is asked for.

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


SPLIT = "Where the tasks belong. auto: of the sorted names, every fifth is a test task (80 give 64 + 16)."


class Converter(NamedTuple):
    """The command `metapp data NAME` of a format.

    Attributes:
        help: paragraphs and examples.
        noun: what one source is called, such as "MERL file".
        metavar, paths: of its arguments, and their help.
        options: its own.
        split_help: of --split, where files or names tell more than the general rule.
    """

    help: str
    noun: str
    metavar: str
    paths: str
    options: tuple[Option, ...] = ()
    split_help: str = SPLIT


class Format(NamedTuple):
    """A format of files that tasks come from.

    Attributes:
        name: of its command.
        app: the application whose tasks its files hold.
        module: of what finds and reads them, as `data_tools.formats.Files` says.
        inputs: what the files are, in words, for help and errors; "" where fits do not take them as INPUT.
        takes: what fits tell `read_task` of themselves: "size", px a side or rows of what the file becomes; "least",
            what smaller photos are enlarged to.
        options: that `read_task` takes as keywords.
        command: that converts files, if any.
    """

    name: str
    app: str
    module: str
    inputs: str = ""
    takes: tuple[str, ...] = ()
    options: tuple[Option, ...] = ()
    command: Converter | None = None

    def files(self) -> Any:
        """The module that finds and reads the files."""
        return module_of(self.module)

    def recognises(self, path: Path) -> bool:
        """Whether a path is of this format, or a folder with such files."""
        result: bool = self.files().recognises(path)
        return result

    def find(self, paths: Iterable[Path]) -> tuple[list[Path], list[str]]:
        """Sources, and a line for each file of a folder that is none; ValueError for a bad path."""
        result: tuple[list[Path], list[str]] = self.files().find(paths)
        return result

    def read(self, source: Path, arguments: Mapping[str, object]) -> Task:
        """Read one source, by those of the arguments of readers, by keyword, that the format takes."""
        return self.files().read_task(source, **self.taken(arguments))

    def taken(self, arguments: Mapping[str, object]) -> dict[str, Any]:
        """Those of the arguments of readers, by keyword, that the format takes."""
        takes = {*self.takes, *(keyword_of(option) for option in self.options)}
        return {key: arguments[key] for key in takes & arguments.keys()}

    def conversion(self, paths: list[Path], split: str, options: Mapping[str, object]) -> Conversion:
        """How files become tasks by the command's options; ValueError for bad paths."""
        assert self.command is not None
        files = self.files()
        if hasattr(files, "conversion"):
            made: Conversion = files.conversion(paths, split, **options)
            return made
        read = functools.partial(files.read_task, **options)
        notes = {"made_by": f"metapp data {self.name}", **options}
        return Conversion(self.app, self.command.noun, files.UNITS, files.find, read, notes)


class Export(NamedTuple):
    """A form that fits are written in for other programs.

    Attributes:
        name: the value of --export.
        apps: the applications whose fits are written in it.
        write: `write(app, theta, path)` for the parameters of one fit without a task axis, or, where `of_surface`,
            `write(surface, path, provenance)`; `path` has no suffix, its last part is the fit's name.
        of_surface: whether it is made of the flat surface that a fit is of.
        holds: the parameters that a file holds; a fit of another network is distilled into them first; () for what is
            made of what a fit evaluates to.
        needs: the module and the package of a library that is not always installed; () for none.
        help: what it is, in a few words.
    """

    name: str
    apps: tuple[str, ...]
    write: str
    of_surface: bool = False
    holds: tuple[str, ...] = ()
    needs: tuple[str, str] | tuple[()] = ()
    help: str = ""

    def missing(self) -> str:
        """One line about a library that is not installed; "" where nothing is missing."""
        if not self.needs or importlib.util.find_spec(self.needs[0]):
            return ""
        return f'--export {self.name} needs {self.needs[1]}: pip install "metapp[export]"'


class Merge(NamedTuple):
    """Makes one task of all INPUT photos, where its option is given.

    Attributes:
        app: the application.
        option: whose value says how.
        merge: `merge(paths, value, size=..., **options of the format) -> task`.
    """

    app: str
    option: Option
    merge: str


class InMemory(NamedTuple):
    """Takes objects of a program as inputs.

    Attributes:
        app: the application.
        task: `task(object, name, arguments) -> Task`; the arguments are those of readers by keyword, and `observe`.
    """

    app: str
    task: str


class SceneCheck(NamedTuple):
    """Checks scenes of data sets that are XML or name files; without one these are refused.

    Attributes:
        check: `check(scene) -> scene`, ValueError for something that a scene may not hold.
    """

    check: str


class Network(NamedTuple):
    """A network of an application that has several, told by a fit's parameters.

    Attributes:
        app: the application.
        network: what the application asks of a network.
    """

    app: str
    network: str


class Baselines(NamedTuple):
    """Methods without a network.

    Attributes:
        app: the application whose tasks they fit.
        names: the values of --method, of all protocols.
        baselines: `baselines(app) -> tuple of Baseline` under the application's protocol.
    """

    app: str
    names: tuple[str, ...]
    baselines: str


class Table(NamedTuple):
    """A table of `metapp evaluate`.

    Attributes:
        name: the value of --which.
        table: a `metapp.evaluation.rows.Table`.
    """

    name: str
    table: str


class Figure(NamedTuple):
    """A figure of what `metapp evaluate` has measured.

    Attributes:
        name: of its file.
        figure: `figure(subject) -> metapp.evaluation.style.Drawn`, or None where nothing was measured yet that
            it could show.
    """

    name: str
    figure: str


class Report(NamedTuple):
    """Files that `metapp evaluate` writes of what it has measured, where their option is given.

    Attributes:
        option: a path.
        write: `write(subjects, path, tables) -> files`, of tables by name.
    """

    option: Option
    write: str


class Command(NamedTuple):
    """A command.

    Attributes:
        name: as on the command line.
        command: a function whose parameters typer reads.
        under: the command that it belongs to, as "data"; "" for none.
        bare_is_help: whether it prints its help where nothing is given.
    """

    name: str
    command: str
    under: str = ""
    bare_is_help: bool = False


class Output(NamedTuple):
    """Something that a run makes of each task where its option is given.

    Attributes:
        app: the application.
        option: that asks for it.
        output: `output(presentation, task, theta, value) -> metapp.appearance.presentation.Rendered`.
        examples: as of the application, after its own.
    """

    app: str
    option: Option
    output: str
    examples: tuple[tuple[str, str], ...] = ()


class Watcher(NamedTuple):
    """Follows fits while they run, where its option is given.

    Attributes:
        option: that asks for it.
        watcher: `watcher(app, paradigm) -> metapp.runs.fits.fitter.Watching`.
    """

    option: Option
    watcher: str


class FitMethod(NamedTuple):
    """A method of fits in the Python API.

    Attributes:
        name: of the method.
        method: a function whose first argument is a `metapp.runs.api.Fit`.
    """

    name: str
    method: str


class Page(NamedTuple):
    """An application's part of interactive pages; without one they show its pictures.

    Attributes:
        app: the application.
        view: `view(presentation, theta, task, *, quick) -> metapp.extensions.viewer.view.View`: of a fit, `theta`
            without a task axis, of a task, without data where that is not at hand; `quick`: without what takes seconds.
            KeyError where the fit alone is not enough.
    """

    app: str
    view: str


class Plugin(NamedTuple):
    """A plugin for Mitsuba.

    Attributes:
        name: its type in scenes.
        register: a function that registers it, in the active variant and in all that will be.
        row: the name by which an integrator, which takes `max_depth` as `path` does, is compared in tables of pictures
            of transport; "" for none.
        note: what their captions say of it.
    """

    name: str
    register: str
    row: str = ""
    note: str = ""


class Synthetic(NamedTuple):
    """An embedded data set, drawn on first use.

    Attributes:
        app: the application of its tasks.
        module: that draws them, as `metapp.runs.inputs.embedded` says.
        help: a paragraph for `metapp data synth --help`.
        options: that `synthetic_tasks` takes as keywords.
        files: other forms that it can be written in: the value of --as, `write(folder, split, count, seed) -> names` of
            files as they are written, and a file's bytes.
    """

    app: str
    module: str
    help: str
    options: tuple[Option, ...] = ()
    files: tuple[tuple[str, str, int], ...] = ()
