"""Meta: an initialisation and a rule, learned together to be good after a few steps.

The derivatives through the steps are in `metapp.learning`, and the loop of outer steps is in :mod:`training`. Here
is which initialisation, rule and loss they are applied to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Generator
from typing_extensions import override

from metapp.learned_rules import rule_of
from metapp.learning.adjoint import Loss, RuleStep, UpdateRule
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters, after_learning, expand_tasks, learn, over_tasks, task_loss
from metapp.learning.random_tensors import Rng
from metapp.learning.recipe import Adam, Guard, MetaTraining, Recipe
from metapp.learning.rules.rule import LearnedRule
from metapp.learning.task import Params, Tasks
from metapp.paradigms.adam import General, GeneralTraining, encoder_prediction, predict_parameters
from metapp.paradigms.paradigm import PARALLEL_TASKS, CheckpointTraining, Paradigm, fastest_steps

MAX_STATISTICS_TASKS = 32  # training tasks whose gradients determine hyperparameters of a rule


@dataclass(frozen=True)
class Meta(Paradigm):
    """A few steps of a learned rule from a learned initialisation.

    Attributes:
        learned_rule: the parts of the rule; the hyperparameters are in phi.
    """

    learned_rule: LearnedRule
    name = "meta"
    steps_field = "steps"  # n_l in the paper
    has_learned_rule = True

    @classmethod
    @override
    def of(cls, app: App, recipe: Recipe, rule: str = "", steps: int | None = None) -> Self:
        """Return Meta for an application by a recipe.

        Args:
            app: the application.
            recipe: the settings.
            rule: the name of a learned rule; "" for the recipe's default rule.
            steps: the number of gradient steps; None for the recipe's number.
        """
        return cls(app, recipe, cls._steps(recipe, steps), rule_of(rule or recipe.rule))

    @property
    @override
    def trainings(self) -> tuple[CheckpointTraining, ...]:
        """The training of the learned rule with its initialisation, through the recipe's number of steps."""
        return (RuleTraining(replace(self, steps=self.recipe.steps)),)

    @property
    @override
    def guard(self) -> Guard:
        """The guard that the rule's training in the recipe states, for fits of the recipe's number of steps.

        For other rules and after other steps, fits are doubtful that end above the loss of their initialisation, and
        QuickFT's Adam continues them.
        """
        trained_guard = self.recipe.training(self.learned_rule.name).guard if self.steps == self.recipe.steps else None
        return trained_guard or Guard(self.recipe.quickft)

    @property
    @override
    def loss(self) -> Loss:
        return self.learned_rule.loss(self.app, super().loss)

    @override
    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Return theta_0, which all tasks share, or the prediction of an encoder that was trained through the steps.

        Parameters that phi does not have are determined by tasks.
        """
        theta = predict_parameters(self.app, phi, tasks, rng) if phi.encoder else expand_tasks(phi.theta, len(tasks), 0)
        return self.app.task_parameters(tasks) | theta

    @override
    def rule(self, phi: MetaParameters, theta: Params, steps: int) -> UpdateRule:
        alpha = self.learned_rule.for_steps(phi.alpha, steps)
        return self.learned_rule.update_rule(expand_tasks(alpha, next(iter(theta.values())).shape[0], 1))


@dataclass(frozen=True)
class RuleTraining(CheckpointTraining):
    """The training of a learned rule and its initialisation, through the steps of fits."""

    paradigm: Meta

    @property
    @override
    def name(self) -> str:
        """The name of the rule."""
        return self.paradigm.learned_rule.name

    @property
    @override
    def general(self) -> CheckpointTraining:
        """The training of General with the network that this rule has."""
        return GeneralTraining(General.of(self.paradigm.app, self.paradigm.recipe))

    @property
    @override
    def begins_at_general(self) -> bool:
        return self.outer_loop.from_general

    @property
    @override
    def outer_loop(self) -> MetaTraining:
        return self.paradigm.recipe.training(self.name)

    @property
    @override
    def first_adam(self) -> Adam | None:
        """The Adam that the rule equals before training; None if the recipe does not search it."""
        return self.outer_loop.initial_adam if self.outer_loop.searches_adam else None

    @override
    def first_phi(self, general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """Return the first initialisation that the recipe asks for, and a rule that equals a plain Adam.

        The initialisation is an encoder, the mean of General's predictions, or a random theta_0. See
        :class:`metapp.learning.recipe.MetaTraining`.
        """
        app, kind, encoder, theta = self.paradigm.app, self.outer_loop.initialisation, {}, {}
        if kind == "untrained":
            encoder = app.init_encoder(rng)
        elif general and kind == "encoder":
            encoder = general.encoder
        elif general and kind == "mean":
            theta = {key: value.mean(0) for key, value in predict_parameters(app, general, tasks, rng).items()}
        random = {key: value[0] for key, value in app.init(rng, 1).items()}
        alpha = self._adam_alpha(random, self.outer_loop.initial_adam)
        phi = MetaParameters({} if encoder else theta or random, alpha, encoder)
        return self._set_alpha_from_statistics(phi, tasks, rng)

    @override
    def template(self, phi: MetaParameters) -> MetaParameters:
        """Return untrained hyperparameters, with an encoder if phi has one and a theta_0 otherwise."""
        alpha, rng = self._adam_alpha(self._draw_theta(), self.outer_loop.initial_adam), Generator().manual_seed(0)
        if phi.encoder:
            return MetaParameters({}, alpha, self.paradigm.app.init_encoder(rng))
        return MetaParameters(self._draw_theta(), alpha)

    @override
    def outer_loss(self, phi: MetaParameters) -> Loss:
        """Return the loss that is left after the steps of a fit (alg. 3)."""
        paradigm, app, outer_loop = self.paradigm, self.paradigm.app, self.outer_loop
        loss = after_learning(
            replace(paradigm.loss, smoothing=outer_loop.smoothing),
            paradigm.learned_rule.update_rule,
            steps=paradigm.steps,
            order=outer_loop.order,
            clip=outer_loop.clip,
            prediction=encoder_prediction(app) if phi.encoder else None,
            outer_loss=task_loss(app, paradigm.recipe.samples, outer=True),
            make_steps=fastest_steps(compiles=app.small_tensors),
        )
        return over_tasks(loss, count=outer_loop.tasks, augment=app.augment if outer_loop.augment else None)

    @override
    def with_adam(self, phi: MetaParameters, adam: Adam) -> MetaParameters:
        """Return phi with the rule that equals an Adam, except for hyperparameters that follow from statistics."""
        untrained, prefixes = self._adam_alpha(self._draw_theta(), adam), self.paradigm.learned_rule.statistics_prefixes
        kept = {name: value for name, value in phi.alpha.items() if name.startswith(prefixes)}
        return phi._replace(alpha={name: value.to(phi.alpha[name]) for name, value in (untrained | kept).items()})

    def _draw_theta(self) -> Params:
        """Draw parameters of one task, without a task axis, from a fixed seed."""
        return {key: value[0] for key, value in self.paradigm.app.init(Generator().manual_seed(0), 1).items()}

    def _adam_alpha(self, theta: Params, adam: Adam) -> Params:
        """Return the hyperparameters by which the rule equals an Adam, for parameters of one task."""
        paradigm = self.paradigm
        return paradigm.learned_rule.initial_alpha(paradigm.app, theta, paradigm.steps, adam)

    def _set_alpha_from_statistics(self, phi: MetaParameters, tasks: Tasks, rng: Generator) -> MetaParameters:
        """Set the hyperparameters that parts of the rule, if any, compute from gradients of training tasks.

        The gradients are recorded in fits by the rule with the given phi.
        """
        paradigm, learned_rule = self.paradigm, self.paradigm.learned_rule
        if not learned_rule.statistics_prefixes:
            return phi
        sums: Params = {}
        count = min(len(tasks), MAX_STATISTICS_TASKS)
        for numbers in torch.arange(count).split(PARALLEL_TASKS):
            selected_tasks = tasks.select([int(number) * len(tasks) // count for number in numbers])
            theta = paradigm.initialisation(phi, selected_tasks, rng)
            rule = paradigm.rule(phi, theta, paradigm.steps)

            def step_and_record(
                alpha: Params, theta: Params, grads: Params, state: Params, step: RuleStep = rule.step
            ) -> tuple[Params, Params]:
                for name, value in learned_rule.gradient_statistics(phi.alpha, grads).items():
                    sums[name] = sums.get(name, 0) + value
                return step(alpha, theta, grads, state)

            learn(
                theta, rule._replace(step=step_and_record), selected_tasks, paradigm.loss, steps=paradigm.steps, rng=rng
            )
        return phi._replace(alpha=learned_rule.from_statistics(phi.alpha, sums))
