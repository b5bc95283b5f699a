"""Tables by name: applications, recipes, formats, exports, commands and more.

Their entries are references "module:attribute", imported at first use. An extension is a
module that is cheap to import and has `register(registry) -> None`, or such a function; an entry point of the group
"metapp.extensions" names it. `metapp.contents` has the core's entries, `metapp.extensions.contents` those of extensions
that ship.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import importlib.util
import os
import warnings
from collections import UserDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
    from metapp import contracts

ENTRY_POINT_GROUP, CORE_MODULE = "metapp.extensions", "metapp.contents"
WITHOUT_VARIABLE = "METAPP_WITHOUT"  # environment variable: names of extensions to leave out, separated by commas
METAPP_PACKAGE = "metapp"  # the package whose extensions come first, and whose errors are raised

Value = TypeVar("Value")
Contract = TypeVar("Contract")  # the type of the object that an entry names


def load_reference(reference: str) -> Any:
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
        raise ImportError(f"{reference} cannot be loaded: {describe_error(error)}") from error
    return thing


def describe_error(error: BaseException) -> str:
    """An error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


@dataclass(frozen=True)
class Entry(Generic[Contract]):
    """The reference to an object, with its help and conditions, which are known before it is imported.

    Attributes:
        reference: "module:attribute", or "module:TABLE.key".
        help: a few words.
        apps: the applications that it is for, if its key names none.

    >>> Entry("math:gcd").load()(12, 18)
    6
    """

    reference: str
    help: str = ""
    apps: tuple[str, ...] = ()

    def load(self) -> Contract:
        """Import and return the object.

        Raises:
            ImportError: there is no such module or attribute, or the import fails.
        """
        named: Contract = load_reference(self.reference)
        return named


@dataclass(frozen=True, kw_only=True)
class Application(Entry[Any]):
    """An application: a subclass of `metapp.learning.app.App`.

    Attributes:
        title: its name in tables and pictures.
        protocols: the values of --observe, the default first, each with the tensor that fits see; {} if there is no
            choice.
        options: "module:attribute" of its own, a dataclass that extends `metapp.options.AppOptions`.
        presenter: "module:attribute" of its subclass of `metapp.appearance.presenter.Presenter`, which shows nothing.
        facts: "module:function" of what tensors of a task tell, `facts_of(tensors)` with None for those whose names
            alone are known, as of data sets; recipes are chosen by it. "" for nothing.
    """

    title: str
    protocols: Mapping[str, str] = field(default_factory=dict)
    options: str = "metapp.options:AppOptions"
    presenter: str = "metapp.appearance.presenter:Presenter"
    facts: str = ""


FactRange = bool | int | tuple[float, float]  # the value of a fact, or its least and greatest one


@dataclass(frozen=True, kw_only=True)
class RecipeEntry(Entry[Any]):
    """A `metapp.learning.recipe.Recipe`; `help` says in words what inputs have that it suits.

    Attributes:
        suits: facts of the inputs that take it if none is named, each with its value or range; {} if it must be named.
        mixed: the recipe for all inputs of folders in which it suits some and not all; "" if these are refused.
        paradigms: those that take it so; () for all.
        lacks: a function `lacks() -> str`, a line that names a file it needs and does not find; "" for none.
    """

    suits: Mapping[str, FactRange] = field(default_factory=dict)
    mixed: str = ""
    paradigms: tuple[str, ...] = ()
    lacks: str = ""


@dataclass(frozen=True, kw_only=True)
class Format(Entry[Any]):
    """A format of files that tasks come from: a module that finds and reads them.

    The module has these names:

    - `recognises(path)`, of inputs of fits: True for a file of the format and for a folder with such files, by suffixes
      and first bytes;
    - `find(path)`: a `data_tools.readers.input_source.Source` for each task, with all that is to be known before it is read,
      and a message for each skipped file of a folder; ValueError for a bad path;
    - `read_task(path, ...)`: the task; ValueError if the source is damaged. Fits pass the parameters that it names,
      among them `content`, what `find` has parsed already;
    - `UNITS`, if the command "data NAME" (a `metapp.options.Converter`) converts files: units of tensors by name;
    - `entries(paths, folders, split)`, optional: names, groups and splits as `metapp.storage.shards.ManifestEntry`, of all
      paths of sources that are not left out.

    Attributes:
        app: the application whose tasks its files hold.
        inputs: the files in words, for help and errors; "" if fits do not take them as INPUT.
        data_sets: whether its command "data NAME" takes data sets, too.
    """

    app: str
    inputs: str = ""
    data_sets: bool = False


@dataclass(frozen=True, kw_only=True)
class Export(Entry[Any]):
    """A form that fits are written in for other programs.

    A function `write(app, theta, path)` for the parameters of one fit without a task axis, or, if `of_surface`,
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


class Entries(UserDict[Any, Value]):
    """Entries by name, or by several words such as the application and the name; each name is given once.

    >>> commands = Entries(Entry)
    >>> commands["count"] = Entry("mine:count")
    >>> commands["count"] = Entry("mine:count_all")
    Traceback (most recent call last):
    ValueError: count: there is one of this name already
    """

    def __init__(self, kind: type[Value], key_length: int = 1) -> None:
        super().__init__()
        self.kind, self.key_length = kind, key_length

    def __setitem__(self, key: Any, value: Value) -> None:
        words = _words(key)
        if len(words) != self.key_length or not words[-1] or not all(isinstance(word, str) for word in words):
            raise TypeError(f"{key!r}: no name of {self.key_length} words")
        if not isinstance(value, self.kind):
            raise TypeError(f"{_line(*words)}: a {type(value).__name__}, expected {self.kind.__name__}")
        if key in self:
            raise ValueError(f"{_line(*words)}: there is one of this name already")
        self.data[key] = value

    def of(self, *first: str) -> dict[str, Value]:
        """Entries whose keys are these words and one more, by the last one."""
        return {_words(key)[-1]: value for key, value in self.items() if _words(key)[:-1] == first}


def _words(key: Any) -> tuple[str, ...]:
    return key if isinstance(key, tuple) else (key,)


def _line(*words: str) -> str:
    return " ".join(filter(None, words))


class Registry:
    """Tables of entries, and who filled them.

    The keys of a table are names unless a comment says more. The type of a table's entries names their contract: what
    the object that an entry loads takes and gives. See :mod:`metapp.contracts`.

    Attributes:
        owners: packages by table and name.
        extensions: packages by name of the extension.
        problems: why extensions cannot be used, by "NAME of PACKAGE".
    """

    def __init__(self) -> None:
        self.applications = Entries(Application)
        self.recipes = Entries(RecipeEntry, 3)  # by application, protocol ("" where there is but one) and name
        self.networks: Entries[Entry[Any]] = Entries(Entry, 2)  # by application and name: parameters tell the right one
        # parts of learned rules, in the order in which they act on a step; rules and short names of compositions are
        # names joined by +, of which rules alone are offered
        self.parts: Entries[Entry[Callable[[], contracts.Part]]] = Entries(Entry)
        self.rules = Entries(str)
        self.compositions = Entries(str)
        self.formats = Entries(Format)
        self.objects: Entries[Entry[contracts.ReadObject]] = Entries(Entry)  # by application
        self.synthetic: Entries[Entry[contracts.EmbeddedSet]] = Entries(Entry)  # by application
        self.merges: Entries[Entry[contracts.MergeInputs]] = Entries(Entry, 2)  # by application and option
        self.outputs: Entries[Entry[contracts.RenderFit]] = Entries(Entry, 2)  # by application and option
        self.exports = Entries(Export, 2)  # by application and name
        self.file_exports: Entries[Entry[contracts.ExportFiles]] = Entries(Entry)  # `help` says of which files
        self.pages: Entries[Entry[contracts.ViewFit]] = Entries(Entry)  # by application
        # plugins of Mitsuba: functions that register one; of integrators `help` says what they do
        self.plugins: Entries[Entry[Callable[[], None]]] = Entries(Entry)
        self.measures: Entries[Entry[Any]] = Entries(Entry)  # a `metapp.appearance.picture_measures.PictureMeasure`
        self.baselines: Entries[Entry[contracts.MakeBaselines]] = Entries(Entry, 2)  # by application and method
        self.tables: Entries[Entry[contracts.MakeTable]] = Entries(Entry)  # of `metapp evaluate`; `help` is the heading
        # a function that typer reads, or a group of typer; of "data FORMAT" a subclass of `metapp.options.Converter`
        self.commands: Entries[Entry[Any]] = Entries(Entry)
        # by application: pairs of words after `metapp`, in which {} is the folder of inputs, and of what they give
        self.examples: Entries[Entry[Sequence[tuple[str, str]]]] = Entries(Entry)
        self.methods: Entries[Entry[contracts.FitMethod]] = Entries(Entry)  # of fits in the Python API
        self.hooks: Entries[Entry[Any]] = Entries(Entry)  # "steps": `contracts.MakeSteps`, "scene": `CheckScene`
        self.owners: dict[str, str] = {}
        self.extensions: dict[str, str] = {}
        self.problems: dict[str, str] = {}

    def __setattr__(self, name: str, value: object) -> None:
        if "problems" in vars(self):
            raise AttributeError(f"{name}: cannot be set; add entries to tables")
        super().__setattr__(name, value)

    def add(self, other: Registry, package: str) -> None:
        """Take over all that another one holds, or nothing.

        Raises:
            ValueError: a name that is there already; two recipes that suit the same facts. It names both packages.
        """
        new: dict[str, str] = {}
        for table, key, entry in other.entries():
            names = [other.unique_name(table, key)]
            if isinstance(entry, RecipeEntry) and entry.suits:
                facts = ", ".join(f"{fact} {wanted}" for fact, wanted in sorted(entry.suits.items()))
                names.append(f"recipes of {_line(*key[:2])} for inputs of {facts}")
            for name in names:
                if owner := self.owners.get(name, new.get(name)):
                    raise ValueError(f"{name}: of {package}, but there is one of {owner} already")
                new[name] = package
        for table, key, entry in other.entries():
            getattr(self, table)[key] = entry
        self.owners.update(new)

    def entries(self) -> Iterator[tuple[str, Any, Any]]:
        """The table, the key and the entry of all."""
        for name, table in vars(self).items():
            if isinstance(table, Entries):
                yield from ((name, key, entry) for key, entry in table.items())

    @staticmethod
    def unique_name(table: str, key: Any) -> str:
        """The name that one package alone may have: of rules and their compositions it is "rules NAME"."""
        return _line("rules" if table in ("parts", "compositions") else table, *_words(key))

    def check(self) -> None:
        """Refuse entries of modules that are missing, and commands that are no functions.

        Raises:
            ImportError, TypeError: there is such a one.
        """
        for _, _, entry in self.entries():
            for name in ("reference", "options", "presenter", "lacks", "facts"):
                reference = getattr(entry, name, "")
                if reference and importlib.util.find_spec(reference.partition(":")[0]) is None:
                    raise ImportError(f"{reference}: no such module")
        for key, entry in self.commands.items():
            if not callable(entry.load()):
                raise TypeError(f"commands {key}: {entry.reference} is no function")

    def load_table(self, table: str, *first: str) -> dict[str, Any]:
        """The objects of a table, or of keys that begin with these words; ImportError as of `load_reference`.

        Entries that another package has, or that cannot be loaded, are left out with a warning.
        """
        objects = {}
        for name, entry in getattr(self, table).of(*first).items():
            try:
                objects[name] = entry.load()
            except ImportError as error:
                if (owner := self.owners[self.unique_name(table, (*first, name))]) == METAPP_PACKAGE:
                    raise
                warnings.warn(f"extension of {owner}: {error}; {name} is left out.", stacklevel=2)
        return objects


def registry() -> Registry:
    """The registry of all installed extensions but those that METAPP_WITHOUT names.

    >>> registry().rules["meta-sgd"]
    'sgd'
    """
    return _built(os.environ.get(WITHOUT_VARIABLE, ""))


@functools.cache
def _built(without: str) -> Registry:
    result, names = Registry(), {name.strip() for name in without.split(",")}
    importlib.import_module(CORE_MODULE).register(core := Registry())
    result.add(core, METAPP_PACKAGE)
    points = [(_package(point.dist), point) for point in importlib.metadata.entry_points(group=ENTRY_POINT_GROUP)]
    points = [(package, point) for package, point in points if point.name not in names]
    for package, point in sorted(points, key=lambda each: (each[0] != METAPP_PACKAGE, each[0], each[1].value)):
        try:
            (point.load() if point.attr else point.load().register)(part := Registry())
            if package != METAPP_PACKAGE:
                part.check()
            result.add(part, package)
            result.extensions[point.name] = package
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever a stranger's module does, the rest of metapp works
            if package == METAPP_PACKAGE:
                raise
            result.problems[f"{point.name} of {package}"] = describe_error(error)
    return result


@functools.cache  # each look at a name parses the package's metadata
def _package(dist: importlib.metadata.Distribution | None) -> str:
    return (dist.name if dist else "") or "a package without a name"
