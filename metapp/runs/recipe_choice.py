"""The one place where inputs and options choose what a fit sees and by which recipe it is made."""

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
    """What a fit is made by.

    Attributes:
        app: the name of the application.
        recipe: the name of the recipe.
        protocol: the value of --observe, what fits see; "" where the application has no choice.
        reasons: the first lines that a run prints: what inputs chose, and why.
        missing: the reason, among these, about a file that a better recipe needs; "" for none.
    """

    app: str
    recipe: str
    protocol: str
    reasons: tuple[str, ...] = ()
    missing: str = ""


def choose_protocol_and_recipe(options: FitOptions, sources: Sequence[Source]) -> Choice:
    """Choose the protocol that all sources of a fit allow, and the first recipe that suits them all.

    Options that name a protocol or a recipe are followed without a reason.

    Args:
        options: of the fit.
        sources: its inputs, or its data set as a single one; () for the embedded set.

    Raises:
        BadOption: a recipe suits some of the named inputs, and not all.
    """
    protocol, recipe, why_protocol, why_recipe, missing = options.observe, options.recipe, "", "", ""
    if not protocol and (protocols := protocols_of(options.app)):
        protocol, why_protocol = _choose_protocol(options, sources, protocols)
    if not recipe:
        recipe, why_recipe, missing = _choose_recipe(options, sources, protocol)
    return Choice(options.app, recipe, protocol, tuple(filter(None, (why_protocol, why_recipe, missing))), missing)


def facts_match(wanted: Mapping[str, FactRange], facts: Facts) -> bool:
    """Test whether the facts of a source have the values of a recipe's, or lie in their ranges.

    >>> suits({"samples": (1, 200)}, {"samples": 20, "anisotropic": False}), suits({}, {"samples": 20})
    (True, False)
    """
    ranges = {fact: value if isinstance(value, tuple) else (value, value) for fact, value in wanted.items()}
    return bool(ranges) and all(fact in facts and low <= facts[fact] <= high for fact, (low, high) in ranges.items())


def _choose_protocol(options: FitOptions, sources: Sequence[Source], protocols: Sequence[str]) -> tuple[str, str]:
    """Return the first protocol that all sources allow, and the reason, "" if there are no sources."""
    allowed = [source.protocol or protocols[0] for source in sources]
    if not allowed:
        return protocols[0], ""
    chosen = max(allowed, key=protocols.index)
    every = f"every {_noun(options)} {'has one' if chosen == protocols[0] else f'is a {chosen} alone'}"
    some = f"{allowed.count(chosen)} of {len(allowed)} inputs hold a {chosen} alone"
    return chosen, f"{options.app}: fits see: {chosen}, since {every if {*allowed} == {chosen} else some}"


def _choose_recipe(options: FitOptions, sources: Sequence[Source], protocol: str) -> tuple[str, str, str]:
    """Return the recipe that suits all sources, else the usual one, the reason, and a line about a missing file.

    Inputs that a user names must be alike; a folder, such as that of a data base, may hold inputs of both kinds.
    """
    app, usual = options.app, usual_recipe(options.app)
    entries = recipe_entries(app, protocol)
    offered = {name: entry for name, entry in entries.items() if _is_offered(options, name, entry, protocol)}
    sound = [source for source in sources if not source.facts.get(DAMAGED_FACT)]
    suiting = [next((name for name in offered if facts_match(offered[name].suits, one.facts)), "") for one in sound]
    name = next((name for name in offered if name in suiting), "")
    if not name:
        return usual, "", ""
    count, mixed = suiting.count(name), entries[name].mixed
    if count < len(sound) and mixed and not any(source.named for source in sound):
        return mixed, f"{app}: recipe {mixed}, since {count} of {len(sound)} inputs have {entries[name].help}", ""
    if other := next((source for source, its in zip(sound, suiting, strict=True) if its != name), None):
        raise BadOption(
            f"{app}: {sound[suiting.index(name)].path} has {entries[name].help}, {other.path} has not, and recipes for "
            f"these differ; fit them by two commands, or all by --recipe {name} or --recipe {FULL_RECIPE_NAME}."
        )
    if entries[name].lacks and (missing := load_reference(entries[name].lacks)()):
        return usual, "", f"{app}: {missing}"
    return name, f"{app}: recipe {name}, since every {_noun(options)} has {entries[name].help}", ""


def _is_offered(options: FitOptions, name: str, entry: RecipeEntry, protocol: str) -> bool:
    """Test whether a recipe can be chosen for a paradigm: it suits some facts, and its checkpoints ship."""
    is_for = not entry.paradigms or options.paradigm in entry.paradigms
    return bool(entry.suits) and is_for and has_shipped_recipe(options.app, name)


def _noun(options: FitOptions) -> str:
    return "input" if options.inputs else f"task of {options.data}"
