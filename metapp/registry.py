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
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, Protocol

from metapp.application import Application, Format
from metapp.entries import METAPP_PACKAGE, Entries, Lazy, SetOnce, describe_error, did_you_mean, registering

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from metapp.learning.adjoint import Loss, Steps, UpdateRule
    from metapp.learning.rules import LearnedRule
    from metapp.learning.task import Params

    SceneDict = dict[str, Any]  # a scene of Mitsuba as JSON holds it

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


@dataclass(kw_only=True, eq=False)
class Hooks(SetOnce):
    """Functions that the core calls if an extension sets them.

    Attributes:
        steps: makes the steps of fits and of outer loops, faster than torch where it can.
        scene: checks the scenes of data sets.
        name: the name of the object, with which errors begin.
    """

    steps: Lazy[MakeSteps] | None = None
    scene: Lazy[CheckScene] | None = None
    name: str = "hooks"


@dataclass(frozen=True)
class Registry:
    """Tables of entries by name.

    Attributes:
        applications: applications by name; each has tables of its own.
        rules: learned rules, each a :class:`metapp.learning.rules.LearnedRule` of the name that is its key.
        file_exports: forms in which files are written that are no fits.
        plugins: plugins of Mitsuba.
        measures: measures of pictures.
        tables: tables of `metapp evaluate`.
        commands: commands by the words after `metapp`.
        methods: functions that become methods of fits in the Python API.
        hooks: functions that the core calls if an extension sets them.
        extensions: the package of each extension, by the extension's name.
        problems: why some extensions cannot be used, by "NAME of PACKAGE".

    >>> registry().rules["meta-sgd"]
    Lazy(reference='metapp.learning.rules.named_rules:META_SGD')
    """

    applications: Entries[Application] = field(default_factory=lambda: Entries(Application, "applications"))
    rules: Entries[Lazy[LearnedRule]] = field(default_factory=lambda: Entries(Lazy, "rules"))
    file_exports: Entries[FileExport] = field(default_factory=lambda: Entries(FileExport, "file_exports"))
    plugins: Entries[Plugin] = field(default_factory=lambda: Entries(Plugin, "plugins"))
    measures: Entries[Measure] = field(default_factory=lambda: Entries(Measure, "measures"))
    tables: Entries[TableEntry] = field(default_factory=lambda: Entries(TableEntry, "tables"))
    commands: Entries[Command] = field(default_factory=lambda: Entries(Command, "commands"))
    methods: Entries[Lazy[FitMethod]] = field(default_factory=lambda: Entries(Lazy, "methods"))
    hooks: Hooks = field(default_factory=Hooks)
    extensions: dict[str, str] = field(default_factory=dict)
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

    def all_entries(self) -> Iterator[Entries[Any]]:
        """Yield the entries of each kind: the registry's, then each application's."""
        yield from (entries for entries in vars(self).values() if isinstance(entries, Entries))
        for application in self.applications.values():
            yield from application.all_entries()

    def each_entry(self) -> Iterator[tuple[str, Any, Any]]:
        """Yield each entry after the title of its kind and its key."""
        for entries in self.all_entries():
            yield from ((entries.title, key, entry) for key, entry in entries.items())


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
        kept = None if package == METAPP_PACKAGE else _copy_dictionaries(result)
        try:
            with registering(package):
                (point.load() if point.attr else point.load().register)(result)
            if kept is not None:
                _check_entries_of(package, result)
            result.extensions[point.name] = package
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever the module of another package does, the rest of metapp works
            if kept is None:
                raise
            for dictionary, content in kept:
                dictionary.clear()
                dictionary.update(content)
            result.problems[f"{point.name} of {package}"] = describe_error(error)
    return result


def _copy_dictionaries(registry: Registry) -> list[tuple[dict[Any, Any], dict[Any, Any]]]:
    """Return all dictionaries that an extension may change, each with a copy of its content."""
    dictionaries = [vars(registry.hooks), *(vars(application) for application in registry.applications.values())]
    for table in registry.all_entries():
        dictionaries += [table.data, table.owners]
    return [(dictionary, dict(dictionary)) for dictionary in dictionaries]


def _check_entries_of(package: str, registry: Registry) -> None:
    """Check the entries of a package of others: modules exist, commands are functions, recipes suit different inputs.

    Raises:
        ImportError: a module is missing, or a command cannot be loaded.
        TypeError: a command is not a function.
        ValueError: two recipes suit equal facts.
    """
    references = [
        entry for table in registry.all_entries() for key, entry in table.items() if table.owners[key] == package
    ]
    for owner in (registry.hooks, *registry.applications.values()):
        references += [value for value in vars(owner).values() if isinstance(value, Lazy)]
    for entry in references:
        for reference in _references_in(entry):
            if importlib.util.find_spec(reference.partition(":")[0]) is None:
                raise ImportError(f"{reference}: no such module")
    for key, command in registry.commands.items():
        if registry.commands.owners[key] == package and not callable(command.load()):
            raise TypeError(f"commands {key}: {command.reference} is not a function")
    for application in registry.applications.values():
        _require_different_inputs(application)


def _references_in(entry: object) -> Iterator[str]:
    """Yield the references of an entry: its own, and those in its fields."""
    if isinstance(entry, Lazy):
        yield entry.reference
    for item in fields(entry) if is_dataclass(entry) else ():
        if isinstance(value := getattr(entry, item.name), Lazy):
            yield from _references_in(value)


def _require_different_inputs(application: Application) -> None:
    """Refuse two recipes that would be chosen for inputs of equal facts.

    Raises:
        ValueError: there are two; the message names the packages that registered them.
    """
    owners: dict[str, str] = {}
    for (observation, _, entry), key in zip(application.named_recipes(), application.recipes, strict=True):
        owner = application.recipes.owners[key]
        if entry.suits:
            facts = ", ".join(f"{fact} {value}" for fact, value in sorted(entry.suits.items()))
            words = (f"recipes of {application.name}", observation, f"for inputs of {facts}")
            subject = " ".join(filter(None, words))
            if subject in owners:
                raise ValueError(f"{subject}: registered by {owner}, but {owners[subject]} has registered it already")
            owners[subject] = owner


@functools.cache  # each access to a distribution's name parses its metadata
def _package_name(dist: importlib.metadata.Distribution | None) -> str:
    """Return the name of a distribution's package."""
    return (dist.name if dist else "") or "a package without a name"
