"""The recipe of a fit that names none: the one that its inputs choose, else the usual one."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path

from data_tools.formats import inputs_of
from metapp import door
from metapp.apps import recipe_offers
from metapp.learning.task import Task
from metapp.options import BadOption
from metapp.runs.checkpoints.shipped import FULL, ships, usual_recipe
from metapp.runs.options import FitOptions
from metapp.runs.reporter import say
from metapp.storage.manifest import read_manifest


def chosen_recipe(options: FitOptions) -> str:
    """The recipe that every input of options, or every task of its data set, chooses, else the usual one.

    Raises:
        BadOption: some inputs choose one, and others do not.
        ValueError: the data set cannot be read.
    """
    app = options.app
    for recipe, choice in _choices(options):
        if choice.tells and options.resumes:  # it reads the inputs, which may be thousands
            continue
        if _all_choose(options, recipe, choice) if options.paths else _is_set_of(choice, options.data):
            if lacking := _lacking(choice):
                say(f"{app}: {lacking}")
                continue
            what = "input" if options.paths else f"task of {options.data}"
            if not options.quiet:
                say(f"{app}: recipe {recipe}, since every {what} has {choice.has}")
            return recipe
    return usual_recipe(app)


def recipe_of_tasks(options: FitOptions, tasks: Sequence[Task]) -> str:
    """The same for tasks that were made in memory."""
    for recipe, choice in _choices(options):
        if all(_chooses_task(options.app, choice, task) for task in tasks) and not _lacking(choice):
            return recipe
    return usual_recipe(options.app)


def _choices(options: FitOptions) -> Iterator[tuple[str, door.Chosen]]:
    """The recipes that inputs may choose, with checkpoints for the paradigm."""
    for name, offer in recipe_offers(options.app, options.observe).items():
        choice = offer.chosen
        serves = choice and (not choice.paradigms or options.paradigm in choice.paradigms)
        if choice and serves and ships(options.app, name, options.observe):
            yield name, choice


def _lacking(choice: door.Chosen) -> str:
    return door.load(choice.lacks)() if choice.lacks else ""


def _chooses_task(app: str, choice: door.Chosen, task: Task) -> bool:
    if choice.tensor:
        return _holds(choice, task.data)
    (form, *_) = (form for form in inputs_of(app) if form.name in choice.formats)
    tells: Callable[[Task], bool] = getattr(form.files(), f"{choice.tells}_task")
    return tells(task)


def _all_choose(options: FitOptions, recipe: str, choice: door.Chosen) -> bool:
    """True if all inputs choose a recipe; BadOption where only some do."""
    recognised = [(form, path) for form in inputs_of(options.app) for path in options.paths if form.recognises(path)]
    choosing = [(form, path) for form, path in recognised if _chooses(choice, form, path)]
    chosen = {path for _, path in choosing}
    others = [(form, path) for form, path in recognised if form.name not in choice.formats or path not in chosen]
    if choosing and others:
        (first, *_), (other, *_) = ((form.find([path])[0] or [path]) for form, path in (choosing[0], others[0]))
        raise BadOption(
            f"{options.app}: {first} has {choice.has}, {other} has not, and recipes for these differ; fit them by two "
            f"commands, or all by --recipe {recipe} or --recipe {FULL}."
        )
    return bool(choosing)


def _chooses(choice: door.Chosen, form: door.Format, path: Path) -> bool:
    """True if an input of a format, or one that a folder holds, chooses the recipe."""
    return form.name in choice.formats and (not choice.tells or getattr(form.files(), choice.tells)(path))


def _is_set_of(choice: door.Chosen, data: Path | None) -> bool:
    # of a folder that is not there, whatever reads it says so
    if not choice.tensor or data is None or not data.exists():
        return False
    return _holds(choice, read_manifest(data).units)


def _holds(choice: door.Chosen, tensors: Collection[str]) -> bool:
    """True if tasks of these tensors choose a recipe."""
    return choice.tensor in tensors and choice.without not in tensors
