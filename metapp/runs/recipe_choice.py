"""The choice of a recipe, and so of what fits see, by options and inputs, and the lines that give the reasons.

An input counts by nothing but its facts, such as its number of photos or of samples, which the reader of its format has
found out; no file is opened here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from data_tools.readers.input_source import DAMAGED_FACT, Source
from metapp.application import Application, FactRange, Facts, RecipeEntry
from metapp.options import BadOption
from metapp.runs.fit_options import FitOptions
from metapp.storage.shipped_checkpoints import FULL_RECIPE_NAME, QUICK_RECIPE_NAME, checkpoint_folder


class RecipeChoice(NamedTuple):
    """The recipe of a fit, and why it was chosen.

    Attributes:
        name: the name of the recipe.
        observes: what fits by the recipe see, a value of --observe; "" if all fits of the application see the same.
        reasons: lines that a run prints first: what fits see and which recipe it takes because of its inputs, and why.
        missing_file_line: the one of these lines that says which file is missing for the recipe that suits the inputs;
            "" if no file is.
    """

    name: str
    observes: str
    reasons: tuple[str, ...] = ()
    missing_file_line: str = ""


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
        The observation, and the line that gives the reason, "" if there are no sources.
    """
    observations = options.application.observations
    if not sources:
        return observations[0], ""
    most_seen = [
        next((name for name in observations if source.facts.get(name, True)), observations[-1]) for source in sources
    ]
    chosen = max(most_seen, key=observations.index)
    reason = f"{most_seen.count(chosen)} of {len(most_seen)} inputs hold a {chosen} alone"
    if {*most_seen} == {chosen}:
        reason = f"every {_source_noun(options)} {'has one' if chosen == observations[0] else f'is a {chosen} alone'}"
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
