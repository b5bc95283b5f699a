"""What a command does, before anything is read or fitted: application, recipe, rule, paradigm and device.

:func:`choose` decides all of it by options and inputs, prints nothing and writes nothing. The checkpoint of the choice
is read by `metapp.runs.checkpoint_selection`, and its fits are made by `metapp.runs.fitter`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch

from data_tools.readers.input_source import DAMAGED_FACT, Source
from metapp.appearance.presenter import Presenter
from metapp.application import Application, FactRange, Facts, RecipeEntry
from metapp.entries import did_you_mean
from metapp.learned_rules import rule_of
from metapp.learning.app import App
from metapp.learning.recipe import Recipe
from metapp.options import FIT, INPUT, OUTPUT, BadOption, options_by_name
from metapp.paradigms import paradigm_of
from metapp.paradigms.paradigm import Paradigm
from metapp.runs.environment import find_device
from metapp.runs.fit_options import (
    FitOptions,
    app_options_of_record,
    application_named,
    fit_options,
    folder_name_parts,
)
from metapp.runs.inputs.finding import find_sources
from metapp.runs.reporter import say
from metapp.storage.files import content_digest
from metapp.storage.fit_records import Origin, Settings
from metapp.storage.folders import cache_lookups
from metapp.storage.shipped_checkpoints import FULL_RECIPE_NAME, QUICK_RECIPE_NAME, checkpoint_folder


class RecipeChoice(NamedTuple):
    """The recipe of a fit, and why it was chosen.

    Attributes:
        name: the name of the recipe.
        observes: what fits by the recipe see, a value of --observe; "" if all fits of the application see the same, or
            if the inputs are objects in memory that have not been read.
        reasons: lines that a run prints first: what fits see and which recipe it takes because of its inputs, and why.
        missing_file_line: the one of these lines that says which file is missing for the recipe that suits the inputs;
            "" if no file is.
    """

    name: str
    observes: str
    reasons: tuple[str, ...] = ()
    missing_file_line: str = ""


@dataclass(frozen=True)
class Choice:
    """The recipe, rule, paradigm and device that options and inputs choose.

    Attributes:
        options: the options with all that is chosen filled in: the names of recipe and rule, and what fits see. `steps`
            is None if it is the recipe's number, by which folders are named.
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
    application = options.application
    recipe_choice = choose_recipe(options, sources)
    options = replace(options, observe=recipe_choice.observes)
    _check_recipe_and_options(options)
    unchanged: Recipe = application.recipes_observing(options.observe)[recipe_choice.name].load()
    recipe = _adapt_recipe(options, recipe_choice.name, unchanged)
    if recipe == unchanged:  # the options only say what the recipe does anyway: the run's folder need not name them
        values = options.app_options.non_default_values(INPUT, OUTPUT)
        options = replace(options, app_options=type(options.app_options)(**values))
    rule, paradigm_class = _rule_name(options, recipe), paradigm_of(options.paradigm)
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
    with cache_lookups():
        sources = find_sources(options)
    choice = choose(options, sources)
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
    values = {"rule": rule, "recipe": settings.recipe, "observe": settings.observe, "quiet": True}
    values |= {"steps": settings.steps, "seed": settings.seed, **more}
    try:
        return find_and_choose(fit_options(application, paradigm, inputs, **(recorded | dict(options or {})), **values))
    except BadOption as error:
        if options:
            raise
        raise ValueError(f"{application.name}: a fit of other settings than are known ({error})") from None


def choose_recipe(options: FitOptions, sources: Sequence[Source]) -> RecipeChoice:
    """Choose the recipe of a fit by the options or else by the sources.

    What an option names is taken, without a reason. Otherwise only recipes count whose fits see what all sources hold.
    Each source takes the first recipe of the application that may be chosen by inputs and that suits it; damaged
    sources do not count. Then there are these cases:

    - No source takes a recipe: the usual recipe is chosen, without a reason.
    - All sources take one recipe: this one is chosen, or the usual recipe if a file that it needs is missing.
    - Sources differ: some take one recipe, others take another or none. Of the recipes that they take, the first of the
      application decides. If its entry has a `mixed_recipe`, and all sources were found beside others in folders, such
      as folders of a material database, that recipe is chosen. If the entry has none, or the user named a source
      itself, an error is raised.

    Args:
        options: the options of the fit.
        sources: its inputs, or its data set as a single source; () for the embedded set.

    Raises:
        BadOption: no recipe is named, and a recipe suits some of the sources, but not all of them.
    """
    application, observes, observation_reason = options.application, options.observe, ""
    if not observes and application.observations:
        observes, observation_reason = _choose_observation(options, sources)
    if options.recipe:
        return RecipeChoice(options.recipe, observes, tuple(filter(None, [observation_reason])))
    usual = usual_recipe(application)
    entries = application.recipes_observing(observes)
    choosable = {name: entry for name, entry in entries.items() if _can_be_chosen(options, name, entry)}
    sound_sources = [source for source in sources if not source.facts.get(DAMAGED_FACT)]
    recipe_by_source = [
        next((name for name in choosable if facts_match(choosable[name].suits, source.facts)), "")
        for source in sound_sources
    ]
    name, reason, missing_file_line = next((name for name in choosable if name in recipe_by_source), ""), "", ""
    if name:
        entry, count, source_count = entries[name], recipe_by_source.count(name), len(sound_sources)
        if count == source_count:
            if entry.describe_missing_file and (missing := entry.describe_missing_file.load()()):
                name, missing_file_line = "", f"{application.name}: {missing}"
            else:
                reason = f"since every {_source_noun(options)} has {entry.inputs}"
        elif entry.mixed_recipe and not any(source.is_named for source in sound_sources):
            name, reason = entry.mixed_recipe, f"since {count} of {source_count} inputs have {entry.inputs}"
        else:
            pairs = list(zip(sound_sources, recipe_by_source, strict=True))
            source = next(source for source, recipe in pairs if recipe == name)
            other = next(source for source, recipe in pairs if recipe != name)
            raise BadOption(
                f"{application.name}: {source.path} has {entry.inputs}, {other.path} has not, and recipes for these "
                f"differ; fit them by two commands, or all by --recipe {name} or --recipe {FULL_RECIPE_NAME}."
            )
    recipe_reason = f"{application.name}: recipe {name}, {reason}" if reason else ""
    reasons = tuple(filter(None, (observation_reason, recipe_reason, missing_file_line)))
    return RecipeChoice(name or usual, observes, reasons, missing_file_line)


def facts_match(suits: Mapping[str, FactRange], facts: Facts) -> bool:
    """Test whether a recipe suits a source: whether the source has all facts that the recipe names, and in range.

    Args:
        suits: the facts that the recipe names, each with its value or its range (lowest, highest), both included; {}
            suits no source.
        facts: the facts of the source, by name.

    >>> facts_match({"samples": (1, 200)}, {"samples": 20, "anisotropic": False}), facts_match({}, {"samples": 20})
    (True, False)
    """
    ranges = {fact: value if isinstance(value, tuple) else (value, value) for fact, value in suits.items()}
    return bool(ranges) and all(fact in facts and low <= facts[fact] <= high for fact, (low, high) in ranges.items())


def has_shipped_recipe(application: Application, recipe: str) -> bool:
    """Return whether checkpoints ship by which a recipe can fit.

    The recipe "full" needs none for itself where its application has the network of the recipe "quick".
    """
    has_checkpoints = recipe == QUICK_RECIPE_NAME or checkpoint_folder(application.name, recipe).is_dir()
    if has_checkpoints or recipe != FULL_RECIPE_NAME:
        return has_checkpoints
    recipes = application.recipes_observing()
    return bool(recipes[FULL_RECIPE_NAME].load().app == recipes[QUICK_RECIPE_NAME].load().app)


def usual_recipe(application: Application) -> str:
    """Return the recipe of a fit that names none: "full" (the best rule and size) if it ships, else "quick"."""
    return (
        FULL_RECIPE_NAME
        if FULL_RECIPE_NAME in application.recipes_observing() and has_shipped_recipe(application, FULL_RECIPE_NAME)
        else QUICK_RECIPE_NAME
    )


def _choose_observation(options: FitOptions, sources: Sequence[Source]) -> tuple[str, str]:
    """Choose what fits see: the most that all sources hold.

    A source holds the first observation of the application that its facts do not deny, and all that see less. So the
    choice is the one of these that sees least: beside photos, maps are fitted with "photo", as their tasks have a
    photo, too.

    Returns:
        The observation, "" for objects in memory that have not been read; and the line that gives the reason, "" unless
        a source could be fitted by more than is chosen: that fits of photos see a photo surprises nobody.
    """
    observations = options.application.observations
    if not sources:  # what objects in memory hold is known once they are read
        return "" if options.objects else observations[0], ""
    most_seen = [
        next((name for name in observations if source.facts.get(name, True)), observations[-1]) for source in sources
    ]
    chosen = max(most_seen, key=observations.index)
    if {*most_seen} == {chosen}:
        return chosen, ""
    reason = f"{most_seen.count(chosen)} of {len(most_seen)} inputs hold a {chosen} alone"
    return chosen, f"{options.application.name}: fits see: {chosen}, since {reason}"


def _can_be_chosen(options: FitOptions, name: str, entry: RecipeEntry) -> bool:
    """Test whether a recipe may be chosen by the inputs of a fit.

    It may if its entry says which inputs it suits, if it is meant for the fit's paradigm, and if it needs no training,
    since its checkpoints ship.
    """
    has_paradigm = not entry.paradigms or options.paradigm in entry.paradigms
    return bool(entry.suits) and has_paradigm and has_shipped_recipe(options.application, name)


def _source_noun(options: FitOptions) -> str:
    """Return the noun for a source in the line of a reason: "input", or "task of DATA" where a data set is fitted."""
    return "input" if options.inputs else f"task of {options.data}"


def _check_recipe_and_options(options: FitOptions) -> None:
    """Refuse a recipe or an option that the application does not have for what fits observe.

    Raises:
        BadOption: there is no such recipe, or an option belongs to fits that observe something else.
    """
    recipes = options.application.recipes_observing(options.observe)
    if options.recipe and options.recipe not in recipes:
        raise BadOption(
            f"--recipe '{options.recipe}': expected one of {', '.join(recipes)}.{did_you_mean(options.recipe, recipes)}"
        )
    for name in options.app_options.non_default_values():
        option = options_by_name(type(options.app_options))[name]
        if options.observe and option.observes not in ("", options.observe):
            raise BadOption(f"{option.flag}: only with --observe {option.observes}; add that.")


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
    """Return the name of a learned rule, the recipe's rule if options name none.

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
        raise BadOption(f"--rule: {error}") from None
    return rule.name
