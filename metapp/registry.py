"""Tables by name of what there is: applications, recipes, formats, exports, commands and more.

An extension is a module that is cheap to import and has `register(registry) -> None`; an entry point of the group
"metapp.extensions" names the module. What it adds to the tables are entries: "module:attribute" of what does the work,
imported on first use. What ships with metapp registers in the same way, first.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import importlib
import importlib.metadata
import importlib.util
import os
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeVar

GROUP = "metapp.extensions"
WITHOUT = "METAPP_WITHOUT"  # environment variable: names of extensions to leave out, separated by commas
SHIPPED = "metapp"  # the distribution whose extensions come first
TRUSTED = (SHIPPED, PROGRAM := "this program")  # packages whose errors are raised
SPLIT = "Where the tasks belong. auto: of the sorted names, every fifth is a test task (80 give 64 + 16)."

Key = TypeVar("Key")
Value = TypeVar("Value")


def load(reference: str) -> Any:
    """The object of "module:attribute", the entry of "module:TABLE.key" or a module; it is imported now.

    Raises:
        ImportError: no such module, attribute or entry, or whatever ends the import.

    >>> load("math:tau")
    6.283185307179586
    """
    name, _, path = reference.partition(":")
    try:
        thing: Any = importlib.import_module(name)
        for part in path.split(".") if path else ():
            thing = thing[part] if isinstance(thing, Mapping) else getattr(thing, part)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise ImportError(f"{reference} cannot be loaded: {reason_of(error)}") from error
    return thing


def did_you_mean(word: str, names: Iterable[str]) -> str:
    """A question after an error about a word that is no name, where some names begin so or one is like it; else "".

    >>> did_you_mean("mreta", ["general", "meta"])
    " Did you mean 'meta'?"
    """
    choices = list(names)
    near = [name for name in choices if word and name.startswith(word)] or difflib.get_close_matches(word, choices, 1)
    return f" Did you mean {' or '.join(map(repr, near))}?" if near else ""


def reason_of(error: BaseException) -> str:
    """An error in one line.

    >>> reason_of(SystemExit(7))
    'SystemExit: 7'
    """
    return " ".join(f"{type(error).__name__}: {error}".split())


@dataclass(frozen=True)
class Entry:
    """The reference to an object, and what is known of it before it is imported.

    Attributes:
        reference: "module:attribute", or "module:TABLE.key".
        help: a few words.
        apps: the applications that it is for, where its key names none.

    >>> Entry("math:gcd").load()(12, 18)
    6
    """

    reference: str
    help: str = ""
    apps: tuple[str, ...] = ()

    def load(self) -> Any:
        """The object, imported now; ImportError as of `load`."""
        return load(self.reference)

    def references(self) -> list[str]:
        """All that the entry refers to: `reference`, and each "module:attribute" beside it."""
        texts = [getattr(self, each.name) for each in fields(self) if each.name not in ("reference", "help")]
        return [
            self.reference,
            *(text for text in texts if isinstance(text, str) and re.fullmatch(r"[\w.]+:[\w.]+", text)),
        ]


@dataclass(frozen=True, kw_only=True)
class Application(Entry):
    """An application: a subclass of `metapp.learning.app.App`.

    Attributes:
        protocols: the values of --observe, the default first; () where there is no choice.
        options: a dataclass, `metapp.options.AppOptions` with its own; None for none.
        kinds: tensors that only some of its tasks hold; the first that a task holds is its kind, and a recipe may be
            for one kind.
        examples: what follows `metapp` ({} stands for a folder of input files), and what that makes.
        files: the input files of the examples, `files(app, folder) -> paths written`; "" for none.
        needs_vgg: whether its fits read features of VGG.
    """

    protocols: tuple[str, ...] = ()
    options: type | None = None
    kinds: tuple[str, ...] = ()
    examples: tuple[tuple[str, str], ...] = ()
    files: str = ""
    needs_vgg: bool = False


@dataclass(frozen=True, kw_only=True)
class Recipe(Entry):
    """A `metapp.learning.recipe.Recipe`; `help` says what inputs of its kind have.

    Attributes:
        kind: the kind of inputs that take it where none is named; "" where it must be named.
        paradigms: those that take it so; () for all.
        lacks: a function `lacks() -> str` of what it needs on a machine and does not find, in a line; "" for none.
        checkpoints: the package whose folder <name> holds its checkpoints; "" for those that ship.
    """

    kind: str = ""
    paradigms: tuple[str, ...] = ()
    lacks: str = ""
    checkpoints: str = ""


@dataclass(frozen=True, kw_only=True)
class Format(Entry):
    """A format of files that tasks come from: a module that finds and reads them.

    The module has `find(paths)`, sources and a line for each file of a folder that is none, ValueError for a bad path;
    `read_task(source, ...)`, ValueError where it is damaged; of inputs of fits `recognises(path)`, True of a file of
    the format and of a folder with such files. Of a format with the command `metapp data NAME` it has UNITS, of the
    tasks' tensors by name, and, where places or names of sources tell more than the general rule, `entries(sources,
    folders, split)`: names, groups and splits as `metapp.storage.shards.Entry`, of all sources that are not left out.

    Attributes:
        help: of the command, paragraphs and examples; "" for no command.
        app: the application whose tasks its files hold.
        inputs: what the files are, in words, for help and errors; "" where fits do not take them as INPUT.
        takes: what fits tell `read_task` of themselves: "size", px a side or rows of what the file becomes; "least",
            what smaller photos are enlarged to; further names are keywords of `AppOptions.reading`.
        kinds: the kinds of its files, and the module's function `tells(path) -> bool` that says which are of the kind,
            the first that does; "" where all are.
        options: keywords of `read_task` that the command offers, a dataclass as of `metapp.options`; None for none.
        split_help: of the command's --split.
    """

    app: str
    inputs: str = ""
    takes: tuple[str, ...] = ()
    kinds: tuple[tuple[str, str], ...] = ()
    options: type | None = None
    split_help: str = SPLIT

    def taken(self, arguments: Mapping[str, object]) -> dict[str, object]:
        """Those of the arguments of readers, by keyword, that the format takes."""
        return {key: arguments[key] for key in set(self.takes) & arguments.keys()}


@dataclass(frozen=True, kw_only=True)
class Output(Entry):
    """Something that a run makes of each task where an option of the application asks for it.

    Attributes:
        examples: as of the application, after its own.
    """

    examples: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Synthetic(Entry):
    """An embedded data set, drawn on first use: a module as `metapp.runs.inputs.embedded` says.

    Attributes:
        options: names of options that `synthetic_tasks` takes as keywords.
        files: other forms that it can be written in: the value of --as, `write(folder, split, count, seed) -> names` of
            files as they are written, and a file's bytes.
    """

    options: tuple[str, ...] = ()
    files: tuple[tuple[str, str, int], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Export(Entry):
    """A form that fits are written in for other programs.

    A function `write(app, theta, path)` for the parameters of one fit without a task axis, or, where `of_surface`,
    `write(surface, path, provenance)`; `path` has no suffix, its last part is the fit's name.

    Attributes:
        of_surface: whether it is made of the flat surface that a fit is of.
        holds: the parameters that a file holds; a fit of another network is distilled into them first; () for what is
            made of what a fit evaluates to.
        needs: the module and the package of a library that is not always installed; () for none.
    """

    of_surface: bool = False
    holds: tuple[str, ...] = ()
    needs: tuple[str, str] | tuple[()] = ()


@dataclass(frozen=True, kw_only=True)
class Measure(Entry):
    """A measure of pictures of fits against their references, a row of the table `image`.

    A function `measure(compared) -> float` of a `metapp.learning.pictures.Compared`; NaN where it has none.

    Attributes:
        source: `source() -> str`, by which package and version; ValueError where that is missing. "" where metapp does.
        more_is_better: whether a higher value is better.
    """

    source: str = ""
    more_is_better: bool = False


@dataclass(frozen=True, kw_only=True)
class Plugin(Entry):
    """A plugin for Mitsuba: a function that registers it, in the active variant and in all that will be.

    Attributes:
        row: the name by which an integrator, which takes `max_depth` as `path` does, is compared in tables of pictures
            of transport, whose captions say `help` of it; "" for none.
    """

    row: str = ""


class Table(dict[Key, Value]):
    """Entries by name, or by the application and the name; a second one of a name is refused.

    >>> commands = Table(Entry)
    >>> commands["count"] = Entry("mine:count")
    >>> commands["count"] = Entry("mine:count_all")
    Traceback (most recent call last):
    ValueError: count: there is one of this name already
    """

    def __init__(self, kind: type[Value], words: int = 1) -> None:
        super().__init__()
        self.kind, self.words = kind, words

    def check(self, key: Key, value: Value) -> None:
        """TypeError for what cannot stand in the table."""
        words = key if isinstance(key, tuple) else (key,)
        if len(words) != self.words or not words[-1] or not all(isinstance(word, str) for word in words):
            raise TypeError(f"{key!r}: no name of {self.words} words")
        if not isinstance(value, self.kind):
            raise TypeError(f"{_line(key)}: a {type(value).__name__}, expected {self.kind.__name__}")

    def __setitem__(self, key: Key, value: Value) -> None:
        self.check(key, value)
        if key in self:
            raise ValueError(f"{_line(key)}: there is one of this name already")
        super().__setitem__(key, value)

    def of(self, *first: str) -> dict[str, Value]:
        """Those whose keys are these words and one more, by that."""
        return {key[-1]: value for key, value in self.items() if isinstance(key, tuple) and key[:-1] == first}


def _line(key: object) -> str:
    return " ".join(filter(None, key)) if isinstance(key, tuple) else str(key)


def _name(kind: str, key: object) -> str:
    return _line(("rules" if kind in ("parts", "compositions") else kind, _line(key)))  # which are named alike


class Registry:
    """The tables, and who filled them."""

    def __init__(self) -> None:
        self.applications = Table[str, Application](Application)
        # by application, protocol ("" where there is but one) and name
        self.recipes = Table[tuple[str, str, str], Recipe](Recipe, 3)
        # of applications that have several, told by a fit's parameters
        self.networks = Table[tuple[str, str], Entry](Entry, 2)
        # of learned rules, classes of `metapp.learning.rules.part.Part`, in the order in which they act on a step
        self.parts = Table[str, Entry](Entry)
        # rules, and what rules alone are composed of: names of parts and of others of these, with + between them
        self.rules = Table[str, str](str)
        self.compositions = Table[str, str](str)
        self.formats = Table[str, Format](Format)
        # by application, `task(object, name, **arguments) -> Task` of objects of a program; the arguments are those of
        # readers, and `observe`
        self.objects = Table[str, Entry](Entry)
        self.synthetic = Table[str, Synthetic](Synthetic)
        # by application and option, `merge(paths, value, **arguments of the format's reader) -> task` of all INPUT
        self.merges = Table[tuple[str, str], Entry](Entry, 2)
        # by application and option, `output(app, task, theta, value) -> metapp.learning.pictures.Rendered`
        self.outputs = Table[tuple[str, str], Output](Output, 2)
        # by application and name
        self.exports = Table[tuple[str, str], Export](Export, 2)
        # by kind, `write(path, kind, folder, quiet) -> paths` of files that are no run, which `help` names
        self.file_exports = Table[str, Entry](Entry)
        # of the viewer, by application, `view(app, theta, task) -> View`
        self.pages = Table[str, Entry](Entry)
        self.plugins = Table[str, Plugin](Plugin)
        self.measures = Table[str, Measure](Measure)
        # by application and method, `baselines(app) -> tuple of Baseline`, of one method or several
        self.baselines = Table[tuple[str, str], Entry](Entry, 2)
        # of `metapp evaluate`, a `metapp.evaluation.rows.Table`
        self.tables = Table[str, Entry](Entry)
        # functions that typer reads; of `metapp data` as "data NAME"
        self.commands = Table[str, Entry](Entry)
        # of fits in the Python API, functions whose first argument is a `metapp.runs.api.Fit`
        self.methods = Table[str, Entry](Entry)
        # `steps(rule, loss, theta, order, compiles=False) -> metapp.learning.adjoint.Steps`; None: torch's
        self.steps: Entry | None = None
        # `check(scene) -> scene` of scenes of data sets that are XML or name files; None: these are refused
        self.scene_check: Entry | None = None
        # names that the command line has by itself, as of `names`
        self.reserved: list[str] = []

        self.owners: dict[str, str] = {}  # packages by what `names` says
        self.extensions: dict[str, str] = {}  # packages by name of the extension
        self.left_out: dict[str, Registry] = {}  # by METAPP_WITHOUT, with what they would have registered
        self.problems: dict[str, str] = {}  # why extensions cannot be used, by "NAME of PACKAGE"

    def add_recipes(self, app: str, table: str, *names: str, protocols: tuple[str, ...] = ()) -> None:
        """Add recipes that a table "module:TABLE" holds by name, or by protocol and name."""
        for protocol in protocols or ("",):
            for name in names:
                place = f"{table}.{protocol}.{name}" if protocol else f"{table}.{name}"
                self.recipes[app, protocol, name] = Recipe(place)

    def add(self, other: Registry, package: str) -> None:
        """Take over all that another one holds, or nothing.

        Raises:
            ValueError: a name that is there already; two recipes for inputs of one kind. It names both packages.
            TypeError: something that is no entry.
        """
        new: dict[str, str] = {}
        for name in other.names():
            if name in self.owners or name in new:
                raise ValueError(f"{name}: of {package}, but there is one of {self.owners.get(name, package)} already")
            new[name] = package
        for kind, key, entry in other.entries():
            if key:
                getattr(self, kind)[key] = entry
            else:
                setattr(self, kind, entry)
        self.owners |= new

    def entries(self) -> Iterator[tuple[str, Any, Any]]:
        """The table, the key ("" of what there is but one of) and the entry of all; TypeError for what is no entry."""
        for kind, empty in vars(_EMPTY).items():
            table = getattr(self, kind)
            if not isinstance(table, Entry | None if empty is None else type(empty)):
                raise TypeError(f"{kind}: a {type(table).__name__}")
            if isinstance(table, Entry):
                yield kind, "", table
            elif isinstance(empty, Table):
                for key, entry in table.items():
                    empty.check(key, entry)
                    yield kind, key, entry

    def names(self) -> Iterator[str]:
        """What no two packages may have: names in tables, of commands, and kinds of inputs that recipes are for."""
        yield from self.reserved
        yield from (_name(kind, key) for kind, key, _ in self.entries())
        yield from (f"commands data {name}" for name, form in self.formats.items() if form.help)
        for (app, protocol, _), recipe in self.recipes.items():
            if recipe.kind:
                yield f"recipes of {app} for inputs of kind {_line((recipe.kind, protocol))}"

    def check_references(self) -> None:
        """Refuse entries of modules that are missing, and commands that are no functions.

        Raises:
            ImportError, TypeError: there is such a one.
        """
        for reference in (
            each for _, _, entry in self.entries() if isinstance(entry, Entry) for each in entry.references()
        ):
            if importlib.util.find_spec(reference.partition(":")[0]) is None:
                raise ImportError(f"{reference}: no such module")
        for name, entry in self.commands.items():
            if not callable(entry.load()):
                raise TypeError(f"commands {name}: {entry.reference} is no function")

    def loaded(self, kind: str, *first: str) -> dict[str, Any]:
        """The objects of a table, or of those whose keys begin with these words.

        What cannot be loaded is left out with a warning if it is of another package.

        Raises:
            ImportError: one of metapp's own cannot be loaded.
        """
        objects, table = {}, getattr(self, kind)
        for name, entry in (table.of(*first) if first else table).items():
            owner = self.owners[_name(kind, (*first, name))]
            try:
                objects[name] = entry.load()
            except ImportError as error:
                if owner in TRUSTED:
                    raise
                warnings.warn(f"extension of {owner}: {error}; {name} is left out.", stacklevel=2)
        return objects


Register = Callable[[Registry], None]
_EMPTY = Registry()
_added: list[tuple[str, Register]] = []  # by programs, for as long as `extended` says


def registry() -> Registry:
    """The registry of all installed extensions but those that METAPP_WITHOUT names.

    >>> registry().rules["meta-sgd"]
    'sgd'
    """
    return _built(os.environ.get(WITHOUT, ""), tuple(_added))


def left_out_with(kind: str, name: str) -> str:
    """The extension that METAPP_WITHOUT leaves out and whose table of a kind has this name; "" for none."""
    return next((each for each, part in registry().left_out.items() if name in getattr(part, kind)), "")


@contextlib.contextmanager
def extended(name: str, register: Register) -> Iterator[None]:
    """Have one more extension in this process, without a package, as tests and notebooks do."""
    _added.append((name, register))
    try:
        yield
    finally:
        _added.remove((name, register))


@functools.cache
def _built(without: str, added: tuple[tuple[str, Register], ...]) -> Registry:
    result, names = Registry(), {name.strip() for name in without.split(",")}
    points = [(_package(point), point) for point in importlib.metadata.entry_points(group=GROUP)]
    points.sort(key=lambda each: (each[0] != SHIPPED, each[0], each[1].value))
    extensions: list[tuple[str, str, Register]]
    extensions = [(point.name, package, functools.partial(_register, point.value)) for package, point in points]
    for name, package, register in [*extensions, *((name, PROGRAM, register) for name, register in added)]:
        trusted = package in TRUSTED
        part = Registry()
        try:
            register(part)
            if not trusted:
                part.check_references()
            if name not in names:
                result.add(part, package)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever a stranger's module does, the rest of metapp works
            if trusted:
                raise
            if name not in names:
                result.problems[f"{name} of {package}"] = reason_of(error)
                continue
            part = Registry()
        if name in names:
            result.left_out[name] = part
        else:
            result.extensions[name] = package
    return result


def _register(module: str, part: Registry) -> None:
    importlib.import_module(module).register(part)


def _package(point: importlib.metadata.EntryPoint) -> str:
    return (_name_of(point.dist) if point.dist else "") or "a package without a name"


@functools.cache  # each look at a name parses the package's metadata
def _name_of(package: importlib.metadata.Distribution) -> str:
    return package.name
