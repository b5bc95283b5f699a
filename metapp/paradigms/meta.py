"""Meta: an initialisation and a rule that were learned, together, to be good after a few steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Generator

from metapp.learned_rules import rule_of
from metapp.learning.adjoint import Loss, RuleStep, UpdateRule
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters, after_learning, expand_tasks, learn, over_tasks, task_loss
from metapp.learning.random_tensors import Rng
from metapp.learning.recipe import Adam, Guard, MetaTraining, Recipe
from metapp.learning.rules.rule import LearnedRule
from metapp.learning.task import Params, Tasks
from metapp.paradigms.adam import General, GeneralPreparation, encoder_prediction, predict_parameters
from metapp.paradigms.paradigm import PARALLEL_TASKS, Paradigm, Preparation, fastest_steps

MAX_STATISTICS_TASKS = 32  # tasks whose gradients settle parts of a rule


@dataclass(frozen=True)
class Meta(Paradigm):
    """A few steps of a learned rule from a learned initialisation.

    Attributes:
        learned_rule: the learned rule before its hyperparameters are known.
    """

    learned_rule: LearnedRule
    name = "meta"
    has_learned_rule = True

    @classmethod
    def of(cls, app: App, recipe: Recipe, rule: str = "", steps: int | None = None) -> Self:
        """Return Meta for an application by a recipe; `rule` names a learned rule, "" the recipe's."""
        return cls(app, recipe, cls._steps(recipe, steps), rule_of(rule or recipe.rule))

    @staticmethod
    def _usual_steps(recipe: Recipe) -> int:
        """Return the number of inner gradient steps (n_l in the paper)."""
        return recipe.steps

    @property
    def preparations(self) -> tuple[Preparation, ...]:
        """The training of the learned rule with its initialisation."""
        return (MetaPreparation(replace(self, steps=self.recipe.steps)),)

    @property
    def guard(self) -> Guard:
        """The doubtful fits: as the training says for the recipe's rule and number of steps.

        Of other rules, and after other steps, those that end above their initialisation; QuickFT's Adam is their
        fallback.
        """
        as_trained = self.recipe.training(self.learned_rule.name).guard if self.steps == self.recipe.steps else None
        return as_trained or Guard(self.recipe.quickft)

    @property
    def loss(self) -> Loss:
        """The loss that the steps of the learned rule descend."""
        return self.learned_rule.loss(self.app, super().loss)

    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Return theta_0, which all tasks share; or the prediction of an encoder that was trained through the steps."""
        start = predict_parameters(self.app, phi, tasks, rng) if phi.encoder else expand_tasks(phi.theta, len(tasks), 0)
        return self.app.task_parameters(tasks) | start

    def rule(self, phi: MetaParameters, theta: Params, steps: int) -> UpdateRule:
        """Return the learned rule, for so many steps."""
        alpha = self.learned_rule.for_steps(phi.alpha, steps)
        return self.learned_rule.update_rule(expand_tasks(alpha, next(iter(theta.values())).shape[0], 1))


@dataclass(frozen=True)
class MetaPreparation(Preparation):
    """The training of a learned rule and its initialisation, through the steps of fits."""

    paradigm: Meta

    @property
    def name(self) -> str:
        """The rule's name."""
        return self.paradigm.learned_rule.name

    @property
    def general(self) -> Preparation:
        """The preparation of General, with the network of the rule."""
        return GeneralPreparation(General.of(self.paradigm.app, self.paradigm.recipe))

    @property
    def begins_at_general(self) -> bool:
        """True if the recipe takes the rule's first initialisation from General."""
        return self.outer_loop.from_general

    @property
    def outer_loop(self) -> MetaTraining:
        """The rule's training."""
        return self.paradigm.recipe.training(self.name)

    @property
    def first_adam(self) -> Adam | None:
        """The Adam that the rule is at first, if the recipe searches it."""
        return self.outer_loop.first if self.outer_loop.tuned else None

    def first_phi(self, general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """Return an encoder, the mean of General's predictions or a random theta_0; and the rule as a plain Adam."""
        app, kind, encoder, theta = self.paradigm.app, self.outer_loop.initialisation, {}, {}
        if kind == "untrained":
            encoder = app.init_encoder(rng)
        elif general and kind == "encoder":
            encoder = general.encoder
        elif general and kind == "mean":
            theta = {key: value.mean(0) for key, value in predict_parameters(app, general, tasks, rng).items()}
        random = {key: value[0] for key, value in app.init(rng, 1).items()}
        alpha = self._alpha(random, self.outer_loop.first)
        phi = MetaParameters({} if encoder else theta or random, alpha, encoder)
        return self._with_gradients(phi, tasks, rng)

    def template(self, phi: MetaParameters) -> MetaParameters:
        """Return fresh hyperparameters, and an encoder if phi has one, else an initialisation."""
        alpha, rng = self._alpha(self._theta(), self.outer_loop.first), Generator().manual_seed(0)
        if phi.encoder:
            return MetaParameters({}, alpha, self.paradigm.app.init_encoder(rng))
        return MetaParameters(self._theta(), alpha)

    def outer_loss(self, phi: MetaParameters) -> Loss:
        """Return the loss that is left after the steps of a fit (alg. 3)."""
        paradigm, app, training = self.paradigm, self.paradigm.app, self.outer_loop
        lifted = after_learning(
            paradigm.loss,
            paradigm.learned_rule.update_rule,
            steps=paradigm.steps,
            order=training.order,
            clip=training.clip,
            prediction=encoder_prediction(app) if phi.encoder else None,
            outer_loss=task_loss(app, paradigm.recipe.batch, outer=True),
            steps_of=fastest_steps(compiles=app.single_threaded),
        )
        return over_tasks(lifted, count=training.tasks, augment=app.augment if training.augment else None)

    def with_adam(self, phi: MetaParameters, adam: Adam) -> MetaParameters:
        """Return phi whose rule is this Adam at first, but for hyperparameters that gradients settled."""
        fresh, prefixes = self._alpha(self._theta(), adam), self.paradigm.learned_rule.settled
        settled = {name: value for name, value in phi.alpha.items() if name.startswith(prefixes)}
        return phi._replace(alpha={name: value.to(phi.alpha[name]) for name, value in (fresh | settled).items()})

    def _theta(self) -> Params:
        """Return random parameters of one task, without a task axis."""
        return {key: value[0] for key, value in self.paradigm.app.init(Generator().manual_seed(0), 1).items()}

    def _alpha(self, theta: Params, adam: Adam) -> Params:
        """Return the hyperparameters by which the rule is an Adam, for parameters of one task."""
        paradigm = self.paradigm
        return paradigm.learned_rule.initial_alpha(paradigm.app, theta, paradigm.steps, adam)

    def _with_gradients(self, phi: MetaParameters, tasks: Tasks, rng: Generator) -> MetaParameters:
        """Return phi with the values that parts of its rule, if any, take from gradients of fits of training tasks."""
        paradigm, learned_rule = self.paradigm, self.paradigm.learned_rule
        if not learned_rule.settled:
            return phi
        total: Params = {}
        count = min(len(tasks), MAX_STATISTICS_TASKS)
        for some in torch.arange(count).split(PARALLEL_TASKS):
            part = tasks.select([int(i) * len(tasks) // count for i in some])
            theta = paradigm.initialisation(phi, part, rng)
            rule = paradigm.rule(phi, theta, paradigm.steps)

            def recording(
                alpha: Params, theta: Params, grads: Params, state: Params, step: RuleStep = rule.step
            ) -> tuple[Params, Params]:
                for name, value in learned_rule.gather(phi.alpha, grads).items():
                    total[name] = total.get(name, 0) + value
                return step(alpha, theta, grads, state)

            learn(theta, rule._replace(step=recording), part, paradigm.loss, steps=paradigm.steps, rng=rng)
        return phi._replace(alpha=learned_rule.settle(phi.alpha, total))
