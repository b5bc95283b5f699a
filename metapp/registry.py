"""The registry: one object with all that metapp has by name, from applications to commands.

Entries are references, which are imported at first use, so that a command imports only what it needs. An extension is a
module that is cheap to import and has a function `register(registry) -> None`; an entry point of the group
"metapp.extensions" names the module or the function. The core registers itself by `metapp.contents`, and extensions
that ship by `metapp.extensions.contents`. Classes here that are a `typing.Protocol` are contracts of entries; contracts
of what belongs to one application are in `metapp.application`. Contracts that are base classes are elsewhere:
`metapp.learning.app.App`, `metapp.appearance.presenter.Presenter`, `metapp.learning.rules.Part` and
`metapp.extensions.baselines.baseline.Baseline`.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import importlib.util
import math
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, Protocol

from metapp.application import Application, Export, Format, RecipeEntry, ViewFit
from metapp.entries import Lazy, describe_error, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from metapp.learning.adjoint import Loss, Steps, UpdateRule
    from metapp.learning.rules import LearnedRule
    from metapp.learning.task import Params

    SceneDict = dict[str, Any]  # a scene of Mitsuba as JSON holds it

METAPP_PACKAGE = "metapp"  # the package whose entries must be there; entries of other packages may be left out
ENTRY_POINT_GROUP = "metapp.extensions"  # group of the entry points that name extensions
CORE_MODULE = "metapp.contents"  # module that registers the core
WITHOUT_VARIABLE = "METAPP_WITHOUT"  # environment variable: names of extensions to leave out, separated by commas


# Entries of the registry's tables, each beside its contract


class ExportFiles(Protocol):
    """A function for `metapp export` of files that are no fits: it writes them in another form.

    >>> def write(path, kind, folder, quiet):
    ...     target = folder / f"{path.stem}.{kind}"
    ...     target.write_bytes(path.read_bytes())
    ...     return [target]
    """

    def __call__(self, path: Path, kind: str, folder: Path, quiet: bool, /) -> Iterable[Path]:
        """Write a file, or the files of a folder, in the form, and return the paths that were written.

        Args:
            path: the file or folder.
            kind: the form, which is the entry's key.
            folder: the folder to write to; it may not exist yet.
            quiet: whether to show no progress.

        Raises:
            ValueError: no file can be written in this form, a file is damaged, or a target exists already.
        """
        ...


@dataclass(frozen=True)
class FileExport(Lazy[ExportFiles]):
    """A form in which `metapp export` writes files that are no fits.

    Attributes:
        files: which files these are, for help.
    """

    files: str = ""


class MakeTable(Protocol):
    """A function that makes a table of `metapp evaluate`.

    >>> from metapp.evaluation.table import Table
    >>> def counts(evaluation):
    ...     return Table(evaluation.title, "Tasks", (), [{"tasks": len(evaluation.tasks)}])
    """

    def __call__(self, evaluation: Any, /) -> Any:
        """Return the :class:`metapp.evaluation.table.Table` of an application, without rows if none apply.

        Args:
            evaluation: a :class:`metapp.evaluation.evaluation_run.EvaluationRun`: the application, its tasks and
                runs; it makes the fits that the table asks for.
        """
        ...


@dataclass(frozen=True)
class TableEntry(Lazy[MakeTable]):
    """A table of `metapp evaluate`.

    Attributes:
        heading: the heading of the table in a report.
    """

    heading: str = ""


class FitMethod(Protocol):
    """A function that becomes a method of fits in the Python API, under the name of the entry's key.

    >>> def first_word(fit):
    ...     return fit.name.split("-")[0]
    """

    def __call__(self, fit: Any, /, *arguments: Any, **keywords: Any) -> object:
        """Return the result of the method.

        Args:
            fit: a :class:`metapp.runs.fit.Fit`.
            *arguments, **keywords: the further arguments of the method's call.
        """
        ...


class MakeSteps(Protocol):
    """A function that makes the steps of a rule down a loss, faster than torch where it can; the hook `steps`.

    >>> from metapp.learning.adjoint import torch_steps
    >>> def steps(rule, loss, theta, order, *, compiles=False):
    ...     return torch_steps(rule, loss, theta, order)
    """

    def __call__(self, rule: UpdateRule, loss: Loss, theta: Params, order: int, /, *, compiles: bool = False) -> Steps:
        """Return steps with the results of :func:`metapp.learning.adjoint.torch_steps`, up to rounding.

        Args:
            rule: the rule with its hyperparameters.
            loss: the loss of the tasks.
            theta: parameters [T, ...] with the shapes that steps will see; their values are not read.
            order: 2 differentiates the gradient of a step in the vector-Jacobian product, 1 treats it as a constant.
            compiles: whether the steps are so many that compiling code for them pays.
        """
        ...


class CheckScene(Protocol):
    """A function that checks the scene of a data set before Mitsuba loads it; the hook `scene`.

    >>> def check(scene):
    ...     if "xml" in scene:
    ...         raise ValueError("a scene in XML, expected a dictionary.")
    ...     return scene
    """

    def __call__(self, scene: SceneDict, /) -> SceneDict:
        """Return the scene, in which nothing is left that Mitsuba may not load.

        Args:
            scene: a dictionary of type "scene", as JSON holds it.

        Raises:
            ValueError: the scene holds a plugin or a file that scenes of data sets may not hold.
        """
        ...


@dataclass(frozen=True)
class Command(Lazy[Any]):
    """A command: a function that typer reads, a group of typer, or for "data FORMAT" a `metapp.options.Converter`.

    Attributes:
        position: the place among the commands in help; commands of equal positions stand in the order of their
            registration. Positions of commands that ship are ten apart, so that others fit between them.
    """

    position: float = math.inf


@dataclass(frozen=True)
class Measure(Lazy[Any]):
    """A measure of pictures, a reference to a :class:`metapp.appearance.picture_measures.PictureMeasure`.

    Attributes:
        note: what the measure is, as tables state it.
        apps: the names of the applications whose pictures are measured.
    """

    note: str = ""
    apps: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plugin(Lazy[Callable[[], None]]):
    """A plugin of Mitsuba, a reference to a function that registers it.

    Attributes:
        integrator: what the plugin does if it is an integrator; "" for a BSDF.
    """

    integrator: str = ""


KINDS: dict[str, type] = {  # the type of the entries of a table by its name; of all others Lazy
    "applications": Application,
    "commands": Command,
    "exports": Export,
    "file_exports": FileExport,
    "formats": Format,
    "measures": Measure,
    "plugins": Plugin,
    "recipes": RecipeEntry,
    "tables": TableEntry,
}
KEYS_OF_PAIRS = {"exports": "a pair of names", "recipes": "a name or a pair of names"}  # tables with such keys
HOOKS = ("steps", "scene")  # the names that hooks may have: those that the core calls


@dataclass(frozen=True)
class Registry:
    """Tables of entries by name, each of which can be set once.

    Attributes:
        applications: applications by name; each has tables of its own.
        rules: learned rules, each a :class:`metapp.learning.rules.LearnedRule` of the name that is its key.
        exports: forms in which assets are written, by pairs of the name of the asset's type and of the form.
        pages: functions that make the viewer's page of a fit, by the name of the type of its asset; fits with other
            assets have a page of their pictures.
        file_exports: forms in which files are written that are no fits.
        plugins: plugins of Mitsuba.
        measures: measures of pictures.
        tables: tables of `metapp evaluate`.
        commands: commands by the words after `metapp`.
        methods: functions that become methods of fits in the Python API.
        hooks: functions that the core calls if an extension sets them: `steps` makes the steps of fits and of outer
            loops, a :class:`MakeSteps`; `scene` checks the scenes of data sets, a :class:`CheckScene`.
        extensions: the package of each extension, by the extension's name.
        owners: the package of each entry that another package than metapp has set, by the title of its table and its
            key.
        problems: why some extensions cannot be used, by "NAME of PACKAGE".

    >>> registry().rules["meta-sgd"]
    Lazy(reference='metapp.learning.rules.named_rules:META_SGD')
    """

    applications: dict[str, Application] = field(default_factory=dict)
    rules: dict[str, Lazy[LearnedRule]] = field(default_factory=dict)
    exports: dict[tuple[str, str], Export] = field(default_factory=dict)
    pages: dict[str, Lazy[ViewFit]] = field(default_factory=dict)
    file_exports: dict[str, FileExport] = field(default_factory=dict)
    plugins: dict[str, Plugin] = field(default_factory=dict)
    measures: dict[str, Measure] = field(default_factory=dict)
    tables: dict[str, TableEntry] = field(default_factory=dict)
    commands: dict[str, Command] = field(default_factory=dict)
    methods: dict[str, Lazy[FitMethod]] = field(default_factory=dict)
    hooks: dict[str, Lazy[Any]] = field(default_factory=dict)
    extensions: dict[str, str] = field(default_factory=dict)
    owners: dict[tuple[str, Any], str] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)

    def add(self, application: Application) -> None:
        """Add an application under its name."""
        self.applications[application.name] = application

    def application(self, name: str) -> Application:
        """Return the application of a name.

        Raises:
            ValueError: there is no application of that name; the message lists all names.

        >>> registry().application("illumination").title
        'Illumination'
        """
        if name not in self.applications:
            names = sorted(self.applications)
            raise ValueError(
                f"'{name}' is not an application; expected one of {', '.join(names)}.{did_you_mean(name, names)}"
            )
        return self.applications[name]

    @property
    def embedded_apps(self) -> list[str]:
        """The names of the applications that have an embedded data set, sorted."""
        return sorted(name for name, application in self.applications.items() if application.synthetic)

    def find_format(self, name: str) -> tuple[Application, Format]:
        """Return the format of a name, and the application whose tasks its files hold.

        Raises:
            KeyError: there is no such format.

        >>> registry().find_format("merl")[0].name
        'brdf'
        """
        for application in self.applications.values():
            if name in application.formats:
                return application, application.formats[name]
        raise KeyError(name)

    def exports_of(self, application: Application) -> dict[str, tuple[str, Export]]:
        """Return the forms in which fits of an application are written, sorted by name.

        Returns:
            By the name of the form, the name of the type of asset that it holds, and the form.

        >>> registry().exports_of(registry().applications["texture"])["exr"][0]
        'texture'
        """
        forms = {name: (asset, entry) for (asset, name), entry in self.exports.items() if asset in application.assets}
        return dict(sorted(forms.items()))

    def all_tables(self) -> dict[str, dict[Any, Any]]:
        """Return all tables by title, such as "commands" and "recipes of brdf", and the fields of applications."""
        kept = ("extensions", "owners", "problems")
        result = {name: table for name, table in vars(self).items() if name not in kept}
        for name, application in self.applications.items():
            attributes = vars(application)
            result |= {f"{key} of {name}": table for key, table in attributes.items() if isinstance(table, dict)}
            result[f"fields of {name}"] = attributes
        return result

    def owner(self, title: str, key: object) -> str:
        """Return the package that has set an entry.

        Args:
            title: the title of its table, see :meth:`all_tables`.
            key: its name.
        """
        return self.owners.get((title, key), METAPP_PACKAGE)

    def load_all(self, title: str) -> dict[Any, Any]:
        """Load the objects of all entries of a table, by name.

        Entries of other packages that cannot be loaded are left out with a warning.

        Args:
            title: the title of the table, see :meth:`all_tables`.

        Raises:
            ImportError: an entry of metapp itself cannot be loaded.
        """
        objects = {}
        for name, entry in self.all_tables()[title].items():
            try:
                objects[name] = entry.load()
            except ImportError as error:
                if (owner := self.owner(title, name)) == METAPP_PACKAGE:
                    raise
                warnings.warn(f"extension of {owner}: {error}; {name} is left out.", stacklevel=2)
        return objects


def registry() -> Registry:
    """Return the registry of all installed extensions, except those that METAPP_WITHOUT names."""
    return _build_registry(os.environ.get(WITHOUT_VARIABLE, ""))


@functools.cache
def _build_registry(without: str) -> Registry:
    """Build the registry of all extensions, except those that a value of METAPP_WITHOUT names."""
    result, left_out = Registry(), {name.strip() for name in without.split(",")}
    importlib.import_module(CORE_MODULE).register(result)
    points = [(_package_name(point.dist), point) for point in importlib.metadata.entry_points(group=ENTRY_POINT_GROUP)]
    points = [(package, point) for package, point in points if point.name not in left_out]
    for package, point in sorted(points, key=lambda pair: (pair[0] != METAPP_PACKAGE, pair[0], pair[1].value)):
        is_of_others = package != METAPP_PACKAGE
        before = {title: (table, dict(table)) for title, table in result.all_tables().items()} if is_of_others else {}
        try:
            (point.load() if point.attr else point.load().register)(result)
            if is_of_others:
                _check_entries(package, result, {title: entries for title, (_, entries) in before.items()})
            result.extensions[point.name] = package
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever the module of another package does, the rest of metapp works
            if not is_of_others:
                raise
            for table, entries in before.values():
                table.clear()
                table.update(entries)
            result.problems[f"{point.name} of {package}"] = describe_error(error)
    return result


def _check_entries(package: str, registry: Registry, before: Mapping[str, Mapping[Any, Any]]) -> None:
    """Check the entries that a package has added, and note that they are the package's.

    Args:
        package: the name of the package.
        registry: the registry, with the entries.
        before: all tables as they were without the package, by title.

    Raises:
        ImportError: a module is missing, or a command cannot be loaded.
        TypeError: an entry has another type than its table holds, its key is no name, or a command is no function.
        ValueError: an entry has been there before, a hook or a field does not exist, or two recipes suit equal facts.
    """
    new: dict[tuple[str, Any], str] = {}
    for title, table in registry.all_tables().items():
        earlier = before.get(title, {})
        for key, entry in table.items():
            if earlier.get(key) is entry or entry is None:
                continue
            if earlier.get(key) is not None:
                owner = registry.owner(title, key)
                words = " ".join((title, *(key if isinstance(key, tuple) else (key,))))
                raise ValueError(f"{words}: registered by {package}, but {owner} has registered it already")
            _check_entry(title, key, entry)
            for reference in _references_in(entry):
                if importlib.util.find_spec(reference.partition(":")[0]) is None:
                    raise ImportError(f"{reference}: no such module")
            if title == "commands" and not callable(entry.load()):
                raise TypeError(f"commands {key}: {entry.reference} is not a function")
            new[title, key] = package
    for application in registry.applications.values():
        _require_different_inputs(application, {**registry.owners, **new})
    registry.owners.update(new)


def _check_entry(title: str, key: Any, entry: object) -> None:
    """Check the name and the type of an entry.

    Args:
        title: the title of its table.
        key: its name.
        entry: the entry.

    Raises:
        TypeError: the key is no name, or the entry has another type.
        ValueError: there is no such hook, or no such field of an application.
    """
    name = title.split()[0]
    may_be_pair = name in KEYS_OF_PAIRS and isinstance(key, tuple) and len(key) == 2
    words = key if may_be_pair else (key,)
    if not all(isinstance(word, str) and word for word in words) or (name == "exports" and not may_be_pair):
        raise TypeError(f"{title} {key!r}: expected {KEYS_OF_PAIRS.get(name, 'a name')}")
    names = {"hooks": HOOKS, "fields": [field.name for field in fields(Application)]}.get(name, [key])
    if key not in names:
        raise ValueError(f"{title} {key}: expected one of {', '.join(names)}")
    kind = KINDS.get(name, Lazy)
    if name != "fields" and not isinstance(entry, kind):
        raise TypeError(f"{' '.join((title, *words))}: a {type(entry).__name__}, expected {kind.__name__}")


def _references_in(entry: object) -> Iterator[str]:
    """Yield the references of an entry: its own, and those in its fields."""
    if isinstance(entry, Lazy):
        yield entry.reference
    for item in fields(entry) if is_dataclass(entry) else ():
        if isinstance(value := getattr(entry, item.name), Lazy):
            yield from _references_in(value)


def _require_different_inputs(application: Application, owners: Mapping[tuple[str, Any], str]) -> None:
    """Refuse two recipes that would be chosen for inputs of equal facts.

    Args:
        application: the application.
        owners: the packages of entries, see :class:`Registry`.

    Raises:
        ValueError: there are two; the message names the packages that registered them.
    """
    registered: dict[str, str] = {}
    for (observation, _, entry), key in zip(application.named_recipes(), application.recipes, strict=True):
        owner = owners.get((f"recipes of {application.name}", key), METAPP_PACKAGE)
        if entry.suits:
            facts = ", ".join(f"{fact} {value}" for fact, value in sorted(entry.suits.items()))
            words = (f"recipes of {application.name}", observation, f"for inputs of {facts}")
            subject = " ".join(filter(None, words))
            if subject in registered:
                raise ValueError(
                    f"{subject}: registered by {owner}, but {registered[subject]} has registered it already"
                )
            registered[subject] = owner


@functools.cache  # each access to a distribution's name parses its metadata
def _package_name(dist: importlib.metadata.Distribution | None) -> str:
    """Return the name of a distribution's package."""
    return (dist.name if dist else "") or "a package without a name"
