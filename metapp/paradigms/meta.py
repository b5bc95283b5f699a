"""Meta: a start and a rule that were learned, together, to be good after a few steps."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import torch
from torch import Generator

from metapp.learning.adjoint import Loss, UpdateRule
from metapp.learning.draws import Rng
from metapp.learning.learn import MetaParameters, after_learning, learn, over_tasks, spread, task_loss, task_outer_loss
from metapp.learning.recipe import Adam, Guard, MetaTraining
from metapp.learning.rules import rule_of
from metapp.learning.task import Params, Tasks
from metapp.paradigms.general import start as general_start
from metapp.paradigms.outer_loop import can_compile, train
from metapp.paradigms.paradigm import AT_ONCE, Given, Job, Paradigm
from metapp.paradigms.resuming import Prepared, Reached
from metapp.paradigms.tuning import search


def preparation(
    job: Job, general: MetaParameters, rng: Generator, compiled: Callable[[], bool]
) -> tuple[MetaParameters, Loss]:
    """phi before meta-training and the loss that trains it (alg. 3).

    Args:
        job: names the rule.
        general: General's encoder, which the start goes on from; or a start theta without task axis; a random one is
            drawn where both are empty.
        rng: of the random start.
        compiled: whether to compile the inner step and its adjoint where they are not in C.
    """
    app, recipe, rule = job.app, job.recipe, rule_of(job.rule)
    training = recipe.training(job.rule)
    random = {key: value[0] for key, value in app.init(rng, 1).items()}
    theta = {} if general.encoder else general.theta or random
    steps = META.count(job)
    learned = after_learning(
        task_loss(app, recipe.batch),
        rule.rule,
        steps=steps,
        order=training.order,
        clip=training.clip,
        compiled=compiled,
        tasks_at_once=training.tasks_at_once,
        condition=app.condition if general.encoder else None,
        encode=app.encode if general.encoder else None,
        outer_loss=task_outer_loss(app, recipe.batch),
    )
    phi = MetaParameters(theta, rule.alpha(app, random, steps, training.first), general.encoder)
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
        theta = start(job, phi, part, rng)
        rule = META.rule(job, phi, theta, META.count(job))

        def recording(alpha: Params, theta: Params, grads: Params, state: Params, step: Any = rule.step) -> Any:
            for name, value in learned.gather(phi.alpha, grads).items():
                total[name] = total.get(name, 0) + value
            return step(alpha, theta, grads, state)

        loss = task_loss(job.app, job.recipe.batch)
        learn(theta, rule._replace(step=recording, packing=None), part, loss, steps=META.count(job), rng=rng)
    return phi._replace(alpha=learned.settle(phi.alpha, total))


def with_adam(job: Job, phi: MetaParameters, adam: Adam) -> MetaParameters:
    """phi with its rule's initial hyperparameters for this Adam, but for those that gradients settled."""
    theta = {key: value[0] for key, value in job.app.init(Generator().manual_seed(0), 1).items()}
    learned = rule_of(job.rule)
    fresh = learned.alpha(job.app, theta, META.count(job), adam)
    settled = {name: value for name, value in phi.alpha.items() if name.startswith(learned.settled)}
    return phi._replace(alpha={name: value.to(phi.alpha[name]) for name, value in (fresh | settled).items()})


GATHERED = 32  # tasks whose gradients are looked at


def start(job: Job, prepared: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
    """theta_0, the same for every task; or what an encoder that was trained through the steps says of each."""
    return general_start(job, prepared, tasks, rng) if prepared.encoder else spread(prepared.theta, len(tasks), 0)


def rule(job: Job, prepared: MetaParameters, theta: Params, steps: int) -> UpdateRule:
    """The learned rule, for so many steps."""
    learned = rule_of(job.rule)
    alpha = learned.for_steps(prepared.alpha, steps)
    return learned.rule(spread(alpha, next(iter(theta.values())).shape[0], 1))


def guard(job: Job) -> Guard:
    """Which fits by the job's rule are doubtful: as its training says for the recipe's number of steps.

    Of other rules, and after other steps, those that end above their initialisation; QuickFT's Adam is their fallback.
    """
    usual = META.count(job) == job.recipe.steps
    return (usual and job.recipe.training(job.rule).guard) or Guard(job.recipe.quickft)


def prepare(job: Job, given: Given) -> Prepared:
    """Learn the initialisation and the rule, after a search of the Adam that it begins as, if the recipe has one."""
    training = job.recipe.training(job.rule)
    general = _from_general(job, training, given)
    first, loss = preparation(job, general, given.rng, lambda: job.app.traits.compiles and can_compile())
    first = with_gradients(job, first, given.to_fit, given.rng)
    if training.tuned:
        found, given = _searched(job, training, first, given)
        if not training.steps:
            return found
        first = found.start
    return train(META, job, first, loss, training, given)


def _from_general(job: Job, training: MetaTraining, given: Given) -> MetaParameters:
    """What phi goes on from: an encoder, the mean of General's predictions, or nothing."""
    if training.initialisation == "untrained":
        return MetaParameters(encoder=job.app.init_encoder(given.rng))
    if given.encoder is None or not training.from_general:
        return MetaParameters()
    if training.initialisation == "encoder":
        return given.encoder
    predicted = general_start(job, given.encoder, given.to_fit, given.rng)
    return MetaParameters({key: value.mean(0) for key, value in predicted.items()})


def _searched(job: Job, training: MetaTraining, first: MetaParameters, given: Given) -> tuple[Prepared, Given]:
    """The best Adam to begin as, and what is given to the outer steps: they keep the search's errors, too."""
    reached = given.since

    def keep(now: Reached) -> None:
        nonlocal reached
        reached = now
        given.keep(now)

    start_of = functools.partial(with_adam, job, first)
    # where outer steps follow, their number says nothing about the search
    searched = given._replace(keep=keep, steps=None if training.steps else given.steps)
    found = search(META, job, training.first, start_of, searched)
    return found, given._replace(since=reached)


META = Paradigm(
    name="meta",
    needs=lambda job: (job.rule,),
    start=start,
    rule=rule,
    steps=lambda recipe: recipe.steps,
    prepare=prepare,
    guard=guard,
)
