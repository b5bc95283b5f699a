"""The only place where a protocol and a recipe are chosen from options and inputs, with the reason.

Inputs are looked at only by their protocols and facts (number of photos, of samples and so on), which the readers of
formats state; no file is opened here.
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
        reasons: the first lines that a run prints: what the inputs chose, and why.
        missing_file_line: the line among the reasons about a missing file that a better recipe needs; "" for none.
    """

    app: str
    recipe: str
    protocol: str
    reasons: tuple[str, ...] = ()
    missing_file_line: str = ""


def choose_protocol_and_recipe(options: FitOptions, sources: Sequence[Source]) -> Choice:
    """Choose the protocol that all sources of a fit allow, and the first recipe that suits all of them.

    Options that name a protocol or a recipe are followed, and no reason is given for it.

    Args:
        options: the options of the fit.
        sources: its inputs, or its data set as a single source; () for the embedded set.

    Raises:
        BadOption: a recipe suits some of the inputs that the user named, but not all of them.
    """
    protocol, recipe, protocol_reason, recipe_reason, missing = options.observe, options.recipe, "", "", ""
    if not protocol and (protocols := protocols_of(options.app)):
        protocol, protocol_reason = _choose_protocol(options, sources, protocols)
    if not recipe:
        recipe, recipe_reason, missing = _choose_recipe(options, sources, protocol)
    reasons = tuple(filter(None, (protocol_reason, recipe_reason, missing)))
    return Choice(options.app, recipe, protocol, reasons, missing)


def facts_match(suits: Mapping[str, FactRange], facts: Facts) -> bool:
    """Test whether the facts of a source have the values that a recipe suits.

    Args:
        suits: the values of facts that the recipe suits, or ranges (lowest, highest) of them; {} suits nothing.
        facts: the facts of the source, by name.

    >>> facts_match({"samples": (1, 200)}, {"samples": 20, "anisotropic": False}), facts_match({}, {"samples": 20})
    (True, False)
    """
    ranges = {fact: value if isinstance(value, tuple) else (value, value) for fact, value in suits.items()}
    return bool(ranges) and all(fact in facts and low <= facts[fact] <= high for fact, (low, high) in ranges.items())


def _choose_protocol(options: FitOptions, sources: Sequence[Source], protocols: Sequence[str]) -> tuple[str, str]:
    """Choose the first protocol that all sources allow.

    Args:
        options: the options of the fit.
        sources: its inputs.
        protocols: the application's protocols, from the one that sees most to the one that sees least.

    Returns:
        The protocol, and the line that gives the reason, "" if there are no sources.
    """
    allowed = [source.protocol or protocols[0] for source in sources]
    if not allowed:
        return protocols[0], ""
    chosen = max(allowed, key=protocols.index)
    reason = f"{allowed.count(chosen)} of {len(allowed)} inputs hold a {chosen} alone"
    if {*allowed} == {chosen}:
        reason = f"every {_noun(options)} {'has one' if chosen == protocols[0] else f'is a {chosen} alone'}"
    return chosen, f"{options.app}: fits see: {chosen}, since {reason}"


def _choose_recipe(options: FitOptions, sources: Sequence[Source], protocol: str) -> tuple[str, str, str]:
    """Choose the recipe that suits all sources, else the usual recipe.

    Inputs that a user names must be alike. A folder, such as one of a material database, may hold inputs that a recipe
    suits beside others: then the recipe's `mixed_recipe` is chosen, or an error is raised if it has none. Damaged
    inputs do not count.

    Args:
        options: the options of the fit.
        sources: its inputs.
        protocol: the protocol of the fit.

    Returns:
        The name of the recipe, the line that gives the reason, and a line about a missing file that a better recipe
        needs; "" where there is no such line.
    """
    app, usual = options.app, usual_recipe(options.app)
    entries = recipe_entries(app, protocol)
    offered = {name: entry for name, entry in entries.items() if _is_offered(options, name, entry)}
    sound_sources = [source for source in sources if not source.facts.get(DAMAGED_FACT)]
    recipe_by_source = [
        next((name for name in offered if facts_match(offered[name].suits, source.facts)), "")
        for source in sound_sources
    ]
    name = next((name for name in offered if name in recipe_by_source), "")
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
    return name, f"{app}: recipe {name}, since every {_noun(options)} has {entry.help}", ""


def _is_offered(options: FitOptions, name: str, entry: RecipeEntry) -> bool:
    """Test whether inputs may choose a recipe: it says what it suits, takes the paradigm, and its checkpoints ship."""
    has_paradigm = not entry.paradigms or options.paradigm in entry.paradigms
    return bool(entry.suits) and has_paradigm and has_shipped_recipe(options.app, name)


def _noun(options: FitOptions) -> str:
    """Return what reasons call one of the sources."""
    return "input" if options.inputs else f"task of {options.data}"
