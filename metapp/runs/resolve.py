"""The completion of a specification for each input: all that a user leaves open is decided here, and nowhere else.

A folder may hold inputs of several kinds. Each gets the observation and the recipe that suit it, as if it were alone.
Nothing is printed, read as a task, or fitted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch

from metapp.appearance.presenter import Presenter
from metapp.application import Application, FactRange, Facts
from metapp.entries import did_you_mean
from metapp.learned_rules import rule_of
from metapp.learning.app import App
from metapp.learning.recipe import Recipe
from metapp.options import FIT, INPUT, BadOption, options_by_name
from metapp.paradigms import paradigm_of
from metapp.paradigms.methods import number_of_steps
from metapp.runs.checkpoints import checkpoint_digest, has_shipped_recipe, usual_recipe
from metapp.runs.environment import find_device, software_versions
from metapp.runs.inputs.finding import DATA_SET_FORMAT, Input
from metapp.runs.spec import Spec


def resolve(spec: Spec, inputs: Sequence[Input], *, trained: bool = True) -> tuple[list[Spec], list[str]]:
    """Complete a specification for each input.

    Args:
        spec: what the user asks for.
        inputs: the inputs.
        trained: whether the checkpoint is there, whose digest is then filled in; False before it is trained.

    Returns:
        The specification of each input, one object for all inputs that are fitted alike; and a line for each choice
        that was made because of the inputs.

    Raises:
        BadOption: the application has no such recipe or rule, or options exclude each other.
        ValueError: there is no such device or checkpoint.
    """
    application = spec.application
    completed: dict[tuple[str, str, str], Spec] = {}
    specs: list[Spec] = []
    reasons: Counter[str] = Counter()
    for one in inputs:
        observe = spec.observe or most_seen(application, one.facts)
        recipe, reason = (spec.recipe, "") if spec.recipe else suiting_recipe(spec, observe, one.facts)
        key = (observe, recipe, one.data)
        if key not in completed:
            chosen, of_data = (
                replace(spec, observe=observe, recipe=recipe, data=one.data),
                one.format == DATA_SET_FORMAT,
            )
            completed[key] = complete(chosen, trained=trained, of_data=of_data)
        specs.append(completed[key])
        reasons.update([reason] * bool(reason))
    lines = [
        f"{application.name}: {reason}" + (f" ({count} of {len(inputs)} inputs)" if count < len(inputs) else "")
        for reason, count in reasons.items()
    ]
    return specs, lines


def complete(spec: Spec, *, trained: bool = True, of_data: bool = False) -> Spec:
    """Fill in all that follows from the observation and the recipe of a specification; both may be left open, too.

    Args:
        spec: the specification.
        trained: whether the checkpoint is there, whose digest is then filled in.
        of_data: whether the input is a task of a data set, about which options about INPUT say nothing.

    Raises:
        BadOption: the application has no such recipe or rule, or options exclude each other.
        ValueError: there is no such device or checkpoint.
    """
    application, learned = spec.application, paradigm_of(spec.paradigm).has_learned_rule
    observe = spec.observe or application.default_observation
    spec = replace(spec, observe=observe, recipe=spec.recipe or usual_recipe(application))
    recipe = recipe_of(spec)
    spec = replace(
        spec,
        rule=(spec.rule or recipe.rule) if learned else "",
        steps=number_of_steps(spec.paradigm, recipe, spec.steps),
    )
    app = app_of(spec)
    _check_rule(spec, app)
    _check_app_options(spec, of_data=of_data)
    presenter_of(spec, app)
    device = find_device(spec.device, app)
    spec = replace(spec, device=str(device))
    return replace(
        spec,
        digest=checkpoint_digest(spec, app, recipe) if trained else "",
        conditions=app.recorded_conditions(device if spec.steps else None),
        versions=software_versions(),
    )


def recipe_of(spec: Spec) -> Recipe:
    """Return the recipe of a specification, changed as the application's own options ask for.

    Raises:
        BadOption: there is no such recipe, or it cannot be changed so.
    """
    recipes = spec.application.recipes_observing(spec.observe)
    if spec.recipe not in recipes:
        hint = did_you_mean(spec.recipe, recipes)
        raise BadOption(f"--recipe '{spec.recipe}': expected one of {', '.join(recipes)}.{hint}")
    options = spec.app_options
    try:
        adapted: Recipe = options.adapt_recipe(recipes[spec.recipe].load())
    except ValueError as error:
        flags = ", ".join(f"--{key} {value}" for key, value in options.non_default_values(FIT).items())
        raise BadOption(f"{flags}, by recipe {spec.recipe}: {error}.") from None
    return adapted


def app_of(spec: Spec) -> App:
    """Return the network of the fits of a specification, what they see and how they are judged."""
    return recipe_of(spec).app_with(spec.rule)


def presenter_of(spec: Spec, app: App) -> Presenter[Any]:
    """Return what people look at of the fits of a specification.

    Raises:
        BadOption: files of the application cannot have the size that its options ask for.
    """
    try:
        presenter: Presenter[Any] = spec.application.presenter.load()(app, spec.application, spec.app_options)
    except ValueError as error:
        raise BadOption(str(error)) from None
    return presenter


def most_seen(application: Application, facts: Facts) -> str:
    """Return the first observation of an application that an input's facts do not deny; "" if all fits see the same.

    >>> from metapp.registry import registry
    >>> most_seen(registry().applications["illumination"], {"reference": False})
    'photo'
    """
    names = application.observations
    return next((name for name in names if facts.get(name, True)), names[-1]) if names else ""


def suiting_recipe(spec: Spec, observe: str, facts: Facts) -> tuple[str, str]:
    """Return the first recipe that suits an input, else the usual one.

    A recipe can be chosen if its entry says which inputs it suits, if it is meant for the paradigm, if its checkpoints
    ship, and if no file that it needs is missing.

    Args:
        spec: what the user asks for.
        observe: what the fit sees.
        facts: the facts of the input.

    Returns:
        The name of the recipe, and why it was chosen; "" for the usual recipe.
    """
    application = spec.application
    for name, entry in application.recipes_observing(observe).items():
        is_for_paradigm = not entry.paradigms or spec.paradigm in entry.paradigms
        if is_for_paradigm and facts_match(entry.suits, facts) and has_shipped_recipe(application, name):
            if entry.describe_missing_file and (missing := entry.describe_missing_file.load()()):
                return usual_recipe(application), missing
            return name, f"recipe {name}, as the input has {entry.inputs}"
    return usual_recipe(application), ""


def facts_match(suits: Mapping[str, FactRange], facts: Facts) -> bool:
    """Return whether an input has all facts that a recipe names, and in range.

    Args:
        suits: the facts that the recipe names, each with its value or its range (lowest, highest), both included; {}
            suits no input.
        facts: the facts of the input, by name.

    >>> facts_match({"samples": (1, 200)}, {"samples": 20, "anisotropic": False}), facts_match({}, {"samples": 20})
    (True, False)
    """
    ranges = {fact: value if isinstance(value, tuple) else (value, value) for fact, value in suits.items()}
    return bool(ranges) and all(fact in facts and low <= facts[fact] <= high for fact, (low, high) in ranges.items())


def _check_rule(spec: Spec, app: App) -> None:
    """Refuse a learned rule that does not exist, or that the application cannot have.

    Raises:
        BadOption: it is such a rule.
    """
    if spec.rule:
        try:
            theta = {key: value[0] for key, value in app.init(torch.Generator().manual_seed(0), 1).items()}
            rule_of(spec.rule).check_app(app, theta)
        except ValueError as error:
            raise BadOption(f"--rule: {error}") from None


def _check_app_options(spec: Spec, *, of_data: bool) -> None:
    """Refuse options of the application that belong to fits that observe something else, or to files.

    Raises:
        BadOption: there is such an option.
    """
    options = options_by_name(type(spec.app_options))
    for name in spec.options:
        if options[name].observes not in ("", spec.observe):
            raise BadOption(f"{options[name].flag}: only with --observe {options[name].observes}; add that.")
        if of_data and options[name].panel == INPUT:
            flag = options[name].flag
            raise BadOption(f"{flag}: about INPUT alone, not about the data set {spec.data}; leave it out.")
