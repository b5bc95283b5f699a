"""Meta: an initialisation and a rule that were learned, together, to be good after a few steps."""

from __future__ import annotations

import torch
from torch import Generator

from metapp.learning.adjoint import Loss, RuleStep, UpdateRule
from metapp.learning.draws import Rng
from metapp.learning.learn import MetaParameters, after_learning, expand_tasks, learn, over_tasks, task_loss
from metapp.learning.recipe import Adam, Guard, MetaTraining
from metapp.learning.rules.rule import LearnedRule
from metapp.learning.task import Params, Tasks
from metapp.paradigms.adam import encoding, predict
from metapp.paradigms.paradigm import PARALLEL_TASKS, Paradigm, fastest
from metapp.rules import rule_of

GATHERED = 32  # tasks whose gradients settle parts of a rule


class Meta(Paradigm):
    """A few steps of a learned rule from a learned initialisation."""

    name = "meta"

    @property
    def learned_rule(self) -> LearnedRule:
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
        start = predict(self.app, phi, tasks, rng) if phi.encoder else expand_tasks(phi.theta, len(tasks), 0)
        return self.app.known(tasks) | start

    def rule(self, phi: MetaParameters, theta: Params, steps: int) -> UpdateRule:
        """The learned rule, for so many steps."""
        alpha = self.learned_rule.for_steps(phi.alpha, steps)
        return self.learned_rule.rule(expand_tasks(alpha, next(iter(theta.values())).shape[0], 1))

    @property
    def loss(self) -> Loss:
        """The loss that the steps of the learned rule descend."""
        return self.learned_rule.loss(self.app, super().loss)

    @property
    def guard(self) -> Guard:
        """The doubtful fits: as the training says for the recipe's rule and number of steps.

        Of other rules, and after other steps, those that end above their initialisation; QuickFT's Adam is their
        fallback.
        """
        usual = self.steps == self.recipe.steps
        return (usual and self.training.guard) or Guard(self.recipe.quickft)

    @property
    def searched_from(self) -> Adam | None:
        """The Adam that the rule is at first, if the recipe searches it."""
        return self.training.first if self.training.tuned else None

    def first_phi(self, general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """An encoder, the mean of General's predictions or a random theta_0; and the rule as a plain Adam."""
        app, kind, encoder, theta = self.app, self.training.initialisation, {}, {}
        if kind == "untrained":
            encoder = app.init_encoder(rng)
        elif general and kind == "encoder":
            encoder = general.encoder
        elif general and kind == "mean":
            theta = {key: value.mean(0) for key, value in predict(app, general, tasks, rng).items()}
        random = {key: value[0] for key, value in app.init(rng, 1).items()}
        alpha = self.learned_rule.alpha(app, random, self.steps, self.training.first)
        phi = MetaParameters({} if encoder else theta or random, alpha, encoder)
        return self._with_gradients(phi, tasks, rng)

    def outer_loss(self, phi: MetaParameters) -> Loss:
        """The loss that is left after the steps of a fit (alg. 3)."""
        app, training = self.app, self.training
        lifted = after_learning(
            self.loss,
            self.learned_rule.rule,
            steps=self.steps,
            order=training.order,
            clip=training.clip,
            encoding=encoding(app) if phi.encoder else None,
            outer_loss=task_loss(app, self.recipe.batch, outer=True),
            steps_of=fastest(compiles=app.compiles),
        )
        return over_tasks(lifted, count=training.tasks, augment=app.augment if training.augment else None)

    def with_adam(self, phi: MetaParameters, adam: Adam) -> MetaParameters:
        """phi whose rule is this Adam at first, but for hyperparameters that gradients settled."""
        theta = {key: value[0] for key, value in self.app.init(Generator().manual_seed(0), 1).items()}
        fresh = self.learned_rule.alpha(self.app, theta, self.steps, adam)
        settled = {name: value for name, value in phi.alpha.items() if name.startswith(self.learned_rule.settled)}
        return phi._replace(alpha={name: value.to(phi.alpha[name]) for name, value in (fresh | settled).items()})

    def _with_gradients(self, phi: MetaParameters, tasks: Tasks, rng: Generator) -> MetaParameters:
        """phi with the values that parts of its rule, if any, take from the gradients of fits of training tasks."""
        learned_rule = self.learned_rule
        if not learned_rule.settled:
            return phi
        total: Params = {}
        count = min(len(tasks), GATHERED)
        for some in torch.arange(count).split(PARALLEL_TASKS):
            part = tasks.select([int(i) * len(tasks) // count for i in some])
            theta = self.initialisation(phi, part, rng)
            rule = self.rule(phi, theta, self.steps)

            def recording(
                alpha: Params, theta: Params, grads: Params, state: Params, step: RuleStep = rule.step
            ) -> tuple[Params, Params]:
                for name, value in learned_rule.gather(phi.alpha, grads).items():
                    total[name] = total.get(name, 0) + value
                return step(alpha, theta, grads, state)

            learn(theta, rule._replace(step=recording), part, self.loss, steps=self.steps, rng=rng)
        return phi._replace(alpha=learned_rule.settle(phi.alpha, total))
