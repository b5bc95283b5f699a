"""The settings of a run for one application: optimisers, the training of checkpoints, and sizes.

Settings are plain frozen dataclasses: what differs between two runs is a field, and a record stores all fields.
Recipes themselves are beside their applications; this module only imports an application's type.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from metapp.learning.app import App


@dataclass(frozen=True)
class Adam:
    """The settings of a plain Adam descent.

    Attributes:
        rate: the first learning rate.
        beta1, beta2: the decay factors of the first and the second moment.
        eps: the number that is added to the root of the second moment.
        final_rate_share: the last rate as a share of the first, to which the rate falls by half a cosine.
    """

    rate: float
    beta1: float = 0.9
    beta2: float = 0.999
    eps: float = 1e-8
    final_rate_share: float = 1.0


# a coordinate search in lines: all changes of a line are tried around the best Adam of the lines before; a rate is a
# factor of the rate of that Adam, all other settings replace its own
AdamSearch = tuple[Sequence[Mapping[str, float]], ...]
ADAM_SEARCH: AdamSearch = (
    [{"rate": 2.0**power} for power in (-1, 1, -2, 2, -3, 3, -4, 4, -5, 5)],
    [
        {"beta1": beta1, "beta2": beta2}
        for beta1, beta2 in itertools.product((0.3, 0.5, 0.7, 0.8, 0.9), (0.8, 0.9, 0.97, 0.99, 0.999))
    ],
    [
        {"final_rate_share": share, "rate": factor}
        for share, factor in itertools.product((1.0, 0.3, 0.1, 0.0), (1.0, 1.3))
    ],
    [{"eps": eps, "rate": factor} for eps, factor in itertools.product((1e-8, 1e-6, 1e-4, 1e-3), (0.84, 1.0, 1.19))],
    [{"rate": 2 ** (eighth / 8)} for eighth in (-5, -3, -2, -1, 1, 2, 3, 5)],
)


@dataclass(frozen=True)
class Guard:
    """Which fits by a learned rule are doubtful, and the Adam that continues them; see :mod:`metapp.learning.guard`.

    Attributes:
        adam: the Adam that continues a doubtful fit for as many steps again, from its end or its initialisation.
        max_loss_share: a fit is doubtful if its plain loss ends above this share of the loss of its initialisation; at
            most 1, and 1 if losses may be negative.
        max_rise_factor: a fit is also doubtful if its loss, in the second half of its steps, exceeds this many times
            the lowest loss before it; infinite if losses of different steps cannot be compared (other samples, learned
            loss parameters).
    """

    adam: Adam
    max_loss_share: float = 1.0
    max_rise_factor: float = math.inf


@dataclass(frozen=True)
class OuterLoop:
    """The outer loop that trains a checkpoint on the training tasks.

    Attributes:
        steps: the number of outer steps.
        tasks: the number of tasks that an outer step sees.
        rates: learning rates of the outer Adam by the beginning of a parameter's name; "" is the rate of all others.
        warmup_steps: the number of outer steps of linear warm-up.
        final_rate_share: the last rate as a share of the first, reached by half a cosine.
        hold_share: the share of the outer steps before the rate begins to fall.
        weight_decay: the weight decay (L2) of the outer Adam.
        validate_every: the number of outer steps between two validations.
        augment: whether to train on augmented tasks.
        validation_variants: how many augmented variants of each validation task replace it, drawn once; 0 validates on
            the tasks themselves.
    """

    steps: int
    tasks: int
    rates: dict[str, float]
    warmup_steps: int = 0
    final_rate_share: float = 1.0
    hold_share: float = 0.0
    weight_decay: float = 0.0
    validate_every: int = 250
    augment: bool = True
    validation_variants: int = 0


Initialisation = Literal["random", "mean", "encoder", "untrained"]


@dataclass(frozen=True)
class MetaTraining(OuterLoop):
    """The training of an initialisation and a rule, by an outer loop through the steps of fits.

    Attributes:
        initial_adam: the Adam that a learned rule equals before training; SGD of its rate for meta-sgd.
        searches_adam: whether that Adam is searched on validation tasks before the outer steps, as QuickFT's is.
        order: the order of derivatives through the inner steps: 1 (FOMAML) or 2 (MAML).
        smoothing: the smoothing of absolute differences in second derivatives, see
            :class:`metapp.learning.adjoint.Loss`; 0 differentiates the loss as it is.
        clip: the norm to which each task's outer gradient is scaled down before the mean over tasks is taken.
        initialisation: where fits begin before training. "random" is a random theta_0, "mean" the mean of General's
            predictions as theta_0. "encoder" is General's encoder: each fit begins at its prediction, and outer steps,
            if any, train it through the inner ones. "untrained" is such an encoder with random parameters.
        app: the application with the network of this rule; None for the recipe's application.
        guard: which fits by the rule are doubtful, chosen on validation tasks; None for fits that end above the loss of
            their initialisation.
    """

    initial_adam: Adam = Adam(5e-3, beta2=0.99)
    searches_adam: bool = False
    order: int = 0
    smoothing: float = 0.0
    clip: float = float("inf")
    initialisation: Initialisation = "mean"
    app: App | None = None
    guard: Guard | None = None

    @property
    def from_general(self) -> bool:
        """Whether the first initialisation is taken from a trained General."""
        return self.initialisation in ("mean", "encoder")


@dataclass(frozen=True)
class Recipe:
    """All settings of runs of one application; a record stores the recipe that it used.

    Attributes:
        steps: the number of gradient steps of Meta and QuickFT, n_l in the paper.
        samples: the number of samples of each task that one gradient step sees.
        overfit_steps, overfit: the number of steps and the Adam of Overfit.
        finetune_steps, finetune: the number of steps and the Adam of Finetune.
        quickft: the Adam of QuickFT, tuned on validation tasks.
        general: the training of General's encoder.
        meta: the training of each rule's checkpoint, by the rule's name.
        rule: the rule that is best on validation tasks, which Meta uses unless --rule names another.
        app: the application, with the sizes of its network.
        search: which Adams a search on validation tasks tries, for QuickFT and for rules that are tuned.
    """

    steps: int
    samples: int
    overfit_steps: int
    overfit: Adam
    finetune_steps: int
    finetune: Adam
    quickft: Adam
    general: OuterLoop
    meta: dict[str, MetaTraining]
    rule: str
    app: App
    search: AdamSearch = ADAM_SEARCH

    def training(self, rule: str) -> MetaTraining:
        """Return the training of a rule: its network, its outer loop, and the guard of its fits.

        The guard holds for fits of the recipe's number of steps. A rule that the recipe does not list is trained like
        the recipe's default rule, with the network and the initialisation of that rule, but without its guard.
        """
        return self.meta[rule] if rule in self.meta else replace(self.meta[self.rule], guard=None)

    def app_with(self, rule: str = "") -> App:
        """Return the application with the network that a learned rule has; "" stands for no learned rule."""
        return (self.training(rule).app if rule else None) or self.app

    @property
    def observes(self) -> str:
        """What fits observe of a task, a value of --observe; "" if all fits of the application observe the same."""
        return self.app.observes


def paper_recipe(recipe: Recipe, app: App, **changes: Any) -> Recipe:
    """Return the recipe of Fischer & Ritschel 2022: first-order MAML with Meta-SGD from a random initialisation.

    Overfit takes 10,000 steps. Outer steps, rates and weight decay are taken from the authors' code (config/*.yaml of
    mfischer-ucl/metappearance). That code does not clip gradients; here a clip removes rare spikes.

    Args:
        recipe: the recipe that all other settings are taken from.
        app: the application with the paper's network.
        changes: fields of the training of Meta-SGD that differ, such as `order` or the number of `tasks`.
    """
    training = MetaTraining(
        steps=1_000_000,
        tasks=5,
        rates={"": 1e-4},
        initial_adam=Adam(1e-3),
        weight_decay=1e-6,
        order=1,
        clip=10.0,
        initialisation="random",
    )
    meta = {"meta-sgd": replace(training, **changes)}
    return replace(recipe, overfit_steps=10_000, finetune_steps=1_000, meta=meta, rule="meta-sgd", app=app)


def long_paper_recipe(published: Recipe, rate: float = 1e-3, **changes: Any) -> Recipe:
    """Return the paper's recipe with a higher outer rate, which falls to 0 in the last quarter of the outer steps.

    At the published constant rate, step sizes and initialisation still move after 10^6 outer steps.

    Args:
        published: the paper's recipe.
        rate: the higher outer rate.
        changes: further fields of the training of Meta-SGD that differ.
    """
    schedule: dict[str, Any] = {"rates": {"": rate}, "hold_share": 0.75, "final_rate_share": 0.0}
    training = replace(published.training("meta-sgd"), **(schedule | changes))
    return replace(published, meta={"meta-sgd": training})
