"""Recipes: the one of a fit that names none, and the checkpoints that ship for each; and the protocol, likewise.

A fit that names no recipe has the one for inputs of their kind, else the usual one.

An input has one kind: the first that its format tells, or the first of the application's tensors that a task or a data
set holds. A recipe is for one kind, and no two of an application and protocol are for the same.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from importlib import resources
from pathlib import Path

from metapp.apps import recipe_of
from metapp.learning.task import Task
from metapp.names import application_of, inputs_of, protocols_of, recipe_entries
from metapp.options import BadOption
from metapp.registry import Format, RecipeEntry, load
from metapp.runs.options import FitOptions
from metapp.runs.reporter import say

QUICK, FULL = "quick", "full"
PACKAGE = "metapp.checkpoints"


def chosen_recipe(options: FitOptions, tasks: Sequence[Task] = ()) -> str:
    """The recipe for the kind of all inputs of a fit, or of its data set, else the usual one.

    Args:
        options: of the fit.
        tasks: that objects in memory were read as, if any.

    Raises:
        BadOption: inputs of several kinds, and a recipe for one of them.
        ValueError: the data set cannot be read.
    """
    app, by_kind = options.app, _by_kind(options)
    kinds = {_kind_of_task(app, task) for task in tasks} if by_kind else set()
    if by_kind and not tasks:
        of_set = _kind_of_tensors(app, _tensors_of_set(options))
        kinds = {_kind_of_inputs(options, by_kind) if options.paths else of_set}
    name, recipe = by_kind.get(kinds.pop(), ("", None)) if len(kinds) == 1 else ("", None)
    if recipe is None:
        return usual_recipe(app)
    if lacking := load(recipe.lacks)() if recipe.lacks else "":
        say(f"{app}: {lacking}")
        return usual_recipe(app)
    if not options.quiet:
        what = "input" if options.paths else f"task of {options.data}"
        say(f"{app}: recipe {name}, since every {what} has {recipe.help}")
    return name


def chosen_protocol(options: FitOptions, tasks: Sequence[Task] = ()) -> str:
    """The protocol by which all inputs of a fit, or its data set, can be fitted; it is said, with the reason.

    Args:
        options: of the fit.
        tasks: that objects in memory were read as, if any.

    Raises:
        ValueError: a folder without an input, a data set that cannot be read.
    """
    app, protocols = options.app, protocols_of(options.app)
    sets = [_tensors_of_set(options)] if options.data and not options.inputs else []
    held = sets or [[*task.data] for task in tasks]
    told = [_protocol_of_tensors(app, tensors) for tensors in held if tensors] or list(_protocols_of_inputs(options))
    if not told:
        return protocols[0]
    chosen = max(told, key=protocols.index)
    some, what = told.count(chosen), f"task of {options.data}" if sets else "input"
    has = "has one" if chosen == protocols[0] else f"is a {chosen} alone"
    why = f"every {what} {has}" if some == len(told) else f"{some} of {len(told)} inputs hold a {chosen} alone"
    if not options.quiet:
        say(f"{app}: fits see: {chosen}, since {why}")
    return chosen


def _protocols_of_inputs(options: FitOptions) -> Iterator[str]:
    """The protocol of each source in the inputs that are paths."""
    forms = [form.load() for form in inputs_of(options.app).values()]
    for path in _existing(options):
        for reader in (form for form in forms if form.recognises(path)):
            for source in reader.find(path)[0]:
                yield getattr(reader, "protocol_of", lambda source: protocols_of(options.app)[0])(source)


def _protocol_of_tensors(app: str, tensors: Collection[str]) -> str:
    """The first protocol whose tensor is among these, else the first of all."""
    protocols = application_of(app).protocols
    return next((name for name, tensor in protocols.items() if tensor in tensors), next(iter(protocols)))


def _existing(options: FitOptions) -> list[Path]:
    """The inputs that are files or folders: of another path, whatever reads it says so."""
    return [path for path in options.paths if path.is_file() or path.is_dir()]


def _by_kind(options: FitOptions) -> dict[str, tuple[str, RecipeEntry]]:
    """The names and entries of recipes by kind of input, of those with checkpoints for the paradigm."""
    return {
        entry.kind: (name, entry)
        for name, entry in recipe_entries(options.app, options.observe).items()
        if entry.kind
        and (not entry.paradigms or options.paradigm in entry.paradigms)
        and ships(options.app, name, options.observe)
    }


def _kind_of_inputs(options: FitOptions, by_kind: dict[str, tuple[str, RecipeEntry]]) -> str:
    """The kind of all inputs, "" for none; BadOption if they are of several and a recipe is for one of them."""
    forms = [(form, form.load()) for form in inputs_of(options.app).values()]
    kinds = [
        (_kind_of_path(form, path), reader, path)
        for form, reader in forms
        for path in _existing(options)
        if reader.recognises(path)
    ]
    chosen = next((each for kind in by_kind for each in kinds if each[0] == kind), None)
    if chosen is None:
        return ""
    if other := next((each for each in kinds if each[0] != chosen[0]), None):
        (first, *_), (second, *_) = (reader.find(path)[0] or [path] for _, reader, path in (chosen, other))
        name, recipe = by_kind[chosen[0]]
        raise BadOption(
            f"{options.app}: {first} has {recipe.help}, {second} has not, and recipes for these differ; fit them by "
            f"two commands, or all by --recipe {name} or --recipe {FULL}."
        )
    return chosen[0]


def _kind_of_path(form: Format, path: Path) -> str:
    """The kind of an input of a format, or of one that a folder holds."""
    told = (kind for kind, tells in form.kinds if not tells or getattr(form.load(), tells)(path))
    return next(told, "")


def _tensors_of_set(options: FitOptions) -> Collection[str]:
    """The tensors of the data set that options name; of a folder that is not there, whatever reads it says so."""
    if options.data is None or not options.data.exists():
        return ()
    from metapp.storage.shards import read_manifest  # here: most fits are of files

    return read_manifest(options.data).units


def _kind_of_task(app: str, task: Task) -> str:
    """The kind of a task: by its tensors, else by the functions `<tells>_task` of formats that have such ones."""
    told = (
        kind
        for form in inputs_of(app).values()
        for kind, tells in form.kinds
        if tells and getattr(form.load(), f"{tells}_task", lambda task: False)(task)
    )
    return _kind_of_tensors(app, task.data) or next(told, "")


def _kind_of_tensors(app: str, tensors: Collection[str]) -> str:
    return next((kind for kind in application_of(app).kinds if kind in tensors), "")


def shipped_path(app: str, name: str, recipe: str = QUICK, protocol: str = "") -> Path:
    """The path of a checkpoint that ships, by its file name without suffix.

    Checkpoints that a recipe does not share with "full" and "quick" are in a folder of its own.
    """
    folders = [_recipe_folder(app, recipe, protocol), _folder(app) / FULL] if recipe != QUICK else []
    files = [folder / f"{name}.safetensors" for folder in (*folders, _folder(app))]
    return next((path for path in files if path.is_file()), files[-1])


def shipped_names(app: str) -> dict[str, list[str]]:
    """The checkpoints that ship for an application, by it, and for its recipe of another size, by "<app> full"."""
    folders = {app: _folder(app), f"{app} {FULL}": _folder(app) / FULL}
    names = {key: sorted(path.stem for path in folder.glob("*.safetensors")) for key, folder in folders.items()}
    return {key: found for key, found in names.items() if found or key == app}


def ships(app: str, recipe: str, protocol: str = "") -> bool:
    """True if checkpoints of a recipe ship: its own, or those of "quick" if it fits the same network."""
    own = recipe == QUICK or _recipe_folder(app, recipe, protocol).is_dir()
    return own or (recipe == FULL and recipe_of(app, FULL).app == recipe_of(app, QUICK).app)


def usual_recipe(app: str) -> str:
    """The recipe if none is named: "full", the best rule and size, if it ships, else "quick"."""
    return FULL if FULL in recipe_entries(app) and ships(app, FULL) else QUICK


def _recipe_folder(app: str, recipe: str, protocol: str) -> Path:
    """The folder of a recipe's own checkpoints: that of the extension which has it, else that of all."""
    entry = recipe_entries(app, protocol).get(recipe)
    package = entry.checkpoints if entry else ""
    return Path(str(resources.files(package))) / recipe if package else _folder(app) / recipe


def _folder(app: str) -> Path:
    return Path(str(resources.files(PACKAGE))) / app
