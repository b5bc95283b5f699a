"""Meta: an initialisation and a rule that were learned, together, to be good after a few steps."""

from __future__ import annotations

import functools
from collections.abc import Iterator

import torch
from torch import Generator

from metapp.learning.adjoint import Loss, RuleStep, UpdateRule, fastest
from metapp.learning.learn import (
    MetaParameters,
    after_learning,
    learn,
    over_tasks,
    spread,
    task_outer_loss,
)
from metapp.learning.progress import Progress
from metapp.learning.recipe import Adam, Guard, MetaTraining
from metapp.learning.rules import rule_of
from metapp.learning.task import Params, Rng, Tasks
from metapp.paradigms import general
from metapp.paradigms.outer_loop import train
from metapp.paradigms.paradigm import AT_ONCE, Job, Paradigm, TrainingData, plain_loss
from metapp.paradigms.tuning import search

GATHERED = 32  # tasks whose gradients settle parts of a rule


def outer_problem(job: Job, prepared: MetaParameters, rng: Generator) -> tuple[MetaParameters, Loss]:
    """phi before meta-training and the loss that trains it (alg. 3).

    Args:
        job: names the rule.
        prepared: General's encoder, which predicts initialisations; or a first theta without task axis; a random one is
            drawn where both are empty.
        rng: of the random initialisation.
    """
    app, recipe, rule = job.app, job.recipe, rule_of(job.rule)
    training = recipe.training(job.rule)
    random = {key: value[0] for key, value in app.init(rng, 1).items()}
    theta = {} if prepared.encoder else prepared.theta or random
    steps = META.count(job)
    learned = after_learning(
        META.loss(job),
        rule.rule,
        steps=steps,
        order=training.order,
        clip=training.clip,
        encoding=general.encoding(app) if prepared.encoder else None,
        outer_loss=task_outer_loss(app, recipe.batch),
        engine=fastest(compiles=app.compiles),
    )
    phi = MetaParameters(theta, rule.alpha(app, random, steps, training.first), prepared.encoder)
    return phi, over_tasks(learned, count=training.tasks, augment=app.augment if training.augment else None)


def with_gradients(job: Job, phi: MetaParameters, tasks: Tasks, rng: Generator) -> MetaParameters:
    """phi with what parts of its rule, if any, take from the gradients of fits of training tasks."""
    learned = rule_of(job.rule)
    if not learned.settled:
        return phi
    total: Params = {}
    count = min(len(tasks), GATHERED)
    for some in torch.arange(count).split(AT_ONCE):
        part = tasks.select([int(i) * len(tasks) // count for i in some])
        theta = initialisation(job, phi, part, rng)
        rule = META.rule(job, phi, theta, META.count(job))

        def recording(
            alpha: Params, theta: Params, grads: Params, state: Params, step: RuleStep = rule.step
        ) -> tuple[Params, Params]:
            for name, value in learned.gather(phi.alpha, grads).items():
                total[name] = total.get(name, 0) + value
            return step(alpha, theta, grads, state)

        learn(theta, rule._replace(step=recording), part, META.loss(job), steps=META.count(job), rng=rng)
    return phi._replace(alpha=learned.settle(phi.alpha, total))


def with_adam(job: Job, phi: MetaParameters, adam: Adam) -> MetaParameters:
    """phi with its rule's initial hyperparameters for this Adam, but for those that gradients settled."""
    theta = {key: value[0] for key, value in job.app.init(Generator().manual_seed(0), 1).items()}
    learned = rule_of(job.rule)
    fresh = learned.alpha(job.app, theta, META.count(job), adam)
    settled = {name: value for name, value in phi.alpha.items() if name.startswith(learned.settled)}
    return phi._replace(alpha={name: value.to(phi.alpha[name]) for name, value in (fresh | settled).items()})


def initialisation(job: Job, prepared: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
    """theta_0, the same for every task; or what an encoder that was trained through the steps says of each."""
    if prepared.encoder:
        return general.beginning(job, prepared, tasks, rng)
    return job.app.known(tasks) | spread(prepared.theta, len(tasks), 0)


def rule(job: Job, prepared: MetaParameters, theta: Params, steps: int) -> UpdateRule:
    """The learned rule, for so many steps."""
    learned = rule_of(job.rule)
    alpha = learned.for_steps(prepared.alpha, steps)
    return learned.rule(spread(alpha, next(iter(theta.values())).shape[0], 1))


def loss(job: Job) -> Loss:
    """The loss that the steps of the learned rule descend."""
    return rule_of(job.rule).loss(job.app, plain_loss(job))


def guard(job: Job) -> Guard:
    """Which fits by the job's rule are doubtful: as its training says for the recipe's number of steps.

    Of other rules, and after other steps, those that end above their initialisation; QuickFT's Adam is their fallback.
    """
    usual = META.count(job) == job.recipe.steps
    return (usual and job.recipe.training(job.rule).guard) or Guard(job.recipe.quickft)


def prepare(job: Job, data: TrainingData) -> Iterator[Progress]:
    """Learn the initialisation and the rule, after a search of the Adam that it begins as, if the recipe has one."""
    training = job.recipe.training(job.rule)
    first, loss = outer_problem(job, _first(job, training, data), data.rng)
    first = data.first if data.first.alpha else with_gradients(job, first, data.to_fit, data.rng)
    if training.tuned and not data.first.alpha:
        # where outer steps follow, their number says nothing about the search
        searched = data._replace(steps=None if training.steps else data.steps)
        tuned = yield from search(META, job, training.first, functools.partial(with_adam, job, first), searched)
        if not training.steps:
            return
        assert tuned.best is not None
        first, data = tuned.best.phi, data._replace(since=data.since if data.since.outer else tuned)
    yield from train(META, job, first, loss, training, data)


def _first(job: Job, training: MetaTraining, data: TrainingData) -> MetaParameters:
    """The first phi: an encoder, the mean of General's predictions, or nothing."""
    if data.first.alpha:
        return data.first
    if training.initialisation == "untrained":
        return MetaParameters(encoder=job.app.init_encoder(data.rng))
    if data.encoder is None or not training.from_general:
        return MetaParameters()
    if training.initialisation == "encoder":
        return data.encoder
    predicted = general.initialisation(job, data.encoder, data.to_fit, data.rng)
    return MetaParameters({key: value.mean(0) for key, value in predicted.items()})


META = Paradigm(
    name="meta",
    needs=lambda job: (job.rule,),
    initialisation=initialisation,
    rule=rule,
    steps=lambda recipe: recipe.steps,
    prepare=prepare,
    guard=guard,
    loss=loss,
)
