"""From options to a plan: the application, its recipe, rule and steps, the paradigm, the device, the run's folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.apps import app_of, recipes_of
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.names import composition_names, rule_names
from metapp.learning.recipe import Recipe
from metapp.learning.rules import rule_of
from metapp.options import FIT, BadOption
from metapp.paradigms import PARADIGMS, Paradigm
from metapp.runs.checkpoints.shipped import usual_recipe
from metapp.runs.choosing import chosen_recipe
from metapp.runs.naming import is_first_protocol, observe_of
from metapp.runs.options import FitOptions, name_parts
from metapp.runs.surroundings import find_device, precision_of, versions
from metapp.storage import Document
from metapp.storage.records import digest
from metapp.storage.text import meant


class Checkpoint(NamedTuple):
    """A checkpoint, where it came from and a digest of its file ("" where nothing is needed)."""

    prepared: MetaParameters
    source: str
    digest: str


@dataclass(frozen=True)
class Plan:
    """Options with all that they name looked up.

    Attributes:
        options: as given, with recipe and rule by their names; steps None where they are the recipe's.
        paradigm: what fits, for the application under its protocol, with the network of the recipe and of the rule.
        device: what it works with.
        checkpoint: what fits begin at; None until `checkpoints.find_checkpoint` has found it.
    """

    options: FitOptions
    paradigm: Paradigm
    device: torch.device
    checkpoint: Checkpoint | None = None

    @property
    def app(self) -> App:
        """The application of its paradigm."""
        return self.paradigm.app

    @property
    def recipe(self) -> Recipe:
        """The recipe of its paradigm."""
        return self.paradigm.recipe

    @property
    def steps(self) -> int:
        """Gradient steps of a fit."""
        return self.paradigm.steps

    @property
    def prepared(self) -> MetaParameters:
        """The parameters of the checkpoint, which must have been found."""
        assert self.checkpoint is not None
        return self.checkpoint.prepared

    def by(self, paradigm: str, rule: str = "") -> Plan:
        """The same for another paradigm and rule ("" for the same one), of the recipe's steps, without a checkpoint."""
        rule = rule or self.paradigm.rule_name
        options = replace(self.options, paradigm=paradigm, rule=rule, steps=None)
        app = app_of(self.app.name, self.recipe, self.app.protocol, rule=rule if paradigm == "meta" else "")
        built = PARADIGMS[paradigm](replace(app, size=self.app.size), self.recipe, rule)
        return replace(self, options=options, paradigm=built, checkpoint=None)

    def settings(self, label: str) -> Document:
        """Everything that figures of a run on data of this name depend on: what its records carry, and their key."""
        paradigm, app = self.paradigm, self.app
        own = self.options.own.recorded()
        adam, guard = paradigm.adam(self.prepared), paradigm.guard
        assert self.checkpoint is not None
        return {
            "app": app.name,
            **observe_of(app),
            "paradigm": paradigm.name,
            "rule": paradigm.rule_name if paradigm.name == "meta" else ("adam" if adam else "none"),
            "steps": self.steps,
            "batch": self.recipe.batch,
            "adam": adam and asdict(adam),
            **({"guard": asdict(guard)} if guard else {}),
            "checkpoint": self.checkpoint.digest,
            "data": label,
            "recipe": self.options.recipe,
            **({"options": own} if own else {}),
            "seed": self.options.seed,
            "device": str(self.device),
            "versions": versions(),
            **app.conditions(),
            **precision_of(app, self.device, self.steps),
        }

    def path(self, label: str, kind: str = "", rule: str = "") -> Path:
        """runs/<app>/<paradigm>, with what is not the default, as meta-materials-1a2b3c-quick-seed3.

        Args:
            label: of the data.
            kind: of records that are no paradigm's fits, in place of its name.
            rule: that these depend on; "" for none.
        """
        options, app = self.options, self.app
        rule = rule or (self.paradigm.rule_name if self.paradigm.name == "meta" and not kind else "")
        given = str(options.checkpoint.resolve()) if options.checkpoint else ""
        origin = self.checkpoint.digest if self.checkpoint else digest(given)
        words = [
            kind or self.paradigm.name,
            label if options.data and not options.paths else "",
            options.recipe if options.recipe != usual_recipe(app.name) else "",
            rule if rule != self.recipe.rule else "",
            *name_parts(options.own),
            "" if options.steps is None else f"{options.steps}steps",
            "" if is_first_protocol(app) else app.protocol,
            f"checkpoint-{origin[:6]}" if given and origin else "",
            f"seed{options.seed}" if options.seed else "",
        ]
        return options.out / app.name / "-".join(filter(None, words))

    def origin(self, inputs: Sequence[Path]) -> Document:
        """Where inputs and data set are, by which they are found again: absolute paths, as far as given."""
        data = self.options.data
        places: Document = {
            "inputs": [str(path.absolute()) for path in inputs],
            "data": data and str(data.absolute()),
        }
        return {key: value for key, value in places.items() if value}


def plan(options: FitOptions) -> Plan:
    """Look up what options name; no task is read and nothing is written.

    Raises:
        BadOption: a rule that the application cannot have, or options that the recipe does not have.
        ValueError: no such device, paradigm or data set.
    """
    kind = PARADIGMS.get(options.paradigm)
    if kind is None:
        names = ", ".join(PARADIGMS)
        raise ValueError(f"paradigm '{options.paradigm}': expected one of {names}.{meant(options.paradigm, PARADIGMS)}")
    name = options.recipe or chosen_recipe(options)
    usual = recipes_of(options.app, options.observe)[name]
    try:
        recipe = options.own.adapt(usual)
    except ValueError as error:
        own = ", ".join(f"--{key} {value}" for key, value in options.own.given(FIT).items())
        raise BadOption(f"{own}, by recipe {name}: {error}.") from None
    if recipe == usual:  # by options that say what it does anyway
        options = replace(options, own=replace(options.own, **options.own.defaults(FIT)))
    rule = _rule_name(options, recipe)
    app = app_of(options.app, recipe, options.observe, rule=rule if kind.name == "meta" else "")
    try:
        app = replace(app, size=getattr(options.own, "size", None))
    except ValueError as error:
        raise BadOption(str(error)) from None
    built = kind(app, recipe, rule)
    steps = None if built.recipe_steps in (options.steps, 0) else options.steps
    options = replace(options, recipe=name, rule=rule, steps=steps)
    return Plan(options, replace(built, asked_steps=steps), find_device(options.device, app))


def _rule_name(options: FitOptions, recipe: Recipe) -> str:
    """The one name of a rule or composition, the recipe's default where none is asked for, or a usage error."""
    if not options.rule:
        return recipe.rule
    try:
        rule = rule_of(options.rule)
        app = app_of(options.app, recipe, options.observe, rule=rule.name)
        theta = {key: value[0] for key, value in app.init(torch.Generator().manual_seed(0), 1).items()}
        rule.require(app, theta)
    except ValueError as error:
        words = [*rule_names(), *composition_names()]
        unknown = [word for word in options.rule.split("+") if word not in words]
        raise BadOption(f"--rule: {error}{meant(unknown[0], words) if unknown else ''}") from None
    return rule.name
