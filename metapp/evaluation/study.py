"""The rule study: update rules trained alike, with the same few outer steps, at several numbers of gradient steps."""

from __future__ import annotations

import functools
from dataclasses import asdict, replace
from typing import Any, NamedTuple, get_args

from torch import Generator

from metapp.learning.recipe import Initialisation, MetaTraining, Recipe
from metapp.learning.rules import RULES, rule_of
from metapp.paradigms import Paradigm, paradigms
from metapp.runs.checkpoints import Trained, find_checkpoint, general_of, has_general, train_checkpoint
from metapp.runs.checkpoints import trained_path as path_of
from metapp.runs.session import Checkpoint, Options, observe_of, precision_of, versions
from metapp.storage.records import load_checkpoint, tensor_digest

STARTS = get_args(Initialisation)
ENCODER_RATE = 3e-4  # outer rate of General's encoder where the recipe's own training moves none
QUICKFT = "quickft"  # the reference line, among the names of rules
# Beside all named rules, what one part adds to a rule or what its lack does.
COMPOSED = (
    "sgd+loss",
    "sgd+curvature",
    "sgd+average",
    "rates+loss",  # SGD with a rate per weight and step
    "adam",
    "adam+curvature",
    "adam+loss+eps",
    "adam+loss+average",
    "adam+loss+basis",
    "adam+loss+curvature+average",
    "adam+loss+curvature+basis",
)


class Budget(NamedTuple):
    """How much a study trains.

    Attributes:
        outer: outer steps of each training.
        steps: numbers of gradient steps; each rule is trained for each of them.
        seeds: how many seeds of training and fitting, from the options' own on.
        start: the first initialisation of all rules. From "encoder", which is QuickFT's too, rules alone differ.
        rules: what is trained; () for all named rules and COMPOSED.
    """

    outer: int = 500
    steps: tuple[int, ...] = (5, 10, 20, 40)
    seeds: int = 3
    start: Initialisation = "encoder"
    rules: tuple[str, ...] = ()


class Case(NamedTuple):
    """One training of a study, and the fits by it.

    Attributes:
        rule: its name, or QUICKFT.
        steps: gradient steps.
        seed: of training and fits; QuickFT's search draws nothing, so that its seed is of fits alone.
    """

    rule: str
    steps: int
    seed: int

    @property
    def paradigm(self) -> Paradigm:
        """What fits."""
        return paradigms()[QUICKFT if self.rule == QUICKFT else "meta"]


def study_rules(options: Options, budget: Budget) -> tuple[list[str], dict[str, str]]:
    """The rules of a study, and why further ones do not apply to the application, by name."""
    theta = {key: value[0] for key, value in options.app.init(Generator().manual_seed(0), 1).items()}
    found, refused = [], {}
    for name in dict.fromkeys(rule_of(each).name for each in budget.rules or (*RULES, *COMPOSED)):
        reasons = [reason for part in rule_of(name).parts if (reason := part.refusal(options.app, theta))]
        if reasons:
            refused[name] = reasons[0]
        else:
            found.append(name)
    return found, refused


def training_for(recipe: Recipe, rule: str) -> MetaTraining:
    """How a rule is trained: as the recipe has it, else as that of its rules whose directions are of the same length.

    Without Adam's moments a direction is the gradient itself: that takes the rates of meta-sgd, or a search of one.
    """
    usual = recipe.training(rule if rule in recipe.meta else recipe.rule)
    if rule in recipe.meta or rule_of(rule).has("betas"):
        return usual
    return recipe.meta.get("meta-sgd") or replace(usual, tuned=True)


class Study:
    """A study of one application on one data set.

    Attributes:
        options: of the application's own recipe.
        budget: how much is trained.
        rules: what is studied.
        refused: why further rules do not apply to the application, by name.
    """

    def __init__(self, options: Options, budget: Budget) -> None:
        self.options, self.budget = options, budget
        self.rules, self.refused = study_rules(options, budget)

    def cases(self) -> list[Case]:
        """All trainings: seed by seed, those of few steps first."""
        seeds = range(self.options.seed, self.options.seed + self.budget.seeds)
        steps = sorted(set(self.budget.steps))
        return [Case(rule, each, seed) for seed in seeds for each in steps for rule in (QUICKFT, *self.rules)]

    def place(self, case: Case) -> Options:
        """The options of a case: its recipe is the application's for so many steps, under a name of its own."""
        rule = self.options.rule if case.rule == QUICKFT else case.rule
        name, recipe = self._recipe_name(case.rule, case.steps), self._recipe(case.rule, case.steps)
        return self.options._replace(recipe=name, own=recipe, rule=rule, seed=case.seed, steps=None, checkpoint=None)

    def _recipe_name(self, rule: str, steps: int) -> str:
        name = f"{self.options.recipe}-{steps}steps"
        return name if rule == QUICKFT else f"{name}-{self.budget.outer}outer-{self.budget.start}"

    def _recipe(self, rule: str, steps: int) -> Recipe:
        base = self.options.job.recipe
        meta = base.meta if rule == QUICKFT else {rule: self.training(rule)}
        return replace(base, steps=steps, meta=meta, rule=next(iter(meta)))

    def training(self, rule: str) -> MetaTraining:
        """How a rule is trained here: as by its recipe, but for the start, and with so many outer steps.

        A recipe that searches an Adam alone does so here, too.
        """
        training = training_for(self.options.job.recipe, rule)
        if self.budget.start == "encoder" and training.initialisation != "encoder":
            training = replace(training, rates={"encoder.": ENCODER_RATE} | training.rates)
        return replace(training, initialisation=self.budget.start, steps=self.budget.outer if training.steps else 0)

    @functools.cached_property
    def general(self) -> Checkpoint | None:
        """The General that all rules start from and QuickFT is tuned for; None where this data has none yet."""
        if not has_general(self.options):
            return None
        return find_checkpoint(self.options, paradigms()["general"])

    def require_general(self) -> Checkpoint:
        """General, trained now if this data has none."""
        if self.general is None:
            self.general = general_of(self.options)
        return self.general

    @functools.cached_property
    def _general_digest(self) -> str:
        return tensor_digest(self.require_general().prepared.encoder)

    def settings(self, case: Case, label: str) -> dict[str, Any]:
        """Everything that a training's result depends on, JSON-ready.

        Args:
            case: which.
            label: the data's name.
        """
        options = self.place(case)
        return {
            "app": options.app.name,
            **observe_of(options.app),
            "study": case.rule,
            "steps": case.steps,
            "training": None if case.rule == QUICKFT else asdict(self.training(case.rule)),
            "general": self._general_digest,
            "batch": options.job.recipe.batch,
            "data": label,
            "recipe": self.options.recipe,
            "seed": self.options.seed if case.rule == QUICKFT else case.seed,
            "device": str(options.device),
            "versions": versions(),
            **options.app.conditions(),
            **precision_of(options.app, options.device, case.steps),
        }

    def train(self, case: Case) -> Trained:
        """Train a case's rule, or search its QuickFT."""
        return train_checkpoint(self._trained_by(case), case.paradigm, None, self.require_general())

    def checkpoint(self, case: Case) -> Checkpoint:
        """What a case fits by.

        Raises:
            ValueError: it was not trained yet.
        """
        options = self._trained_by(case)
        if case.rule != QUICKFT:
            return find_checkpoint(options, case.paradigm)
        path = path_of(options, QUICKFT)
        general = self.require_general()
        prepared = general.prepared._replace(alpha=load_checkpoint(path, options.device)[0].alpha)
        return Checkpoint(prepared, str(path), "")

    def _trained_by(self, case: Case) -> Options:
        """The options that a case is trained by: QuickFT's search draws nothing, so that one seed says all."""
        return self.place(case._replace(seed=self.options.seed) if case.rule == QUICKFT else case)
