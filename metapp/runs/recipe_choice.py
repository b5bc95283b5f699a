"""The choice of a fit's protocol and recipe by its options and inputs, and the lines that give the reasons.

Nothing else chooses them. An input counts by nothing but its protocol and its facts, such as its number of photos or of
samples, which the reader of its format has found out; no file is opened here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from data_tools.readers.input_source import DAMAGED_FACT, Facts, Source
from metapp.names import protocols_of, recipe_entries
from metapp.options import BadOption
from metapp.registry import FactRange, RecipeEntry, load_reference
from metapp.runs.default_recipe import has_shipped_recipe, usual_recipe
from metapp.runs.fit_options import FitOptions
from metapp.storage.shipped_checkpoints import FULL_RECIPE_NAME


class Choice(NamedTuple):
    """The recipe and the protocol of a fit, and why they were chosen.

    Attributes:
        app: the name of the application.
        recipe: the name of the recipe.
        protocol: the value of --observe, what fits see; "" where the application has one protocol only.
        reasons: lines that a run prints first: which protocol and recipe it takes because of its inputs, and why.
        missing_file_line: the one of these lines that says which file is missing for the recipe that suits the inputs;
            "" if no file is.
    """

    app: str
    recipe: str
    protocol: str
    reasons: tuple[str, ...] = ()
    missing_file_line: str = ""


def choose_protocol_and_recipe(options: FitOptions, sources: Sequence[Source]) -> Choice:
    """Choose the protocol and the recipe of a fit, each by the options or else by the sources.

    A protocol or a recipe that an option names is taken, without a reason. Otherwise the protocol is one that all
    sources allow. The recipe is the one that suits all sources, or the usual recipe if no recipe is meant for inputs
    like any of them; if sources differ, a recipe for mixed inputs is chosen, or an error is raised. The exact cases are
    those of :func:`_choose_recipe`.

    Args:
        options: the options of the fit.
        sources: its inputs, or its data set as a single source; () for the embedded set.

    Raises:
        BadOption: no recipe is named, and a recipe suits some of the sources, but not all of them.
    """
    protocol, recipe, protocol_reason, recipe_reason, missing = options.observe, options.recipe, "", "", ""
    if not protocol and (protocols := protocols_of(options.app)):
        protocol, protocol_reason = _choose_protocol(options, sources, protocols)
    if not recipe:
        recipe, recipe_reason, missing = _choose_recipe(options, sources, protocol)
    reasons = tuple(filter(None, (protocol_reason, recipe_reason, missing)))
    return Choice(options.app, recipe, protocol, reasons, missing)


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


def _choose_protocol(options: FitOptions, sources: Sequence[Source], protocols: Sequence[str]) -> tuple[str, str]:
    """Choose the protocol that sees the most of what all sources hold.

    A source states the protocol that sees the most of it, and also allows all protocols that see less. So the choice is
    the stated protocol that sees least: beside photos, maps are fitted with "photo", as their tasks have a photo, too.

    Args:
        options: the options of the fit.
        sources: its inputs.
        protocols: the application's protocols, from the one that sees most to the one that sees least.

    Returns:
        The protocol, and the line that gives the reason, "" if there are no sources.
    """
    best_protocols = [source.protocol or protocols[0] for source in sources]
    if not best_protocols:
        return protocols[0], ""
    chosen = max(best_protocols, key=protocols.index)
    reason = f"{best_protocols.count(chosen)} of {len(best_protocols)} inputs hold a {chosen} alone"
    if {*best_protocols} == {chosen}:
        reason = f"every {_source_noun(options)} {'has one' if chosen == protocols[0] else f'is a {chosen} alone'}"
    return chosen, f"{options.app}: fits see: {chosen}, since {reason}"


def _choose_recipe(options: FitOptions, sources: Sequence[Source], protocol: str) -> tuple[str, str, str]:
    """Choose the recipe that suits all sources.

    Each source takes the first recipe of the registry that may be chosen by inputs and that suits it; damaged sources
    do not count. Then there are these cases:

    - No source takes a recipe: the usual recipe is chosen, without a reason.
    - All sources take one recipe: this one is chosen, or the usual recipe if a file that it needs is missing.
    - Sources differ: some take one recipe, others take another or none. Of the recipes that they take, the first of the
      registry decides. If its entry has a `mixed_recipe`, and all sources were found beside others in folders, such as
      folders of a material database, that recipe is chosen. If the entry has none, or the user named a source itself,
      an error is raised.

    Args:
        options: the options of the fit.
        sources: its inputs.
        protocol: the protocol of the fit.

    Returns:
        The name of the recipe, the line that gives the reason, and a line about a missing file that the recipe that
        suits all sources needs; "" where there is no such line.

    Raises:
        BadOption: the sources differ, and no `mixed_recipe` can be chosen.
    """
    app, usual = options.app, usual_recipe(options.app)
    entries = recipe_entries(app, protocol)
    choosable = {name: entry for name, entry in entries.items() if _can_be_chosen(options, name, entry)}
    sound_sources = [source for source in sources if not source.facts.get(DAMAGED_FACT)]
    recipe_by_source = [
        next((name for name in choosable if facts_match(choosable[name].suits, source.facts)), "")
        for source in sound_sources
    ]
    name = next((name for name in choosable if name in recipe_by_source), "")
    if not name:
        return usual, "", ""
    entry, count, source_count = entries[name], recipe_by_source.count(name), len(sound_sources)
    if count < source_count and entry.mixed_recipe and not any(source.is_named for source in sound_sources):
        return (
            entry.mixed_recipe,
            f"{app}: recipe {entry.mixed_recipe}, since {count} of {source_count} inputs have {entry.help}",
            "",
        )
    other_sources = (source for source, recipe in zip(sound_sources, recipe_by_source, strict=True) if recipe != name)
    if other := next(other_sources, None):
        raise BadOption(
            f"{app}: {sound_sources[recipe_by_source.index(name)].path} has {entry.help}, {other.path} has not, and "
            f"recipes for these differ; fit them by two commands, or all by --recipe {name} or --recipe "
            f"{FULL_RECIPE_NAME}."
        )
    if entry.describe_missing_file and (missing := load_reference(entry.describe_missing_file)()):
        return usual, "", f"{app}: {missing}"
    return name, f"{app}: recipe {name}, since every {_source_noun(options)} has {entry.help}", ""


def _can_be_chosen(options: FitOptions, name: str, entry: RecipeEntry) -> bool:
    """Test whether a recipe may be chosen by the inputs of a fit.

    It may if its entry says which inputs it suits, if it is meant for the fit's paradigm, and if it needs no training,
    since its checkpoints ship.
    """
    has_paradigm = not entry.paradigms or options.paradigm in entry.paradigms
    return bool(entry.suits) and has_paradigm and has_shipped_recipe(options.app, name)


def _source_noun(options: FitOptions) -> str:
    """Return the noun for a source in the line of a reason: "input", or "task of DATA" where a data set is fitted."""
    return "input" if options.inputs else f"task of {options.data}"
