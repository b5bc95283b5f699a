"""A run: the application, recipe, rule, paradigm and device that options name, its settings and its folder."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch

from data_tools.readers.input_source import Source
from metapp.appearance.presenter import Presenter
from metapp.apps import app_of, is_first_protocol, presenter_of, protocol_entry, recipe_of
from metapp.learned_rules import rule_of
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Recipe
from metapp.names import did_you_mean, rule_words
from metapp.options import FIT, INPUT, OUTPUT, BadOption
from metapp.paradigms import paradigm_of
from metapp.paradigms.paradigm import Paradigm
from metapp.runs.default_recipe import usual_recipe
from metapp.runs.environment import find_device, software_versions
from metapp.runs.fit_options import (
    FitOptions,
    app_options_of_record,
    check_options_of_protocol,
    fit_options,
    folder_name_parts,
)
from metapp.runs.inputs.finding import find_sources
from metapp.runs.recipe_choice import choose_protocol_and_recipe
from metapp.runs.reporter import say
from metapp.storage import Document
from metapp.storage.checkpoint_files import content_digest
from metapp.storage.fit_folders import RunFolder


class Checkpoint(NamedTuple):
    """A checkpoint: phi, the place it was read from, and a digest of its file ("" if a paradigm needs none)."""

    phi: MetaParameters
    source: str
    digest: str


@dataclass(frozen=True)
class Run:
    """Options with all that they name looked up.

    Attributes:
        options: as given, with recipe and rule by their names; steps None if they are the recipe's.
        paradigm: of the application under its protocol, with the network of the recipe and of the rule.
        device: of all tensors.
        checkpoint: initialisation and rule of the fits; None until `checkpoints.with_checkpoint` has read it.
        sources: what its inputs were found to be.
    """

    options: FitOptions
    paradigm: Paradigm
    device: torch.device
    checkpoint: Checkpoint | None = None
    sources: Sequence[Source] = ()

    @classmethod
    def of(cls, options: FitOptions, sources: Sequence[Source] | None = None) -> Run:
        """Look up the names in options, and choose by the sources what they leave open; nothing is written.

        Args:
            options: of the run.
            sources: of its inputs, as `find_sources` finds them; None: they are found now.

        Raises:
            BadOption: a rule that the application cannot have, or options that the recipe does not have.
            ValueError: no such device, paradigm or data set; an input that no format reads.
        """
        kind = paradigm_of(options.paradigm)
        found = tuple(find_sources(options) if sources is None else sources)
        choice = choose_protocol_and_recipe(options, found)
        for line in filter(None, [choice.missing] if options.quiet else choice.reasons):
            say(line)
        name = choice.recipe
        options = replace(options, observe="" if options.objects and not options.observe else choice.protocol)
        check_options_of_protocol(options)
        usual = recipe_of(options.app, name, options.observe)
        recipe = _adapted(options, name, usual)
        if recipe == usual:  # by options that say what it does anyway
            options = replace(options, own=type(options.own)(**options.own.non_default_values(INPUT, OUTPUT)))
        rule = _rule_name(options, recipe)
        app = app_of(options.app, recipe, options.observe, rule=rule if kind.has_learned_rule else "")
        try:
            files = options.own.non_default_values(OUTPUT)
            presenter_of(app, files)
        except ValueError as error:
            raise BadOption(str(error)) from None
        paradigm = kind.of(app, recipe, rule, options.steps)
        steps = None if paradigm == kind.of(app, recipe, rule) else paradigm.steps
        options = replace(options, recipe=name, rule=rule, steps=steps)
        return cls(options, paradigm, find_device(options.device, app), sources=found)

    @classmethod
    def of_settings(cls, settings: Document, options: Mapping[str, object] | None = None, **more: Any) -> Run:
        """The run that a fit was made by, as far as the settings of its record say it.

        Args:
            settings: of the record.
            options: of extensions, beside those that the record states.
            more: further options, as of `FitOptions`.

        Raises:
            BadOption: one of `options`.
            ValueError: settings that are not known here.
        """
        app, inputs = settings["app"], more.pop("inputs", ())
        own = app_options_of_record(app, settings.get("options", {}), inputs=bool(inputs)) | dict(options or {})
        paradigm = settings.get("paradigm", FitOptions.paradigm)
        rule = settings.get("rule", "") if paradigm_of(paradigm).has_learned_rule else ""
        given = {"rule": rule, "recipe": settings["recipe"]}
        given |= {"observe": settings.get("observe", ""), "quiet": True, **more}
        try:
            return cls.of(fit_options(app, paradigm, inputs, **own, **given))
        except BadOption as error:
            if options:
                raise
            raise ValueError(f"{app}: a fit of other settings than are known ({error})") from None

    @functools.cached_property
    def app(self) -> App:
        """The application of its paradigm."""
        return self.paradigm.app

    @functools.cached_property
    def presenter(self) -> Presenter[Any]:
        """What people look at of its fits, with the options of output such as the size of files."""
        return presenter_of(self.app, self.options.own.non_default_values(OUTPUT))

    @functools.cached_property
    def recipe(self) -> Recipe:
        """The recipe of its paradigm."""
        return self.paradigm.recipe

    @property
    def phi(self) -> MetaParameters:
        """The parameters of the checkpoint, which must have been read."""
        assert self.checkpoint is not None
        return self.checkpoint.phi

    def settings(self, label: str) -> Document:
        """All that errors and seconds of fits to this data depend on: the settings in their records."""
        paradigm, app = self.paradigm, self.app
        own = self.options.own.recorded_values()
        adam, guard = paradigm.adam(self.phi), paradigm.guard
        assert self.checkpoint is not None
        return {
            "app": app.name,
            **protocol_entry(app),
            "paradigm": paradigm.name,
            "rule": self.options.rule if paradigm.has_learned_rule else ("adam" if adam else "none"),
            "steps": paradigm.steps,
            "batch": self.recipe.batch,
            "adam": adam and asdict(adam),
            **({"guard": asdict(guard)} if guard else {}),
            "checkpoint": self.checkpoint.digest,
            "data": label,
            "recipe": self.options.recipe,
            **({"options": own} if own else {}),
            "seed": self.options.seed,
            "device": str(self.device),
            "versions": software_versions(),
            **app.conditions(self.device if paradigm.steps else None),
        }

    def folder(self, label: str) -> RunFolder:
        """Return the folder of fits to data of this label."""
        return RunFolder(self.path(label), self.settings(label))

    def path(self, label: str, kind: str = "") -> Path:
        """runs/<app>/<paradigm>, with the options that are not at their default, as meta-materials-1a2b3c-quick-seed3.

        Args:
            label: of the data.
            kind: of records that are no paradigm's fits, in place of its name.
        """
        options, app = self.options, self.app
        rule = options.rule if kind or self.paradigm.has_learned_rule else ""
        given = str(options.checkpoint.resolve()) if options.checkpoint else ""
        origin = self.checkpoint.digest if self.checkpoint else content_digest(given)
        words = [
            kind or self.paradigm.name,
            label if options.data and not options.paths else "",
            options.recipe if options.recipe != usual_recipe(app.name) else "",
            rule if rule != self.recipe.rule else "",
            *folder_name_parts(options.own),
            "" if options.steps is None else f"{options.steps}steps",
            "" if is_first_protocol(app) else app.protocol,
            f"checkpoint-{origin[:6]}" if given and origin else "",
            f"seed{options.seed}" if options.seed else "",
        ]
        return options.out / app.name / "-".join(filter(None, words))

    def origin(self, inputs: Sequence[Path]) -> Document:
        """The places of inputs and data set, by which they are found again: absolute paths, as far as given."""
        data = self.options.data
        places: Document = {
            "inputs": [str(path.absolute()) for path in inputs],
            "data": data and str(data.absolute()),
        }
        return {key: value for key, value in places.items() if value}


def _adapted(options: FitOptions, name: str, recipe: Recipe) -> Recipe:
    """A recipe as the application's own options change it, or a usage error."""
    try:
        adapted: Recipe = options.own.adapt_recipe(recipe)
    except ValueError as error:
        own = ", ".join(f"--{key} {value}" for key, value in options.own.non_default_values(FIT).items())
        raise BadOption(f"{own}, by recipe {name}: {error}.") from None
    return adapted


def _rule_name(options: FitOptions, recipe: Recipe) -> str:
    """The one name of a rule or composition, the recipe's default if none is asked for, or a usage error."""
    if not options.rule:
        return recipe.rule
    try:
        rule = rule_of(options.rule)
        app = app_of(options.app, recipe, options.observe, rule=rule.name)
        theta = {key: value[0] for key, value in app.init(torch.Generator().manual_seed(0), 1).items()}
        rule.check_app(app, theta)
    except ValueError as error:
        words = rule_words()
        unknown = [word for word in options.rule.split("+") if word not in words]
        raise BadOption(f"--rule: {error}{did_you_mean(unknown[0], words) if unknown else ''}") from None
    return rule.name
