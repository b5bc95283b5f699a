"""Tables of what metapp has, by name: applications, recipes, formats, exports, commands and more.

Entries are references "module:attribute", which are imported at first use, so that a command imports only what it
needs. An extension is a module that is cheap to import and has a function `register(registry) -> None`; an entry point
of the group "metapp.extensions" names the module or the function. The core is registered like an extension, by
`metapp.contents`, and extensions that ship by `metapp.extensions.contents`. Nothing here knows any entry by its name.
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

from typing_extensions import override

if TYPE_CHECKING:
    from metapp import contracts

ENTRY_POINT_GROUP = "metapp.extensions"  # group of the entry points that name extensions
CORE_MODULE = "metapp.contents"  # module that registers the core
WITHOUT_VARIABLE = "METAPP_WITHOUT"  # environment variable: names of extensions to leave out, separated by commas
METAPP_PACKAGE = "metapp"  # package whose extensions are registered first, and whose errors are raised

Value = TypeVar("Value")  # the type of a table's entries
Contract = TypeVar("Contract")  # the type of the object that an entry names


def load_reference(reference: str) -> Any:
    """Import what a reference names, and return it.

    Args:
        reference: "module:attribute", "module:TABLE.key" for the entry of a table, or "module".

    Raises:
        ImportError: there is no such module, attribute or entry, or an error ends the import.

    >>> load_reference("math:tau")
    6.283185307179586
    """
    name, _, path = reference.partition(":")
    try:
        found: Any = importlib.import_module(name)
        for part in path.split(".") if path else ():
            found = found[part] if isinstance(found, Mapping) else getattr(found, part)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise ImportError(f"{reference} cannot be loaded: {describe_error(error)}") from error
    return found


def describe_error(error: BaseException) -> str:
    """Return the type and the message of an error, in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


@dataclass(frozen=True)
class Entry(Generic[Contract]):
    """A reference to an object, with its help and conditions, which are known before it is imported.

    Attributes:
        reference: "module:attribute"; "module:TABLE.key" for an entry of a dictionary; "module" for the module itself.
        help: a few words that help texts and lists show; :class:`Registry` says for some tables what they are about.
        apps: the applications that the object is for, if the entry's key does not name one, as of measures.

    >>> Entry("math:gcd").load()(12, 18)
    6
    """

    reference: str
    help: str = ""
    apps: tuple[str, ...] = ()

    def load(self) -> Contract:
        """Import and return the object.

        Raises:
            ImportError: there is no such module or attribute, or an error ends the import.
        """
        loaded: Contract = load_reference(self.reference)
        return loaded


@dataclass(frozen=True, kw_only=True)
class Application(Entry[Any]):
    """The entry of an application: a reference to a subclass of `metapp.learning.app.App`.

    The entry's key is the application's name. Its recipes are entries of their own, and "quick" is one of them.

    Attributes:
        title: the name in tables and pictures.
        protocols: the values of --observe, the default first, each with the name of the tensor that fits observe; {} if
            there is only one protocol.
        options: a reference to the application's options, a dataclass that extends `metapp.options.AppOptions`.
        presenter: a reference to a subclass of `metapp.appearance.presenter.Presenter`; that class itself shows
            nothing.
        facts: a reference to a function `facts_of(tensors)` that returns facts about a task, by which a recipe is
            chosen. It gets tensors by name, or None in place of a tensor of which only the name is known, as in a data
            set. "" if no recipe depends on facts.
    """

    title: str
    protocols: Mapping[str, str] = field(default_factory=dict)
    options: str = "metapp.options:AppOptions"
    presenter: str = "metapp.appearance.presenter:Presenter"
    facts: str = ""


FactRange = bool | int | tuple[float, float]  # a value of a fact, or the least and the greatest value of a range


@dataclass(frozen=True, kw_only=True)
class RecipeEntry(Entry[Any]):
    """A reference to a `metapp.learning.recipe.Recipe`; `help` says which inputs the recipe suits.

    Attributes:
        suits: facts of inputs, each with its value or range; the recipe is chosen for inputs that have all of them,
            unless the user names a recipe. {} if the recipe is only used where it is named.
        mixed_recipe: the recipe that is chosen if a folder has inputs of which this recipe suits some but not all; ""
            if such folders are refused.
        paradigms: the paradigms for which the recipe is chosen; () for all.
        describe_missing_file: a reference to a function without arguments that returns a line about a file that the
            recipe needs and that is missing, or ""; "" if the recipe needs no file.
    """

    suits: Mapping[str, FactRange] = field(default_factory=dict)
    mixed_recipe: str = ""
    paradigms: tuple[str, ...] = ()
    describe_missing_file: str = ""


@dataclass(frozen=True, kw_only=True)
class Format(Entry[Any]):
    """A file format that tasks are read from: a reference to a module that finds and reads its files.

    The module has these names:

    - `recognises(path)`, for inputs of fits: returns whether a path is a file of the format, or a folder with such
      files, by suffixes and first bytes;
    - `find(path)`: returns a pair of lists: a `data_tools.readers.input_source.Source` for each task, with all that
      must be known before the task is read, and a line for each file of a folder that is skipped. It raises ValueError
      for a bad path. The caller fills in the fields `format`, `given` and `named` of a source;
    - `read_task(path, ...)`: returns the task; raises ValueError if the file is damaged. It may name keyword arguments,
      all with defaults. Fits pass those that it names of the arguments that :class:`metapp.contracts.ReadObject` lists,
      and `content`, which is the `content` of the source. The command "data NAME" passes its options and `content`;
    - `UNITS`, if there is a command "data NAME" (a `metapp.options.Converter`): units of the tasks' tensors by name;
    - `entries(paths, folders, split)`, optional, for that command: returns name, group and split of each task as a
      `metapp.storage.shards.ManifestEntry`, by the path of its source; sources without an entry are left out. `folders`
      are the folders that were searched, `split` is the command's option. By default a task is named by its file.

    Attributes:
        app: the application whose tasks the files hold.
        inputs: what the files are, in words, for help and errors; "" if fits do not accept them as INPUT, so that the
            module needs no `recognises`.
        data_sets: whether the command "data NAME" also accepts data sets.
    """

    app: str
    inputs: str = ""
    data_sets: bool = False


@dataclass(frozen=True, kw_only=True)
class Export(Entry[Any]):
    """A form in which fits are written for other programs: a reference to a function.

    The function is `write(app, theta, path)` for the parameters of one fit without a task axis. If `of_surface` is set,
    it is `write(surface, path, provenance)`. The path has no suffix, and its last part is the fit's name. See
    :class:`metapp.contracts.ExportParameters` and :class:`metapp.contracts.ExportSurface`.

    Attributes:
        of_surface: whether the function writes the flat surface of a fit instead of its parameters.
        holds: the names of the parameters that the form can hold; fits with another network are distilled into these
            first. () if the form is made of what any network evaluates to.
        needs: the module and the package of a library that the function needs and that is not always installed; ()
            for none.
    """

    of_surface: bool = False
    holds: tuple[str, ...] = ()
    needs: tuple[str, str] | tuple[()] = ()


@dataclass(frozen=True, kw_only=True)
class Command(Entry[Any]):
    """A reference to a command, with its place in help. A command whose entry has another type comes last in help.

    Attributes:
        position: the place among the commands in help; commands of equal positions stand in the order of their
            registration. Positions of commands that ship are ten apart, so that others fit between them.
    """

    position: int


class Entries(UserDict[Any, Value]):
    """A table of entries by name, or by several words such as an application and a name. Each key can be set once.

    Args:
        kind: the type of all entries.
        key_length: the number of words of a key; keys of several words are tuples.

    >>> commands = Entries(Entry)
    >>> commands["count"] = Entry("mine:count")
    >>> commands["count"] = Entry("mine:count_all")
    Traceback (most recent call last):
    ValueError: count: an entry of this name exists already
    """

    def __init__(self, kind: type[Value], key_length: int = 1) -> None:
        super().__init__()
        self.kind, self.key_length = kind, key_length

    @override
    def __setitem__(self, key: Any, value: Value) -> None:
        words = _key_words(key)
        if len(words) != self.key_length or not words[-1] or not all(isinstance(word, str) for word in words):
            raise TypeError(f"{key!r}: expected a name of {self.key_length} word(s)")
        if not isinstance(value, self.kind):
            raise TypeError(f"{_join_words(*words)}: a {type(value).__name__}, expected {self.kind.__name__}")
        if key in self:
            raise ValueError(f"{_join_words(*words)}: an entry of this name exists already")
        self.data[key] = value

    def of(self, *first_words: str) -> dict[str, Value]:
        """Return the entries whose keys begin with these words and have one more, by their last word."""
        return {_key_words(key)[-1]: value for key, value in self.items() if _key_words(key)[:-1] == first_words}


def _key_words(key: Any) -> tuple[str, ...]:
    """Return the words of a key."""
    return key if isinstance(key, tuple) else (key,)


def _join_words(*words: str) -> str:
    """Join words that are not empty by spaces."""
    return " ".join(filter(None, words))


class Registry:
    """Tables of entries, and which package filled them.

    Keys of a table are names, or pairs and triples that begin with an application's name. The type of a table's entries
    names their contract: what the object that an entry loads takes and returns. See :mod:`metapp.contracts`.

    Attributes:
        applications: applications by name.
        recipes: recipes by application, protocol ("" if there is only one) and name.
        networks: networks of an application that users do not choose, by application and name: the parameters of a fit
            tell which one they belong to. Of the applications that ship, brdf has such networks, objects of
            `metapp.apps.brdf.brdf_network.BrdfNetwork`.
        parts: parts of learned rules, in the order in which they act on a step. An entry loads a subclass of
            `metapp.learning.rules.Part`, or another function that makes a part; the key is the part's `name`.
        rules: learned rules, as names of parts and compositions that are joined by "+".
        compositions: further such texts, whose names may also be a piece of a longer composition; lists of choices show
            the names in `rules` alone.
        formats: formats of files. The command "data NAME" converts the files of the format NAME.
        objects: functions that make tasks of objects in memory, by application.
        synthetic: modules that draw embedded data sets, by application.
        merges: functions that make one task of all inputs, by application and by the name of an option of the
            application about INPUT, which calls for it.
        outputs: functions that make further pictures of a fit, by application and by the name of an option of the
            application about OUTPUT, which calls for them.
        exports: forms in which fits are written, by application and name.
        file_exports: forms in which files that are no fits are written; `help` says which files.
        pages: functions that make the viewer's pages of fits, by application.
        plugins: functions without arguments that register a plugin of Mitsuba, by the plugin's name. For an integrator
            `help` says what it does; for a BSDF `help` is empty, which is how the two are told apart.
        measures: measures of pictures by name. An entry loads a `metapp.appearance.picture_measures.PictureMeasure`;
            its `apps` are the applications whose pictures are measured, and `help` is the note in tables.
        baselines: functions that make baselines, by application and by the name of a baseline.
        tables: tables of `metapp evaluate`; `help` is the heading in a report.
        commands: commands by the words after `metapp`. An entry loads a function that typer reads or a group of typer;
            for "data FORMAT" it loads a subclass of `metapp.options.Converter`. Help lists a :class:`Command` by its
            position, and other entries after all of these.
        examples: commands that work as they are, by application: pairs of the words after `metapp`, in which {} is the
            folder of inputs, and of a line about what they produce.
        methods: functions that become methods of fits in the Python API.
        hooks: functions that the core calls if they are there: "steps" is a :class:`metapp.contracts.MakeSteps`,
            "outer_loop" a :class:`metapp.contracts.DescendOuterLoss`, "scene" a :class:`metapp.contracts.CheckScene`.
        owners: the package that registered a name, by table and name.
        extensions: the package of each extension, by the extension's name.
        problems: why some extensions cannot be used, by "NAME of PACKAGE".
    """

    def __init__(self) -> None:
        self.applications = Entries(Application)
        self.recipes = Entries(RecipeEntry, 3)
        self.networks: Entries[Entry[Any]] = Entries(Entry, 2)
        self.parts: Entries[Entry[Callable[[], contracts.Part]]] = Entries(Entry)
        self.rules = Entries(str)
        self.compositions = Entries(str)
        self.formats = Entries(Format)
        self.objects: Entries[Entry[contracts.ReadObject]] = Entries(Entry)
        self.synthetic: Entries[Entry[contracts.EmbeddedSet]] = Entries(Entry)
        self.merges: Entries[Entry[contracts.MergeInputs]] = Entries(Entry, 2)
        self.outputs: Entries[Entry[contracts.RenderFit]] = Entries(Entry, 2)
        self.exports = Entries(Export, 2)
        self.file_exports: Entries[Entry[contracts.ExportFiles]] = Entries(Entry)
        self.pages: Entries[Entry[contracts.ViewFit]] = Entries(Entry)
        self.plugins: Entries[Entry[Callable[[], None]]] = Entries(Entry)
        self.measures: Entries[Entry[Any]] = Entries(Entry)
        self.baselines: Entries[Entry[contracts.MakeBaselines]] = Entries(Entry, 2)
        self.tables: Entries[Entry[contracts.MakeTable]] = Entries(Entry)
        self.commands: Entries[Entry[Any]] = Entries(Entry)
        self.examples: Entries[Entry[Sequence[tuple[str, str]]]] = Entries(Entry)
        self.methods: Entries[Entry[contracts.FitMethod]] = Entries(Entry)
        self.hooks: Entries[Entry[Any]] = Entries(Entry)
        self.owners: dict[str, str] = {}
        self.extensions: dict[str, str] = {}
        self.problems: dict[str, str] = {}

    @override
    def __setattr__(self, name: str, value: object) -> None:
        if "problems" in vars(self):
            raise AttributeError(f"{name}: cannot be set; add entries to tables")
        super().__setattr__(name, value)

    def add(self, other: Registry, package: str) -> None:
        """Add all entries of another registry, or none if an error is raised.

        Args:
            other: the registry.
            package: the name of the package that filled it.

        Raises:
            ValueError: a name is registered already, or two recipes suit equal facts; the message names both packages.
        """
        new_owners: dict[str, str] = {}
        for table, key, entry in other.entries():
            names = [other.unique_name(table, key)]
            if isinstance(entry, RecipeEntry) and entry.suits:
                facts = ", ".join(f"{fact} {value}" for fact, value in sorted(entry.suits.items()))
                names.append(f"recipes of {_join_words(*key[:2])} for inputs of {facts}")
            for name in names:
                if owner := self.owners.get(name, new_owners.get(name)):
                    raise ValueError(f"{name}: registered by {package}, but {owner} has registered it already")
                new_owners[name] = package
        for table, key, entry in other.entries():
            getattr(self, table)[key] = entry
        self.owners.update(new_owners)

    def entries(self) -> Iterator[tuple[str, Any, Any]]:
        """Yield the name of the table, the key and the entry, for all entries."""
        for name, table in vars(self).items():
            if isinstance(table, Entries):
                yield from ((name, key, entry) for key, entry in table.items())

    @staticmethod
    def unique_name(table: str, key: Any) -> str:
        """Return the name that only one package may register for a table and a key.

        Parts, rules and compositions share their names, as users write all of them after --rule.
        """
        return _join_words("rules" if table in ("parts", "compositions") else table, *_key_words(key))

    def check(self) -> None:
        """Check that the modules of all entries exist, and that commands are functions.

        Raises:
            ImportError: a module is missing, or a command cannot be loaded.
            TypeError: a command is not a function.
        """
        for _, _, entry in self.entries():
            for name in ("reference", "options", "presenter", "describe_missing_file", "facts"):
                reference = getattr(entry, name, "")
                if reference and importlib.util.find_spec(reference.partition(":")[0]) is None:
                    raise ImportError(f"{reference}: no such module")
        for key, entry in self.commands.items():
            if not callable(entry.load()):
                raise TypeError(f"commands {key}: {entry.reference} is not a function")

    def load_table(self, table: str, *first_words: str) -> dict[str, Any]:
        """Load the objects of a table, by name, or of keys that begin with these words.

        Entries of other packages that cannot be loaded are left out with a warning.

        Raises:
            ImportError: an entry of metapp itself cannot be loaded.
        """
        objects = {}
        for name, entry in getattr(self, table).of(*first_words).items():
            try:
                objects[name] = entry.load()
            except ImportError as error:
                if (owner := self.owners[self.unique_name(table, (*first_words, name))]) == METAPP_PACKAGE:
                    raise
                warnings.warn(f"extension of {owner}: {error}; {name} is left out.", stacklevel=2)
        return objects


def registry() -> Registry:
    """Return the registry of all installed extensions, except those that METAPP_WITHOUT names.

    >>> registry().rules["meta-sgd"]
    'sgd'
    """
    return _build_registry(os.environ.get(WITHOUT_VARIABLE, ""))


@functools.cache
def _build_registry(without: str) -> Registry:
    """Build the registry of all extensions, except those that a value of METAPP_WITHOUT names."""
    result, left_out = Registry(), {name.strip() for name in without.split(",")}
    importlib.import_module(CORE_MODULE).register(core := Registry())
    result.add(core, METAPP_PACKAGE)
    points = [(_package_name(point.dist), point) for point in importlib.metadata.entry_points(group=ENTRY_POINT_GROUP)]
    points = [(package, point) for package, point in points if point.name not in left_out]
    for package, point in sorted(points, key=lambda pair: (pair[0] != METAPP_PACKAGE, pair[0], pair[1].value)):
        try:
            (point.load() if point.attr else point.load().register)(extension := Registry())
            if package != METAPP_PACKAGE:
                extension.check()
            result.add(extension, package)
            result.extensions[point.name] = package
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever the module of another package does, the rest of metapp works
            if package == METAPP_PACKAGE:
                raise
            result.problems[f"{point.name} of {package}"] = describe_error(error)
    return result


@functools.cache  # each access to a distribution's name parses its metadata
def _package_name(dist: importlib.metadata.Distribution | None) -> str:
    """Return the name of a distribution's package."""
    return (dist.name if dist else "") or "a package without a name"
