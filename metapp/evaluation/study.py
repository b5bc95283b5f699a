"""The rule study: update rules trained alike, with the same few outer steps, at several numbers of gradient steps."""

from __future__ import annotations

import functools
from dataclasses import asdict, replace
from typing import Any, NamedTuple, get_args

from torch import Generator

from metapp.learning.app import App
from metapp.learning.recipe import Initialisation, MetaTraining, Recipe
from metapp.learning.rules import RULES, rule_of
from metapp.paradigms import Job, Paradigm, paradigms
from metapp.runs.checkpoints import find_checkpoint, has_general, trained_path
from metapp.runs.naming import observe_of
from metapp.runs.plan import Checkpoint, Plan
from metapp.runs.surroundings import precision_of, versions
from metapp.runs.training import Trained, general_of, train_checkpoint
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
        seeds: how many seeds of training and fitting, from the plan's own on.
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


def study_rules(app: App, budget: Budget) -> tuple[list[str], dict[str, str]]:
    """The rules of a study, and why further ones do not apply to the application, by name."""
    theta = {key: value[0] for key, value in app.init(Generator().manual_seed(0), 1).items()}
    found, refused = [], {}
    for name in dict.fromkeys(rule_of(each).name for each in budget.rules or (*RULES, *COMPOSED)):
        reasons = [reason for part in rule_of(name).parts if (reason := part.refusal(app, theta))]
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
        plan: of the application's own recipe.
        budget: how much is trained.
        rules: what is studied.
        refused: why further rules do not apply to the application, by name.
    """

    def __init__(self, plan: Plan, budget: Budget) -> None:
        self.plan, self.budget = plan, budget
        self.rules, self.refused = study_rules(plan.app, budget)

    def cases(self) -> list[Case]:
        """All trainings: seed by seed, those of few steps first."""
        first = self.plan.request.seed
        seeds = range(first, first + self.budget.seeds)
        steps = sorted(set(self.budget.steps))
        return [Case(rule, each, seed) for seed in seeds for each in steps for rule in (QUICKFT, *self.rules)]

    def place(self, case: Case) -> Plan:
        """The plan of a case: its recipe is the application's for so many steps, under a name of its own."""
        rule = self.plan.job.rule if case.rule == QUICKFT else case.rule
        name, recipe = self._recipe_name(case.rule, case.steps), self._recipe(case.rule, case.steps)
        request = replace(self.plan.request, recipe=name, rule=rule, seed=case.seed, steps=None, checkpoint=None)
        return Plan(request, case.paradigm, Job(self.plan.app, recipe, rule), self.plan.device)

    def _recipe_name(self, rule: str, steps: int) -> str:
        name = f"{self.plan.request.recipe}-{steps}steps"
        return name if rule == QUICKFT else f"{name}-{self.budget.outer}outer-{self.budget.start}"

    def _recipe(self, rule: str, steps: int) -> Recipe:
        base = self.plan.job.recipe
        meta = base.meta if rule == QUICKFT else {rule: self.training(rule)}
        return replace(base, steps=steps, meta=meta, rule=next(iter(meta)))

    def training(self, rule: str) -> MetaTraining:
        """How a rule is trained here: as by its recipe, but for the start, and with so many outer steps.

        A recipe that searches an Adam alone does so here, too.
        """
        training = training_for(self.plan.job.recipe, rule)
        if self.budget.start == "encoder" and training.initialisation != "encoder":
            training = replace(training, rates={"encoder.": ENCODER_RATE} | training.rates)
        return replace(training, initialisation=self.budget.start, steps=self.budget.outer if training.steps else 0)

    @functools.cached_property
    def general(self) -> Checkpoint | None:
        """The General that all rules start from and QuickFT is tuned for; None where this data has none yet."""
        general = self.plan.by("general")
        return find_checkpoint(general).checkpoint if has_general(general) else None

    def require_general(self) -> Checkpoint:
        """General, trained now if this data has none."""
        if self.general is None:
            self.general = general_of(self.plan)
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
        plan = self.place(case)
        return {
            "app": plan.app.name,
            **observe_of(plan.app),
            "study": case.rule,
            "steps": case.steps,
            "training": None if case.rule == QUICKFT else asdict(self.training(case.rule)),
            "general": self._general_digest,
            "batch": plan.job.recipe.batch,
            "data": label,
            "recipe": self.plan.request.recipe,
            "seed": self.plan.request.seed if case.rule == QUICKFT else case.seed,
            "device": str(plan.device),
            "versions": versions(),
            **plan.app.conditions(),
            **precision_of(plan.app, plan.device, case.steps),
        }

    def train(self, case: Case) -> Trained:
        """Train a case's rule, or search its QuickFT."""
        return train_checkpoint(self._trained_by(case), None, self.require_general())

    def checkpoint(self, case: Case) -> Checkpoint:
        """What a case fits by.

        Raises:
            ValueError: it was not trained yet.
        """
        plan = self._trained_by(case)
        if case.rule != QUICKFT:
            found = find_checkpoint(plan).checkpoint
            assert found is not None
            return found
        path = trained_path(plan, QUICKFT)
        alpha = load_checkpoint(path, plan.device)[0].alpha
        return Checkpoint(self.require_general().prepared._replace(alpha=alpha), str(path), "")

    def _trained_by(self, case: Case) -> Plan:
        """The plan that a case is trained by: QuickFT's search draws nothing, so that one seed says all."""
        return self.place(case._replace(seed=self.plan.request.seed) if case.rule == QUICKFT else case)
