"""The rule study: update rules trained alike, with the same few outer steps, at several numbers of gradient steps."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import NamedTuple

from torch import Generator

from metapp.learning.names import rule_names
from metapp.learning.recipe import Initialisation, MetaTraining, Recipe
from metapp.learning.rules import rule_of
from metapp.paradigms import Job, paradigms
from metapp.runs.checkpoints.finding import find_checkpoint, trained_path
from metapp.runs.checkpoints.training import Trained, general_of, train_checkpoint
from metapp.runs.requests.naming import observe_of
from metapp.runs.requests.plan import Checkpoint, Plan
from metapp.runs.surroundings import precision_of, versions
from metapp.storage.records import Record, load_checkpoint, tensor_digest

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
    "adam+loss",
    "adam+loss+eps",
    "adam+loss+average",
    "adam+loss+basis",
    "adam+loss+curvature+average",
    "adam+loss+curvature+basis",
)


class Design(NamedTuple):
    """The design of a study.

    Attributes:
        train_steps: outer steps of each training.
        steps: numbers of gradient steps; each rule is trained for each of them.
        seeds: how many seeds of training and fitting, from the plan's own on.
        initialisation: the first one of all rules. With "encoder", which is QuickFT's too, rules alone differ.
        rule: what is trained; "" for all named rules and COMPOSED.
    """

    train_steps: int = 500
    steps: Sequence[int] = (5, 10, 20, 40)
    seeds: int = 3
    initialisation: Initialisation = "encoder"
    rule: str = ""


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


def training_for(recipe: Recipe, rule: str) -> MetaTraining:
    """The training of a rule: as the recipe has it, else as that of its rules whose directions are of the same length.

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
        design: what is trained.
        rules: what is studied.
        refused: why further rules do not apply to the application, by name.
    """

    def __init__(self, plan: Plan, design: Design) -> None:
        self.plan, self.design = plan, design
        theta = {key: value[0] for key, value in plan.app.init(Generator().manual_seed(0), 1).items()}
        texts = [design.rule] if design.rule else [*rule_names(), *COMPOSED]
        names = dict.fromkeys(rule_of(text).name for text in texts)
        reasons = {name: [part.refusal(plan.app, theta) for part in rule_of(name).parts] for name in names}
        self.refused = {name: next(filter(None, some)) for name, some in reasons.items() if any(some)}
        self.rules = [name for name in names if name not in self.refused]

    def cases(self) -> list[Case]:
        """All trainings: seed by seed, those of few steps first."""
        first = self.plan.request.seed
        seeds = range(first, first + self.design.seeds)
        counts = sorted(set(self.design.steps))
        return [Case(rule, steps, seed) for seed in seeds for steps in counts for rule in (QUICKFT, *self.rules)]

    def plan_of(self, case: Case) -> Plan:
        """The plan of a case: its recipe is the application's for so many steps, under a name of its own."""
        rule = self.plan.job.rule if case.rule == QUICKFT else case.rule
        base = self.plan.job.recipe
        meta = base.meta if case.rule == QUICKFT else {rule: self.training(rule)}
        recipe = replace(base, steps=case.steps, meta=meta, rule=next(iter(meta)))
        request = self.plan.request
        name = f"{request.recipe}-{case.steps}steps"
        if case.rule != QUICKFT:
            name += f"-{self.design.train_steps}outer-{self.design.initialisation}"
        request = replace(request, recipe=name, rule=rule, seed=case.seed, steps=None, checkpoint=None)
        paradigm = paradigms()[QUICKFT if case.rule == QUICKFT else "meta"]
        return Plan(request, paradigm, Job(self.plan.app, recipe, rule), self.plan.device)

    def training(self, rule: str) -> MetaTraining:
        """The training of a rule here: as by its recipe, but for the initialisation, and with so many outer steps.

        A recipe that searches an Adam alone does so here, too.
        """
        training = training_for(self.plan.job.recipe, rule)
        first = self.design.initialisation
        if first == "encoder" and training.initialisation != "encoder":
            training = replace(training, rates={"encoder.": ENCODER_RATE} | training.rates)
        return replace(training, initialisation=first, steps=self.design.train_steps if training.steps else 0)

    @functools.cached_property
    def general(self) -> Checkpoint:
        """The General that all rules begin at and QuickFT is tuned for, trained now if this data has none."""
        return general_of(self.plan)

    @functools.cached_property
    def _general_digest(self) -> str:
        return tensor_digest(self.general.prepared.encoder)

    def settings(self, case: Case, label: str) -> Record:
        """Everything that a training's result depends on, JSON-ready.

        Args:
            case: which.
            label: the data's name.
        """
        plan, quickft = self.plan_of(case), case.rule == QUICKFT
        training = None if quickft else asdict(self.training(case.rule))
        return {
            "app": plan.app.name,
            **observe_of(plan.app),
            "study": case.rule,
            "steps": case.steps,
            "training": training,
            "general": self._general_digest,
            "batch": plan.job.recipe.batch,
            "data": label,
            "recipe": self.plan.request.recipe,
            "seed": self.plan.request.seed if quickft else case.seed,
            "device": str(plan.device),
            "versions": versions(),
            **plan.app.conditions(),
            **precision_of(plan.app, plan.device, case.steps),
        }

    def train(self, case: Case) -> Trained:
        """Train a case's rule, or search its QuickFT."""
        return train_checkpoint(self._trained_by(case), None, self.general)

    def checkpoint(self, case: Case) -> Checkpoint:
        """The checkpoint that a case fits by.

        Raises:
            ValueError: it was not trained yet.
        """
        plan = self._trained_by(case)
        if case.rule != QUICKFT:
            checkpoint = find_checkpoint(plan).checkpoint
            assert checkpoint is not None
            return checkpoint
        path = trained_path(plan, QUICKFT)
        alpha = load_checkpoint(path, plan.device)[0].alpha
        return Checkpoint(self.general.prepared._replace(alpha=alpha), str(path), "")

    def _trained_by(self, case: Case) -> Plan:
        """The plan that a case is trained by: QuickFT's search draws nothing, so that one seed says all."""
        return self.plan_of(case._replace(seed=self.plan.request.seed) if case.rule == QUICKFT else case)
