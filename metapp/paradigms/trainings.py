"""The trainings of checkpoints: of General's encoder, of QuickFT's Adam, and of a learned rule with its initialisation.

A training searches an Adam on validation tasks, takes outer steps on training tasks, or does both. Here is what it
begins at and which loss the outer steps descend; :mod:`training` runs it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Generator

from metapp.learned_rules import rule_of
from metapp.learning.adjoint import Loss, RuleStep
from metapp.learning.app import App
from metapp.learning.learn import (
    EncoderPrediction,
    MetaParameters,
    after_encoding,
    after_learning,
    learn,
    over_tasks,
    task_loss,
    with_coarsening,
)
from metapp.learning.recipe import Adam, AdamSearch, OuterLoop, Recipe
from metapp.learning.rules.rule import LearnedRule
from metapp.learning.task import Batch, Params, Tasks
from metapp.paradigms.methods import PARALLEL_TASKS, Method, fastest_steps, make_method, predict_parameters

NO_OUTER_LOOP = OuterLoop(steps=0, tasks=0, rates={})
MAX_STATISTICS_TASKS = 32  # training tasks whose gradients determine hyperparameters of a rule
# fields of `Adam` that QuickFT's checkpoints hold, each as a tensor of the field's name
QUICKFT_ADAM_SETTINGS = ("rate", "beta1", "beta2", "eps", "final_rate_share")


class Training(NamedTuple):
    """The training of a checkpoint: a search of an Adam on validation tasks, an outer loop on training tasks, or both.

    Attributes:
        name: the name of the checkpoint, from which its file is named.
        app: the application.
        method: a function from phi to the method of fits that validate the checkpoint.
        first_phi: a function (general, tasks, rng) -> phi before training; `general` is the phi of a trained General,
            None if there is none, and `tasks` are the training tasks.
        template: a function from phi to untrained parameters with the names and shapes that phi must have in this
            checkpoint.
        outer_loop: the settings of the outer loop, which has 0 steps if there is none.
        outer_loss: a function from phi to the loss of the outer loop, on flat trees with phi's names.
        first_adam: the Adam at which the search begins, before the outer loop; None for no search.
        search: the changes of that Adam that the search tries.
        with_adam: a function (phi, adam) -> phi whose fits begin with an Adam that the search tries.
        begins_at_general: whether the training begins at a trained General.
        takes_encoder_from_general: whether the checkpoint holds hyperparameters alone, and fits take the encoder from
            General's checkpoint.
        shared_by_observations: whether applications with equal networks, whose fits see other things, share the
            checkpoint.
    """

    name: str
    app: App
    method: Callable[[MetaParameters], Method]
    first_phi: Callable[[MetaParameters | None, Tasks, Generator], MetaParameters]
    template: Callable[[MetaParameters], MetaParameters]
    outer_loop: OuterLoop = NO_OUTER_LOOP
    outer_loss: Callable[[MetaParameters], Loss] | None = None
    first_adam: Adam | None = None
    search: AdamSearch = ()
    with_adam: Callable[[MetaParameters, Adam], MetaParameters] | None = None
    begins_at_general: bool = False
    takes_encoder_from_general: bool = False
    shared_by_observations: bool = False


def trainings_of(paradigm: str, app: App, recipe: Recipe, rule: str = "") -> tuple[Training, ...]:
    """Return the trainings of the checkpoints that fits read: of the initialisation, then of its tuning.

    Args:
        paradigm: the name of the paradigm.
        app: the application, with the network of the recipe or, for Meta, of the rule.
        recipe: the settings.
        rule: the name of Meta's learned rule; "" for the recipe's default rule.
    """
    match paradigm:
        case "overfit":
            return ()
        case "quickft":
            return general_training(app, recipe), adam_search(app, recipe)
        case "meta":
            return (rule_training(app, recipe, rule),)
    return (general_training(app, recipe),)  # of General, and of Finetune, which continues its predictions


def general_training(app: App, recipe: Recipe) -> Training:
    """Return the training of General's encoder, which depends on what fits see only by its input."""

    def outer_loss(phi: MetaParameters) -> Loss:
        """Return the outer loss of the encoder's predictions."""
        prediction = EncoderPrediction(app.encoder_input, app.encode)
        loss = after_encoding(task_loss(app, recipe.samples, outer=True), prediction)
        # tasks are coarsened before they are augmented, so that nothing is augmented in vain
        return with_coarsening(_mean_over_tasks(loss, app, recipe.general), app.coarsen)

    return Training(
        name="general",
        app=app,
        method=functools.partial(make_method, "general", app, recipe),
        first_phi=lambda general, tasks, rng: MetaParameters(encoder=app.init_encoder(rng)),
        template=lambda phi: MetaParameters(encoder=app.init_encoder(Generator().manual_seed(0))),
        outer_loop=recipe.general,
        outer_loss=outer_loss,
        shared_by_observations=True,
    )


def adam_search(app: App, recipe: Recipe) -> Training:
    """Return the search of QuickFT's Adam, for the encoder of a trained General.

    It begins at the recipe's Adam, which is searched because a win over a badly tuned baseline is no win.
    """

    def first_phi(general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        assert general is not None
        return general

    return Training(
        name="quickft",
        app=app,
        method=functools.partial(make_method, "quickft", app, recipe),
        first_phi=first_phi,
        template=lambda phi: _with_quickft_adam(MetaParameters(), recipe.quickft),
        first_adam=recipe.quickft,
        search=recipe.search,
        with_adam=_with_quickft_adam,
        begins_at_general=True,
        takes_encoder_from_general=True,
    )


def _with_quickft_adam(phi: MetaParameters, adam: Adam) -> MetaParameters:
    """Return the encoder of phi with an Adam's settings as alpha, scalars on the CPU."""
    return phi._replace(
        alpha={key: torch.tensor(getattr(adam, key), dtype=torch.float64) for key in QUICKFT_ADAM_SETTINGS}
    )


def rule_training(app: App, recipe: Recipe, rule: str = "") -> Training:
    """Return the training of a learned rule and its initialisation, through the recipe's number of steps.

    Args:
        app: the application, with the network of the rule.
        recipe: the settings.
        rule: the name of the rule; "" for the recipe's default rule.
    """
    learned_rule = rule_of(rule or recipe.rule)
    outer_loop = recipe.training(learned_rule.name)
    method = functools.partial(make_method, "meta", app, recipe, rule=learned_rule.name)

    def draw_theta(rng: Generator) -> Params:
        """Draw random parameters of one task, without a task axis."""
        return {key: value[0] for key, value in app.init(rng, 1).items()}

    def adam_alpha(theta: Params, adam: Adam) -> Params:
        """Return the hyperparameters by which the rule equals an Adam, for parameters of one task."""
        return learned_rule.initial_alpha(app, theta, recipe.steps, adam)

    def first_phi(general: MetaParameters | None, tasks: Tasks, rng: Generator) -> MetaParameters:
        """Return the first initialisation that the recipe asks for, and a rule that equals a plain Adam.

        The initialisation is an encoder, the mean of General's predictions, or a random theta_0. See
        :class:`metapp.learning.recipe.MetaTraining`.
        """
        encoder, theta = {}, {}
        if outer_loop.initialisation == "untrained":
            encoder = app.init_encoder(rng)
        elif general and outer_loop.initialisation == "encoder":
            encoder = general.encoder
        elif general and outer_loop.initialisation == "mean":
            theta = {key: value.mean(0) for key, value in predict_parameters(app, general, tasks, rng).items()}
        random = draw_theta(rng)
        alpha = adam_alpha(random, outer_loop.initial_adam)
        phi = MetaParameters({} if encoder else theta or random, alpha, encoder)
        return _set_alpha_from_statistics(phi, method(phi), learned_rule, tasks, rng)

    def template(phi: MetaParameters) -> MetaParameters:
        """Return untrained hyperparameters, with an encoder if phi has one and a theta_0 otherwise."""
        theta = draw_theta(Generator().manual_seed(0))
        alpha = adam_alpha(theta, outer_loop.initial_adam)
        if phi.encoder:
            return MetaParameters({}, alpha, app.init_encoder(Generator().manual_seed(0)))
        return MetaParameters(theta, alpha)

    def outer_loss(phi: MetaParameters) -> Loss:
        """Return the loss that is left after the steps of a fit (alg. 3)."""
        loss = after_learning(
            replace(method(phi).loss, smoothing=outer_loop.smoothing),
            learned_rule.update_rule,
            steps=recipe.steps,
            order=outer_loop.order,
            clip=outer_loop.clip,
            prediction=encoder_prediction(app) if phi.encoder else None,
            outer_loss=task_loss(app, recipe.samples, outer=True),
            make_steps=fastest_steps(compiles=app.small_tensors),
        )
        return _mean_over_tasks(loss, app, outer_loop)

    def with_adam(phi: MetaParameters, adam: Adam) -> MetaParameters:
        """Return phi with the rule that equals an Adam, except for hyperparameters that follow from statistics."""
        untrained = adam_alpha(draw_theta(Generator().manual_seed(0)), adam)
        kept = {name: value for name, value in phi.alpha.items() if name.startswith(learned_rule.statistics_prefixes)}
        return phi._replace(alpha={name: value.to(phi.alpha[name]) for name, value in (untrained | kept).items()})

    return Training(
        name=learned_rule.name,
        app=app,
        method=method,
        first_phi=first_phi,
        template=template,
        outer_loop=outer_loop,
        outer_loss=outer_loss,
        first_adam=outer_loop.initial_adam if outer_loop.searches_adam else None,
        search=recipe.search,
        with_adam=with_adam,
        begins_at_general=outer_loop.from_general,
    )


def _set_alpha_from_statistics(
    phi: MetaParameters, method: Method, learned_rule: LearnedRule, tasks: Tasks, rng: Generator
) -> MetaParameters:
    """Set the hyperparameters that parts of a rule, if any, compute from gradients of training tasks.

    Args:
        phi: the initialisation and the rule before training.
        method: the method of fits by phi, in which the gradients are recorded.
        learned_rule: the rule.
        tasks: the training tasks.
        rng: the source of all random numbers.
    """
    if not learned_rule.statistics_prefixes:
        return phi
    assert method.rule is not None
    sums: Params = {}
    count = min(len(tasks), MAX_STATISTICS_TASKS)
    for numbers in torch.arange(count).split(PARALLEL_TASKS):
        selected_tasks = tasks.select([int(number) * len(tasks) // count for number in numbers])
        theta = method.start(selected_tasks, rng)
        rule = method.rule(theta)

        def step_and_record(
            alpha: Params, theta: Params, grads: Params, state: Params, step: RuleStep = rule.step
        ) -> tuple[Params, Params]:
            for name, value in learned_rule.gradient_statistics(phi.alpha, grads).items():
                sums[name] = sums.get(name, 0) + value
            return step(alpha, theta, grads, state)

        learn(theta, rule._replace(step=step_and_record), selected_tasks, method.loss, steps=method.steps, rng=rng)
    return phi._replace(alpha=learned_rule.from_statistics(phi.alpha, sums))


def _mean_over_tasks(loss: Loss, app: App, outer_loop: OuterLoop) -> Loss:
    """Lift a loss on given tasks to the mean over as many random tasks as an outer step sees, augmented if asked."""
    return over_tasks(loss, count=outer_loop.tasks, augment=app.augment if outer_loop.augment else None)


def encoder_prediction(app: App) -> EncoderPrediction:
    """Return General's prediction as a differentiable function of the encoder.

    Parameters that the encoder does not predict are determined by tasks. See
    :meth:`metapp.learning.app.App.task_parameters`.
    """

    def encoder_input(tasks: Tasks, rng: Generator) -> tuple[Batch, Params]:
        return app.encoder_input(tasks, rng), app.task_parameters(tasks)

    def encode(encoder: Params, encoder_input: tuple[Batch, Params]) -> Params:
        return encoder_input[1] | app.encode(encoder, encoder_input[0])

    return EncoderPrediction(encoder_input, encode)
