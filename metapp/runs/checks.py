"""What ships, and whether an application has what was asked for; if not, a usage error lists what it has."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from types import UnionType
from typing import get_args, get_origin, get_type_hints

import torch

from data_tools.formats import Export, Format, OwnRecipe, exports_of, inputs_of, merge_of
from metapp.apps import app_names, app_of, presentation_of, protocols_of, recipes_of
from metapp.learning.app import App
from metapp.learning.recipe import Recipe
from metapp.learning.rules import PARTS, RULES, SHORT, rule_of
from metapp.learning.task import Task
from metapp.networks.exemplar import ExemplarSetup, at_detail, details_of
from metapp.runs import BadOption
from metapp.runs.naming import name_of
from metapp.runs.reporter import say
from metapp.runs.request import Request
from metapp.storage.manifest import read_manifest
from metapp.storage.text import meant

QUICK, FULL = "quick", "full"
RULE_WORDS = (*RULES, *SHORT, *PARTS)


def shipped_path(app: str, name: str, recipe: str = QUICK) -> Path:
    """Where a checkpoint that ships is, by its file name without suffix.

    A recipe has a folder, for what it does not share with "full" and "quick"; that of "full" has nothing for "quick".
    """
    folder, file = _folder(app), f"{name}.safetensors"
    own = [folder / each / file for each in (recipe, FULL) if recipe != QUICK]
    return next((path for path in own if path.is_file()), folder / file)


def shipped_names(app: str) -> dict[str, list[str]]:
    """The checkpoints that ship for an application, by it, and for its recipe of another size, by "<app> full"."""
    folders = {app: _folder(app), f"{app} {FULL}": _folder(app) / FULL}
    names = {key: sorted(path.stem for path in folder.glob("*.safetensors")) for key, folder in folders.items()}
    return {key: found for key, found in names.items() if found or key == app}


def ships(app: str, recipe: str) -> bool:
    """Whether checkpoints of a recipe ship: its own, or those of "quick" where it fits the same network."""
    same = recipe == FULL and full_fits_as_quick(app)
    return recipe == QUICK or same or (_folder(app) / recipe).is_dir()


def full_fits_as_quick(app: str) -> bool:
    """Whether networks of "full" are of the size of those of "quick": then all that fits differ in is its rule."""
    recipes = recipes_of(app)
    result: bool = recipes[FULL].setup == recipes[QUICK].setup
    return result


def _folder(app: str) -> Path:
    return Path(str(resources.files("metapp.checkpoints"))) / app


def default_recipe(request: Request) -> str:
    """What a request without a recipe is fitted by: "full", the best rule and size that ships, else "quick".

    Where every input, or every task of the data set, is of a format that has a recipe of its own: that one.

    Raises:
        BadOption: some inputs are, and others are not.
        ValueError: the data set cannot be read.
    """
    app = request.app
    for form, own in _own_recipes(app):
        if not _has_recipe(request, own):
            continue
        if own.tells and request.lazy:  # it reads the inputs, which may be thousands
            continue
        if _are_of(form, own, request) if request.inputs else _is_set_of(own, request.data):
            what = "input" if request.inputs else f"task of {request.data}"
            if not request.quiet:
                say(f"{app}: recipe {own.name}, since every {what} has {own.has}")
            return own.name
    return _usual_recipe(app)


def recipe_of_tasks(request: Request, tasks: Sequence[Task]) -> str:
    """The same for tasks that were made in memory."""
    for form, own in _own_recipes(request.app):
        if _has_recipe(request, own) and all(_is_own(form, own, task) for task in tasks):
            return own.name
    return _usual_recipe(request.app)


def _own_recipes(app: str) -> list[tuple[Format, OwnRecipe]]:
    return [(form, own) for form in inputs_of(app) for own in form.own]


def _is_own(form: Format, own: OwnRecipe, task: Task) -> bool:
    if own.tensor:
        return own.tensor in task.data
    tells: Callable[[Task], bool] = getattr(form.files(), f"{own.tells}_task")
    return tells(task)


def _has_recipe(request: Request, own: OwnRecipe) -> bool:
    serves = not own.paradigms or request.paradigm in own.paradigms
    return serves and ships(request.app, own.name) and own.name in recipes_of(request.app, request.observe)


def _usual_recipe(app: str) -> str:
    return FULL if FULL in recipes_of(app) and ships(app, FULL) else QUICK


def _are_of(form: Format, own: OwnRecipe, request: Request) -> bool:
    """Whether inputs are folders with sources of this format alone; BadOption where only some are."""
    some = [path for path in request.inputs if _has_own(form, own, path)]
    for other in inputs_of(form.app) if some else ():
        path = next((path for path in request.inputs if other.recognises(path) and _lacks(path, other, own)), None)
        if path is not None:
            has, lacks = form.find(some[:1])[0][0], (other.find([path])[0] or [path])[0]
            raise BadOption(
                f"{form.app}: {has} has {own.has}, {lacks} has not, and recipes for these differ; fit them by two "
                f"commands, or all by --recipe {own.name} or --recipe {FULL}."
            )
    return bool(some)


def _has_own(form: Format, own: OwnRecipe, path: Path) -> bool:
    """Whether a path is, or holds, an input of a format that takes a recipe of its own."""
    return own in form.own and form.recognises(path) and (not own.tells or getattr(form.files(), own.tells)(path))


def _lacks(path: Path, form: Format, own: OwnRecipe) -> bool:
    """Whether an input of a format is not of those that take a recipe of their own, the same for some formats."""
    same = [other for other in inputs_of(form.app) if own in other.own]
    return form not in same or not any(_has_own(other, own, path) for other in same)


def _is_set_of(own: OwnRecipe, data: Path | None) -> bool:
    # of a folder that is not there, whatever reads it says so
    if not own.tensor or data is None or not data.exists():
        return False
    return own.tensor in read_manifest(data).units


def check_name(app: str) -> None:
    """A usage error that lists the applications where there is none of that name."""
    if app not in app_names():
        known = app_names()
        raise BadOption(f"'{app}' is not an application; expected one of {', '.join(known)}.{meant(app, known)}")


def check_options(options: Mapping[str, object]) -> None:
    """A usage error where options that a program gives are none of `Request`, or of another type, or negative."""
    hints = get_type_hints(Request)
    known = [name for name in hints if name not in ("inputs", "objects", "quiet")]
    for name, value in options.items():
        if name not in known:
            raise BadOption(f"{name}: no option of a fit, expected one of {', '.join(known)}.{meant(name, known)}")
        kinds = get_args(hints[name]) if isinstance(hints[name], UnionType) else (hints[name],)
        if get_origin(kinds[0]) is not None:
            continue  # of the sequences there is only one of paths, which are made before
        names = " or ".join(kind.__name__.replace("NoneType", "None") for kind in kinds)
        kinds = (*kinds, int) if float in kinds else kinds
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            raise BadOption(f"{name}: {value!r}, expected {names}.")
        if int in kinds and isinstance(value, int) and value < 0 and float not in kinds:
            raise BadOption(f"{name}: {value}, expected 0 or more.")


def check_protocol(protocol: str, app: str) -> None:
    """A usage error where the application of a name has no such protocol."""
    known = protocols_of(app)
    if protocol and protocol not in known:
        expected = f"expects one of {', '.join(known)}" if known else "has one protocol; leave it out"
        raise BadOption(f"--observe '{protocol}': {app} {expected}.{meant(protocol, known)}")


def check_rule(request: Request, recipe: Recipe) -> str:
    """The one name of a rule or composition, the recipe's default where none is asked for, or a usage error."""
    if not request.rule:
        return recipe.rule
    try:
        rule = rule_of(request.rule)
        app = app_of(request.app, recipe, request.observe, rule=rule.name)
        theta = {key: value[0] for key, value in app.init(torch.Generator().manual_seed(0), 1).items()}
        rule.require(app, theta)
    except ValueError as error:
        unknown = [word for word in request.rule.split("+") if word not in RULE_WORDS]
        raise BadOption(f"--rule: {error}{meant(unknown[0], RULE_WORDS) if unknown else ''}") from None
    return rule.name


def check_size(text: str, app: App) -> tuple[int, int] | None:
    """Height and width of "HxW", in px; None of "".

    Raises:
        BadOption: no such text, or nothing that the application makes can be of that size.
    """
    if not text:
        return None
    found = re.fullmatch(r"(\d{1,6})x(\d{1,6})", text)
    if not found:
        raise BadOption(f"--size '{text}': expected HEIGHTxWIDTH in px, such as 1024x1024.")
    height, width = map(int, found.groups())
    if refusal := presentation_of(app).refusal(height, width):
        raise BadOption(f"--size {text}: {name_of(app)} {refusal}.")
    return height, width


def details(app: str) -> dict[str, tuple[int, ...]]:
    """The sides in px that an application's photographs can be fitted at, by its recipes that have a choice."""
    setups = {name: recipe.setup for name, recipe in recipes_of(app).items()}
    sides = {name: details_of(setup) for name, setup in setups.items() if isinstance(setup, ExemplarSetup)}
    return {name: own for name, own in sides.items() if own}


def check_detail(request: Request, name: str, recipe: Recipe) -> Recipe:
    """The recipe of a name at the detail asked for.

    Raises:
        BadOption: it has no other, or not that one; training has none.
    """
    if not request.detail:
        return recipe
    known = details(request.app)
    if name not in known:
        remedy = f"give --recipe {', '.join(known)}" if known else "leave it out"
        raise BadOption(f"--detail {request.detail}: {request.app} has no choice by recipe {name}; {remedy}.")
    if request.detail not in known[name]:
        raise BadOption(f"--detail {request.detail}: expected one of {', '.join(map(str, known[name]))}.")
    if request.train:
        raise BadOption("--detail: of fits; checkpoints are trained at the usual one, leave --train out.")
    return replace(recipe, setup=at_detail(recipe.setup, request.detail))


def check_export(name: str, app: str) -> None:
    """Refuse a form that fits of an application cannot be written in.

    Raises:
        BadOption: it cannot, or a library for it is missing.
    """
    known = exports_of(app)
    if name and name not in known:
        expected = f"expects one of {', '.join(known)}" if known else "has none; leave it out"
        raise BadOption(f"--export '{name}': {app} {expected}.{meant(name, known)}")
    form = known.get(name)
    if isinstance(form, Export) and form.missing():
        raise BadOption(form.missing())


def check_inputs(request: Request, app: App) -> None:
    """Refuse options about inputs of another kind than the application's.

    Raises:
        BadOption: it has none that such an option is about.
    """
    formats = inputs_of(app.name)
    if request.scene_root and not any("roots" in form.takes for form in formats):
        raise BadOption(f"--scene-root: {app.name} has no scenes, only transport; leave it out.")
    if request.render and not presentation_of(app).renders:
        raise BadOption(f"--render: {app.name} has no scenes, only transport; leave it out.")
    if request.fov and not any("fov_rad" in form.takes for form in formats):
        raise BadOption(f"--fov: {app.name} has no photos whose camera counts; leave it out.")
    if request.exposure and not any("exposure" in form.takes for form in formats):
        raise BadOption(f"--exposure: {app.name} takes photos as they are, only svbrdf_nonstationary scales them.")
    if request.exposure and (app.protocol != "photo" or not (request.inputs or request.objects)):
        raise BadOption("--exposure is about INPUT photos where fits see them alone; add --observe photo, name photos.")
    if request.exposures:
        _check_exposures(request, app, merge_of(app.name) is not None)


def _check_exposures(request: Request, app: App, merges: bool) -> None:
    if not merges:
        raise BadOption(f"--exposures: {app.name} merges no photos, only illumination does; leave it out.")
    if app.protocol != "photo" or not request.inputs:
        raise BadOption("--exposures merges INPUT photos where fits see them alone; add --observe photo, name photos.")
    if request.lazy:
        raise BadOption("--exposures makes one input of all photos; leave out --batch and --shard.")
