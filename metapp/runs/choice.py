"""What a command does, before anything is read or fitted: application, recipe, rule, paradigm and device.

:func:`choose` decides all of it by options and inputs, prints nothing and writes nothing. The checkpoint of the choice
is read by `metapp.runs.checkpoint_selection`, and its fits are made by `metapp.runs.fitter`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from data_tools.readers.input_source import Source
from metapp.appearance.presenter import Presenter
from metapp.application import Application
from metapp.entries import did_you_mean
from metapp.learned_rules import rule_of
from metapp.learning.app import App
from metapp.learning.recipe import Recipe
from metapp.options import FIT, INPUT, OUTPUT, BadOption
from metapp.paradigms import paradigm_of
from metapp.paradigms.paradigm import Paradigm
from metapp.registry import registry
from metapp.runs.environment import find_device
from metapp.runs.fit_options import (
    FitOptions,
    app_options_of_record,
    application_named,
    check_recipe_and_options,
    fit_options,
    folder_name_parts,
)
from metapp.runs.inputs.finding import find_sources
from metapp.runs.recipe_choice import choose_recipe, usual_recipe
from metapp.runs.reporter import say
from metapp.storage.files import content_digest
from metapp.storage.fit_records import Origin, Settings


@dataclass(frozen=True)
class Choice:
    """The recipe, rule, paradigm and device that options and inputs choose.

    Attributes:
        options: the options as given, with the names of the chosen recipe and rule, and with what fits see; `steps` is
            None if it is the recipe's number.
        paradigm: the paradigm, for the application with the network of the recipe and of the rule.
        presenter: the presenter of the fits, with options of output such as the size of files.
        device: the device of all tensors.
        sources: the files, folders or data set that the inputs were found to be.
        reasons: lines that say what was chosen because of the inputs, and why.
    """

    options: FitOptions
    paradigm: Paradigm
    presenter: Presenter[Any]
    device: torch.device
    sources: Sequence[Source] = ()
    reasons: Sequence[str] = ()

    @property
    def application(self) -> Application:
        """The application, with its recipes, formats and exports."""
        return self.options.application

    @property
    def app(self) -> App:
        """The network of the fits, what they see and how they are judged."""
        return self.paradigm.app

    @property
    def recipe(self) -> Recipe:
        """The recipe of the fits."""
        return self.paradigm.recipe

    def folder(self, label: str, kind: str = "", checkpoint: str | None = None) -> Path:
        """Return the path of the folder of the fits, such as runs/brdf/meta-materials-1a2b3c-quick-seed3.

        The name has the paradigm and all options that are not at their default.

        Args:
            label: the label of the data.
            kind: the kind of records that are not fits by the paradigm, which then stands in place of its name.
            checkpoint: the digest of the checkpoint's content, "" if fits need none; None if it has not been read.
        """
        options, app = self.options, self.app
        rule = options.rule if kind or self.paradigm.has_learned_rule else ""
        checkpoint_path = str(options.checkpoint.resolve()) if options.checkpoint else ""
        digest = content_digest(checkpoint_path) if checkpoint is None else checkpoint
        words = [
            kind or self.paradigm.name,
            label if options.data and not options.paths else "",
            options.recipe if options.recipe != usual_recipe(self.application) else "",
            rule if rule != self.recipe.rule else "",
            *folder_name_parts(options.app_options),
            "" if options.steps is None else f"{options.steps}steps",
            "" if app.observes == self.application.default_observation else app.observes,
            f"checkpoint-{digest[:6]}" if checkpoint_path and digest else "",
            f"seed{options.seed}" if options.seed else "",
        ]
        return options.out / app.name / "-".join(filter(None, words))

    def origin(self, inputs: Sequence[Path]) -> Origin:
        """Return the places of inputs and data set, by which a later command finds them again.

        Args:
            inputs: the inputs, as the user gave them.
        """
        data = self.options.data
        return Origin([str(path.absolute()) for path in inputs], str(data.absolute()) if data else "")


def choose(options: FitOptions, sources: Sequence[Source] = ()) -> Choice:
    """Choose what options leave open, by the sources of the inputs.

    Args:
        options: the options.
        sources: the inputs, or the data set as a single source; () for the embedded set.

    Raises:
        BadOption: the application cannot have the rule, the recipe does not have an option, or inputs suit different
            recipes.
        ValueError: there is no such device or paradigm.
    """
    application, paradigm_class = options.application, paradigm_of(options.paradigm)
    recipe_choice = choose_recipe(options, sources)
    observes = "" if options.objects and not options.observe else recipe_choice.observes
    options = replace(options, observe=observes)
    check_recipe_and_options(options)
    unchanged: Recipe = application.recipes_observing(observes)[recipe_choice.name].load()
    recipe = _adapt_recipe(options, recipe_choice.name, unchanged)
    if recipe == unchanged:  # the options only say what the recipe does anyway: the run's folder need not name them
        values = options.app_options.non_default_values(INPUT, OUTPUT)
        options = replace(options, app_options=type(options.app_options)(**values))
    rule = _rule_name(options, recipe)
    app = recipe.app_with(rule if paradigm_class.has_learned_rule else "")
    try:
        presenter = application.make_presenter(app, options.app_options.non_default_values(OUTPUT))
    except ValueError as error:
        raise BadOption(str(error)) from None
    paradigm = paradigm_class.of(app, recipe, rule, options.steps)
    steps = None if paradigm.steps == paradigm.default_steps else paradigm.steps
    options = replace(options, recipe=recipe_choice.name, rule=rule, steps=steps)
    reasons = [recipe_choice.missing_file_line] if options.quiet else recipe_choice.reasons
    device = find_device(options.device, app)
    return Choice(options, paradigm, presenter, device, sources, [line for line in reasons if line])


def find_and_choose(options: FitOptions) -> Choice:
    """Find the inputs that options name, choose by them, and say the reasons.

    Raises:
        BadOption: see :func:`choose`.
        ValueError: no format reads an input, or there is no such device, paradigm or data set.
    """
    choice = choose(options, tuple(find_sources(options)))
    for line in choice.reasons:
        say(line)
    return choice


def choose_as_recorded(
    settings: Settings, options: Mapping[str, object] | None = None, *, inputs: Sequence[Path] = (), **more: Any
) -> Choice:
    """Return the choice by which a fit was made, as far as the settings in its record state it.

    Args:
        settings: the settings in the record.
        options: the application's own options that are set beside those of the record.
        inputs: the inputs; without any, options about INPUT are left out.
        more: further fields of `FitOptions`, by name.

    Raises:
        BadOption: one of `options` is wrong.
        ValueError: this version of metapp does not know the settings.
    """
    application = application_named(settings.app)
    recorded = app_options_of_record(application, settings.options, inputs=bool(inputs))
    paradigm = settings.paradigm or FitOptions.paradigm
    rule = settings.rule if paradigm_of(paradigm).has_learned_rule else ""
    values = {"rule": rule, "recipe": settings.recipe, "observe": settings.observe, "quiet": True, **more}
    try:
        return find_and_choose(
            fit_options(application.name, paradigm, inputs, **(recorded | dict(options or {})), **values)
        )
    except BadOption as error:
        if options:
            raise
        raise ValueError(f"{application.name}: a fit of other settings than are known ({error})") from None


def _adapt_recipe(options: FitOptions, name: str, recipe: Recipe) -> Recipe:
    """Change a recipe as the application's own options ask for.

    Args:
        options: the options.
        name: the name of the recipe.
        recipe: the recipe.

    Raises:
        BadOption: the recipe cannot be changed so.
    """
    try:
        adapted: Recipe = options.app_options.adapt_recipe(recipe)
    except ValueError as error:
        flags = ", ".join(f"--{key} {value}" for key, value in options.app_options.non_default_values(FIT).items())
        raise BadOption(f"{flags}, by recipe {name}: {error}.") from None
    return adapted


def _rule_name(options: FitOptions, recipe: Recipe) -> str:
    """Return the unique name of a rule or of a composition of parts, the recipe's rule if options name none.

    Raises:
        BadOption: there is no such rule, or the application cannot have it.
    """
    if not options.rule:
        return recipe.rule
    try:
        rule = rule_of(options.rule)
        app = recipe.app_with(rule.name)
        theta = {key: value[0] for key, value in app.init(torch.Generator().manual_seed(0), 1).items()}
        rule.check_app(app, theta)
    except ValueError as error:
        words = registry().rule_words
        unknown_words = [word for word in options.rule.split("+") if word not in words]
        hint = did_you_mean(unknown_words[0], words) if unknown_words else ""
        raise BadOption(f"--rule: {error}{hint}") from None
    return rule.name
