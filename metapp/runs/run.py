"""A run: the application, recipe, rule, paradigm and device that options name, its settings and its folder.

A run is what one command does, as data: it is looked up before anything is read or fitted, and writes nothing. Its
checkpoint is read by `metapp.runs.checkpoint_selection`, its inputs are fitted by `metapp.runs.fitting`.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch

from data_tools.readers.input_source import Source
from metapp.appearance.presenter import Presenter
from metapp.application import Application
from metapp.entries import did_you_mean
from metapp.learned_rules import rule_of
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Recipe
from metapp.options import FIT, INPUT, OUTPUT, BadOption
from metapp.paradigms import paradigm_of
from metapp.paradigms.paradigm import Paradigm
from metapp.registry import registry
from metapp.runs.environment import find_device, software_versions
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
from metapp.storage import Document
from metapp.storage.files import content_digest
from metapp.storage.fit_folders import RunFolder


class Checkpoint(NamedTuple):
    """The checkpoint that fits of a run begin at.

    Attributes:
        phi: the meta-parameters.
        source: the place that they were read from, in words.
        digest: 12 hexadecimal digits of the file's content; "" if the paradigm needs no checkpoint.
    """

    phi: MetaParameters
    source: str
    digest: str


@dataclass(frozen=True)
class Run:
    """The options of one command or one call, with all that they name looked up.

    Attributes:
        options: the options as given, with the names of the chosen recipe and rule; `steps` is None if it is the
            recipe's number.
        paradigm: the paradigm for the application, with the network of the recipe and of the rule.
        device: the device of all tensors.
        checkpoint: initialisation and rule of the fits; None until
            :func:`metapp.runs.checkpoint_selection.attach_checkpoint` has read it.
        sources: the files, folders or data set that the inputs were found to be.
    """

    options: FitOptions
    paradigm: Paradigm
    device: torch.device
    checkpoint: Checkpoint | None = None
    sources: Sequence[Source] = ()

    @classmethod
    def from_options(cls, options: FitOptions, sources: Sequence[Source] | None = None) -> Run:
        """Look up the names in options, and choose by the sources what options leave open; nothing is written.

        Args:
            options: the options of the run.
            sources: the sources of its inputs, which `find_sources` returns; None to find them now.

        Raises:
            BadOption: the application cannot have the rule, or the recipe does not have an option.
            ValueError: there is no such device, paradigm or data set, or no format reads an input.
        """
        paradigm_class = paradigm_of(options.paradigm)
        sources_found = tuple(find_sources(options) if sources is None else sources)
        choice = choose_recipe(options, sources_found)
        for line in filter(None, [choice.missing_file_line] if options.quiet else choice.reasons):
            say(line)
        application, recipe_name = options.application, choice.name
        options = replace(options, observe="" if options.objects and not options.observe else choice.observes)
        check_recipe_and_options(options)
        unchanged = application.recipes_observing(options.observe)[recipe_name].load()
        recipe = _adapt_recipe(options, recipe_name, unchanged)
        if recipe == unchanged:  # the options only say what the recipe does anyway: the run's folder need not name them
            options = replace(
                options, app_options=type(options.app_options)(**options.app_options.non_default_values(INPUT, OUTPUT))
            )
        rule = _rule_name(options, recipe)
        app = recipe.app_with(rule if paradigm_class.has_learned_rule else "")
        try:
            application.make_presenter(app, options.app_options.non_default_values(OUTPUT))
        except ValueError as error:
            raise BadOption(str(error)) from None
        paradigm = paradigm_class.of(app, recipe, rule, options.steps)
        steps = None if paradigm == paradigm_class.of(app, recipe, rule) else paradigm.steps
        options = replace(options, recipe=recipe_name, rule=rule, steps=steps)
        return cls(options, paradigm, find_device(options.device, app), sources=sources_found)

    @classmethod
    def from_settings(cls, settings: Document, options: Mapping[str, object] | None = None, **more: Any) -> Run:
        """Return the run that a fit was made by, as far as the settings in its record state it.

        Args:
            settings: the settings in the record.
            options: the application's own options that are set beside those of the record.
            more: fields of `FitOptions`, by name.

        Raises:
            BadOption: one of `options` is wrong.
            ValueError: this version of metapp does not know the settings.
        """
        application, inputs = application_named(settings["app"]), more.pop("inputs", ())
        app_values = app_options_of_record(application, settings.get("options", {}), inputs=bool(inputs)) | dict(
            options or {}
        )
        paradigm = settings.get("paradigm", FitOptions.paradigm)
        rule = settings.get("rule", "") if paradigm_of(paradigm).has_learned_rule else ""
        values = {"rule": rule, "recipe": settings["recipe"]}
        values |= {"observe": settings.get("observe", ""), "quiet": True, **more}
        try:
            return cls.from_options(fit_options(application.name, paradigm, inputs, **app_values, **values))
        except BadOption as error:
            if options:
                raise
            raise ValueError(f"{application.name}: a fit of other settings than are known ({error})") from None

    @property
    def application(self) -> Application:
        """The application, with its recipes, formats and exports."""
        return self.options.application

    @functools.cached_property
    def app(self) -> App:
        """The network of the fits, what they see and how they are judged."""
        return self.paradigm.app

    @functools.cached_property
    def presenter(self) -> Presenter[Any]:
        """The presenter of the application's fits, with options of output such as the size of files."""
        presenter: Presenter[Any] = self.application.make_presenter(
            self.app, self.options.app_options.non_default_values(OUTPUT)
        )
        return presenter

    @functools.cached_property
    def recipe(self) -> Recipe:
        """The recipe of the run."""
        return self.paradigm.recipe

    @property
    def phi(self) -> MetaParameters:
        """The meta-parameters of the checkpoint, which must have been read."""
        assert self.checkpoint is not None
        return self.checkpoint.phi

    def settings(self, label: str) -> Document:
        """Return the settings that records of fits state: all that errors and seconds depend on.

        Args:
            label: the label of the data that is fitted.
        """
        paradigm, app = self.paradigm, self.app
        app_options = self.options.app_options.recorded_values()
        adam, guard = paradigm.adam(self.phi), paradigm.guard
        assert self.checkpoint is not None
        return {
            "app": app.name,
            **app.observation,
            "paradigm": paradigm.name,
            "rule": self.options.rule if paradigm.has_learned_rule else ("adam" if adam else "none"),
            "steps": paradigm.steps,
            "batch": self.recipe.samples,
            "adam": adam and asdict(adam),
            **({"guard": asdict(guard)} if guard else {}),
            "checkpoint": self.checkpoint.digest,
            "data": label,
            "recipe": self.options.recipe,
            **({"options": app_options} if app_options else {}),
            "seed": self.options.seed,
            "device": str(self.device),
            "versions": software_versions(),
            **app.recorded_conditions(self.device if paradigm.steps else None),
        }

    def folder(self, label: str) -> RunFolder:
        """Return the folder of fits to data of a label, which compares records with the settings of this run."""
        return RunFolder(self.path(label), self.settings(label))

    def path(self, label: str, kind: str = "") -> Path:
        """Return the path of the run's folder, such as runs/brdf/meta-materials-1a2b3c-quick-seed3.

        The name has the paradigm and all options that are not at their default.

        Args:
            label: the label of the data.
            kind: the kind of records that are not fits by the paradigm, which then stands in place of its name.
        """
        options, app = self.options, self.app
        rule = options.rule if kind or self.paradigm.has_learned_rule else ""
        checkpoint_path = str(options.checkpoint.resolve()) if options.checkpoint else ""
        digest = self.checkpoint.digest if self.checkpoint else content_digest(checkpoint_path)
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

    def input_places(self, inputs: Sequence[Path]) -> Document:
        """Return the absolute paths of inputs and data set, by which a later command finds them again.

        Args:
            inputs: the inputs, as the user gave them.

        Returns:
            The paths by "inputs" and "data"; an entry is left out if there is nothing to name.
        """
        data = self.options.data
        places: Document = {
            "inputs": [str(path.absolute()) for path in inputs],
            "data": data and str(data.absolute()),
        }
        return {key: value for key, value in places.items() if value}


def _adapt_recipe(options: FitOptions, name: str, recipe: Recipe) -> Recipe:
    """Change a recipe as the application's own options ask for.

    Args:
        options: the options of the run.
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
