"""The method of fits of each paradigm: an initialisation, an update rule, a number of steps and a loss.

A method is a value. Methods of different paradigms can therefore be combined, by the initialisation of one and the
rule of another, and :func:`descend_tasks` fits tasks by any of them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import NamedTuple

from metapp.learned_rules import rule_of
from metapp.learning.adjoint import Loss, StepMaker, UpdateRule, torch_steps
from metapp.learning.app import App
from metapp.learning.guard import descend_with_guard
from metapp.learning.learn import (
    DescentState,
    MetaParameters,
    check_finite_losses,
    descend,
    expand_tasks,
    final_item,
    task_loss,
)
from metapp.learning.random_tensors import Rng, draw_per_task
from metapp.learning.recipe import Adam, Guard, Recipe
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Params, Tasks
from metapp.paradigms import paradigm_of
from metapp.registry import registry

PARALLEL_TASKS = 8  # tasks that are fitted at once in loops over a data set, which bounds the memory


class Method(NamedTuple):
    """A method by which tasks of one application are fitted.

    Attributes:
        start: a function (tasks, rng) -> the initialisations of tasks, [T, ...].
        rule: a function from the initialisations to the update rule; None for a method without steps.
        steps: the number of gradient steps.
        loss: the loss that the steps descend.
        guard: which fits by a learned rule are doubtful, and the Adam that continues these; None for no guard.
        adam: the settings of the rule if it is a plain Adam, which records of fits state; else None.
    """

    start: Callable[[Tasks, Rng], Params]
    rule: Callable[[Params], UpdateRule] | None
    steps: int
    loss: Loss
    guard: Guard | None = None
    adam: Adam | None = None


# The five paradigms. All take the arguments of `make_method`, so that one call makes any of them


def general(app: App, recipe: Recipe, phi: MetaParameters, rule: str, steps: int) -> Method:
    """Return the prediction of an encoder, without steps."""
    return Method(functools.partial(predict_parameters, app, phi), None, 0, task_loss(app, recipe.samples))


def overfit(app: App, recipe: Recipe, phi: MetaParameters, rule: str, steps: int) -> Method:
    """Return an Adam from random parameters, until it has converged."""
    return _descend_by_adam(recipe.overfit, functools.partial(_draw_parameters, app), app, recipe, steps)


def finetune(app: App, recipe: Recipe, phi: MetaParameters, rule: str, steps: int) -> Method:
    """Return an Adam from General's prediction, for about a tenth of Overfit's steps."""
    return _descend_by_adam(recipe.finetune, functools.partial(_predict_initialisations, app, phi), app, recipe, steps)


def quickft(app: App, recipe: Recipe, phi: MetaParameters, rule: str, steps: int) -> Method:
    """Return an Adam from General's prediction, for as many steps as Meta takes.

    It is the Adam that a search found on validation tasks, which phi holds as alpha; without alpha the recipe's.
    """
    adam = Adam(**{key: float(value) for key, value in phi.alpha.items()}) if phi.alpha else recipe.quickft
    return _descend_by_adam(adam, functools.partial(_predict_initialisations, app, phi), app, recipe, steps)


def meta(app: App, recipe: Recipe, phi: MetaParameters, rule: str, steps: int) -> Method:
    """Return a few steps of a learned rule from a learned initialisation.

    The initialisation is theta_0, which all tasks share, or the prediction of an encoder that was trained through the
    steps. Parameters that phi does not have are determined by tasks.

    The guard is the one that the rule's training in the recipe states, for fits of the recipe's number of steps. For
    other rules and after other steps, fits are doubtful that end above the loss of their initialisation, and QuickFT's
    Adam continues them.
    """
    learned_rule = rule_of(rule)

    def expand_theta(tasks: Tasks, rng: Rng) -> Params:
        return app.task_parameters(tasks) | expand_tasks(phi.theta, len(tasks), 0)

    def update_rule(theta: Params) -> UpdateRule:
        alpha = learned_rule.for_steps(phi.alpha, steps)
        return learned_rule.update_rule(expand_tasks(alpha, next(iter(theta.values())).shape[0], 1))

    trained_guard = recipe.training(rule).guard if steps == recipe.steps else None
    return Method(
        functools.partial(_predict_initialisations, app, phi) if phi.encoder else expand_theta,
        update_rule,
        steps,
        learned_rule.loss(app, task_loss(app, recipe.samples)),
        trained_guard or Guard(recipe.quickft),
    )


def make_method(
    paradigm: str, app: App, recipe: Recipe, phi: MetaParameters, *, rule: str = "", steps: int | None = None
) -> Method:
    """Make the method of a paradigm for an application.

    Args:
        paradigm: the name of the paradigm.
        app: the application, with the network of the recipe or, for Meta, of the rule.
        recipe: the settings.
        phi: the parameters of the checkpoint.
        rule: the name of Meta's learned rule; "" for the recipe's default rule.
        steps: the number of gradient steps; None for the recipe's number.

    Raises:
        ValueError: there is no such paradigm or rule.
    """
    make = paradigm_of(paradigm).make.load()
    method: Method = make(app, recipe, phi, rule or recipe.rule, number_of_steps(paradigm, recipe, steps))
    return method


def number_of_steps(paradigm: str, recipe: Recipe, steps: int | None = None) -> int:
    """Return the number of gradient steps of a paradigm: `steps` or else the recipe's, and 0 for General."""
    field = paradigm_of(paradigm).steps_field
    recipe_steps: int = getattr(recipe, field) if field else 0
    return recipe_steps if steps is None or recipe_steps == 0 else steps


def _descend_by_adam(adam: Adam, start: Callable[[Tasks, Rng], Params], app: App, recipe: Recipe, steps: int) -> Method:
    """Return the method of a plain Adam from given initialisations."""
    return Method(start, lambda theta: fixed_adam(adam, theta, steps), steps, task_loss(app, recipe.samples), adam=adam)


# Initialisations of tasks, [T, ...]


def _draw_parameters(app: App, tasks: Tasks, rng: Rng) -> Params:
    """Draw random parameters; parameters that tasks determine replace random ones."""
    drawn = draw_per_task(lambda tasks, rng: app.init(rng, len(tasks)), tasks, rng)
    return drawn | app.task_parameters(tasks)


def predict_parameters(app: App, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
    """Predict parameters of tasks by the encoder of phi, encode(I): detached tensors [T, ...]."""
    theta = app.encode(phi.encoder, draw_per_task(app.encoder_input, tasks, rng))
    return {key: value.detach() for key, value in theta.items()}


def _predict_initialisations(app: App, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
    """Predict parameters of tasks; parameters that the encoder of phi does not predict are determined by tasks."""
    return app.task_parameters(tasks) | predict_parameters(app, phi, tasks, rng)


# Fits by any method


def fit_tasks(method: Method, tasks: Tasks, rng: Rng) -> Params:
    """Fit tasks, one or many at once, and return the parameters of the network of each task, [T, ...].

    See :func:`descend_tasks` for the arguments and errors.

    >>> import torch
    >>> from metapp.learning.adjoint import DrawnBatch
    >>> from metapp.learning.rules import sgd
    >>> loss = Loss(lambda data, rng, done: DrawnBatch((), {}), lambda theta, batch, _: theta["x"].square())
    >>> rule = sgd({"rate": torch.tensor([0.25])})
    >>> method = Method(lambda tasks, rng: {"x": torch.ones(1)}, lambda theta: rule, 2, loss)
    >>> fit_tasks(method, Tasks(("gold",), {}, torch.arange(1)), torch.Generator())
    {'x': tensor([0.2500])}
    """
    return final_item(descend_tasks(method, tasks, rng)).theta


def descend_tasks(method: Method, tasks: Tasks, rng: Rng) -> Iterator[DescentState]:
    """Fit tasks, one or many at once: descend from the initialisations by the rule, one step at a time.

    Args:
        method: the method; without its guard a learned rule is left to itself: `method._replace(guard=None)`.
        tasks: the tasks.
        rng: the source of all random numbers, one for all tasks or one for each. With one for each, a task is fitted
            as if it were alone.

    Yields:
        The state before the first step, and after each step; the guard of a learned rule adds one more with its
        results.

    Raises:
        FloatingPointError: a loss is not finite; the message names the tasks and the step.
    """
    theta, steps, loss = method.start(tasks, rng), method.steps, method.loss
    if method.rule is None or steps == 0:
        yield DescentState(0, theta, {})
        return
    rule, make_steps = method.rule(theta), fastest_steps()
    if method.guard:
        yield from descend_with_guard(
            theta, rule, tasks, loss, rng=rng, guard=method.guard, steps=steps, make_steps=make_steps
        )
    else:
        yield from check_finite_losses(descend(theta, rule, tasks, loss, steps=steps, rng=rng, make_steps=make_steps))


def fastest_steps(*, compiles: bool = False) -> StepMaker:
    """Return the function that makes steps: an extension's if one is installed, else torch's.

    Args:
        compiles: whether the steps are so many that compiling them pays.
    """
    entry = registry().hooks.get("steps")
    return functools.partial(entry.load(), compiles=compiles) if entry else torch_steps
