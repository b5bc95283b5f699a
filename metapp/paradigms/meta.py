"""Meta: an initialisation and a rule that were learned, together, to be good after a few steps."""

from __future__ import annotations

import functools
from collections.abc import Iterator

import torch
from torch import Generator

from metapp.learning.adjoint import Loss, RuleStep, UpdateRule
from metapp.learning.learn import MetaParameters, after_learning, learn, over_tasks, spread, task_outer_loss
from metapp.learning.progress import TrainState
from metapp.learning.recipe import Adam, Guard, MetaTraining
from metapp.learning.rules.rule import LearnedRule
from metapp.learning.task import Params, Rng, Tasks
from metapp.paradigms.general import encoding, predicted
from metapp.paradigms.outer_loop import train
from metapp.paradigms.paradigm import AT_ONCE, Paradigm, TrainingData, fastest
from metapp.paradigms.tuning import search
from metapp.rules import rule_of

GATHERED = 32  # tasks whose gradients settle parts of a rule


class Meta(Paradigm):
    """A few steps of a learned rule from a learned initialisation."""

    name = "meta"

    @property
    def learned(self) -> LearnedRule:
        """The learned rule before its hyperparameters are known."""
        return rule_of(self.rule_name)

    @property
    def needs(self) -> tuple[str, ...]:
        """The learned rule with its initialisation."""
        return (self.rule_name,)

    @property
    def recipe_steps(self) -> int:
        """n_l."""
        return self.recipe.steps

    @property
    def training(self) -> MetaTraining:
        """The rule's."""
        return self.recipe.training(self.rule_name)

    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """theta_0, the same for every task; or the prediction of an encoder that was trained through the steps."""
        start = predicted(self.app, phi, tasks, rng) if phi.encoder else spread(phi.theta, len(tasks), 0)
        return self.app.known(tasks) | start

    def rule(self, phi: MetaParameters, theta: Params, steps: int) -> UpdateRule:
        """The learned rule, for so many steps."""
        alpha = self.learned.for_steps(phi.alpha, steps)
        return self.learned.rule(spread(alpha, next(iter(theta.values())).shape[0], 1))

    @property
    def loss(self) -> Loss:
        """The loss that the steps of the learned rule descend."""
        return self.learned.loss(self.app, super().loss)

    @property
    def guard(self) -> Guard:
        """The doubtful fits: as the training says for the recipe's rule and number of steps.

        Of other rules, and after other steps, those that end above their initialisation; QuickFT's Adam is their
        fallback.
        """
        usual = self.steps == self.recipe.steps
        return (usual and self.training.guard) or Guard(self.recipe.quickft)

    def outer_problem(self, prepared: MetaParameters, rng: Generator) -> tuple[MetaParameters, Loss]:
        """phi before meta-training and the loss that trains it (alg. 3).

        Args:
            prepared: General's encoder, which predicts initialisations; or a first theta without task axis; a random
                one is drawn where both are empty.
            rng: of the random initialisation.
        """
        app, training, steps = self.app, self.training, self.steps
        random = {key: value[0] for key, value in app.init(rng, 1).items()}
        theta = {} if prepared.encoder else prepared.theta or random
        learned = after_learning(
            self.loss,
            self.learned.rule,
            steps=steps,
            order=training.order,
            clip=training.clip,
            encoding=encoding(app) if prepared.encoder else None,
            outer_loss=task_outer_loss(app, self.recipe.batch),
            steps_of=fastest(compiles=app.compiles),
        )
        phi = MetaParameters(theta, self.learned.alpha(app, random, steps, training.first), prepared.encoder)
        return phi, over_tasks(learned, count=training.tasks, augment=app.augment if training.augment else None)

    def prepare(self, data: TrainingData) -> Iterator[TrainState]:
        """Learn initialisation and rule, after a search of the Adam that the rule begins as, if the recipe has one."""
        training = self.training
        first, loss = self.outer_problem(self._first(data), data.rng)
        first = data.first if data.first.alpha else self._with_gradients(first, data.to_fit, data.rng)
        if training.tuned and not data.first.alpha:
            # where outer steps follow, their number says nothing about the search
            searched = data._replace(steps=None if training.steps else data.steps)
            tuned = yield from search(self, training.first, functools.partial(self._with_adam, first), searched)
            if not training.steps:
                return
            first, data = tuned.phi, data._replace(since=data.since if data.since.outer else tuned)
        yield from train(self, first, loss, training, data)

    def _first(self, data: TrainingData) -> MetaParameters:
        """The first phi: an encoder, the mean of General's predictions, or nothing."""
        training = self.training
        if data.first.alpha:
            return data.first
        if training.initialisation == "untrained":
            return MetaParameters(encoder=self.app.init_encoder(data.rng))
        if data.encoder is None or not training.from_general:
            return MetaParameters()
        if training.initialisation == "encoder":
            return data.encoder
        mean = {key: value.mean(0) for key, value in predicted(self.app, data.encoder, data.to_fit, data.rng).items()}
        return MetaParameters(mean)

    def _with_gradients(self, phi: MetaParameters, tasks: Tasks, rng: Generator) -> MetaParameters:
        """phi with what parts of its rule, if any, take from the gradients of fits of training tasks."""
        learned = self.learned
        if not learned.settled:
            return phi
        total: Params = {}
        count = min(len(tasks), GATHERED)
        for some in torch.arange(count).split(AT_ONCE):
            part = tasks.select([int(i) * len(tasks) // count for i in some])
            theta = self.initialisation(phi, part, rng)
            rule = self.rule(phi, theta, self.steps)

            def recording(
                alpha: Params, theta: Params, grads: Params, state: Params, step: RuleStep = rule.step
            ) -> tuple[Params, Params]:
                for name, value in learned.gather(phi.alpha, grads).items():
                    total[name] = total.get(name, 0) + value
                return step(alpha, theta, grads, state)

            learn(theta, rule._replace(step=recording), part, self.loss, steps=self.steps, rng=rng)
        return phi._replace(alpha=learned.settle(phi.alpha, total))

    def _with_adam(self, phi: MetaParameters, adam: Adam) -> MetaParameters:
        """phi with its rule's initial hyperparameters for this Adam, but for those that gradients settled."""
        theta = {key: value[0] for key, value in self.app.init(Generator().manual_seed(0), 1).items()}
        fresh = self.learned.alpha(self.app, theta, self.steps, adam)
        settled = {name: value for name, value in phi.alpha.items() if name.startswith(self.learned.settled)}
        return phi._replace(alpha={name: value.to(phi.alpha[name]) for name, value in (fresh | settled).items()})
