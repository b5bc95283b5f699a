"""The settings of a run, for one application: the optimisers, how checkpoints are trained, sizes."""

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
    """Settings of a plain Adam descent: the rate decays from `rate` by a half cosine to `rate * final`."""

    rate: float
    beta1: float = 0.9
    beta2: float = 0.999
    eps: float = 1e-8
    final: float = 1.0


# a coordinate search: lines of changes, one line after the other around the best so far; a rate is a factor of its rate
AdamSearch = tuple[Sequence[Mapping[str, float]], ...]
ADAM_SEARCH: AdamSearch = (
    [{"rate": 2.0**i} for i in (-1, 1, -2, 2, -3, 3, -4, 4, -5, 5)],
    [
        {"beta1": beta1, "beta2": beta2}
        for beta1, beta2 in itertools.product((0.3, 0.5, 0.7, 0.8, 0.9), (0.8, 0.9, 0.97, 0.99, 0.999))
    ],
    [{"final": final, "rate": factor} for final, factor in itertools.product((1.0, 0.3, 0.1, 0.0), (1.0, 1.3))],
    [{"eps": eps, "rate": factor} for eps, factor in itertools.product((1e-8, 1e-6, 1e-4, 1e-3), (0.84, 1.0, 1.19))],
    [{"rate": 2 ** (i / 8)} for i in (-5, -3, -2, -1, 1, 2, 3, 5)],
)


@dataclass(frozen=True)
class Guard:
    """Which fits by a learned rule are doubtful, and the Adam used as fallback (`metapp.learning.guard`).

    Attributes:
        adam: the fallback, which continues a doubtful fit for as many steps again, from its end or its initialisation.
        fall: a fit is doubtful whose visible loss ends above this share of its initialisation's; 1 or less, and 1 if
            losses may be negative.
        rise: a fit is also doubtful whose loss, in the second half of its steps, exceeds this many times its minimum so
            far; infinite if losses of different steps are not comparable (other samples, learned loss parameters).
    """

    adam: Adam
    fall: float = 1.0
    rise: float = math.inf


@dataclass(frozen=True)
class OuterLoop:
    """The outer loop that trains a checkpoint on the training tasks.

    Attributes:
        steps: outer steps.
        tasks: tasks per outer step.
        rates: outer Adam's rate by the first part of a parameter's name ("" is the rate of all others).
        warmup: outer steps of linear warm-up.
        final: the rate's last value over its first, reached by a half cosine.
        hold: share of the steps before this decay begins.
        decay: weight decay (L2) of the outer Adam.
        validate_every: outer steps between two validations.
        augment: train on augmented tasks.
        validation_variants: augmented variants of each validation task that validate in its place, drawn once; 0: the
            validation tasks themselves.
    """

    steps: int
    tasks: int
    rates: dict[str, float]
    warmup: int = 0
    final: float = 1.0
    hold: float = 0.0
    decay: float = 0.0
    validate_every: int = 250
    augment: bool = True
    validation_variants: int = 0


Initialisation = Literal["random", "mean", "encoder", "untrained"]


@dataclass(frozen=True)
class MetaTraining(OuterLoop):
    """The same through the steps of fits: how an initialisation and a rule are learned.

    Attributes:
        first: the Adam that a learned rule is before training; SGD of this rate for meta-sgd.
        tuned: search that Adam on validation tasks, as QuickFT's, before the outer steps, if any.
        order: derivative carried through the inner steps: 1 (FOMAML) or 2 (MAML).
        clip: each task's outer gradient is scaled down to this norm before the mean is taken.
        initialisation: the first one: "random"; "mean" of General's predictions; "encoder", General's own, which
            begins each task at its prediction and which outer steps, if any, train through the inner ones; "untrained",
            the same for an encoder that nothing has trained before.
        app: the application with this rule's own network; None for the recipe's.
        guard: which fits by the rule are doubtful, as validation tasks show; None: those that end above their
            initialisation.
    """

    first: Adam = Adam(5e-3, beta2=0.99)
    tuned: bool = False
    order: int = 0
    clip: float = float("inf")
    initialisation: Initialisation = "mean"
    app: App | None = None
    guard: Guard | None = None

    @property
    def from_general(self) -> bool:
        """True if the first initialisation comes from a prepared General."""
        return self.initialisation in ("mean", "encoder")


@dataclass(frozen=True)
class Recipe:
    """Everything a run may vary, for one application; a record stores the one it used.

    Attributes:
        steps: n_l, Meta's and QuickFT's number of gradient steps.
        batch: samples b that one gradient step sees.
        overfit_steps, overfit: Overfit's number of steps and its Adam.
        finetune_steps, finetune: the same for Finetune.
        quickft: QuickFT's Adam, tuned on validation tasks.
        general: how General's encoder is trained.
        meta: how each rule's checkpoint is trained, by the rule's name.
        rule: the rule that is best on validation tasks: Meta's default.
        app: the application, with the sizes of its network.
        search: what a search of an Adam on validation tasks tries, for QuickFT and for rules that are tuned.
    """

    steps: int
    batch: int
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
        """The training of a rule, its network, and the guard of its fits after the recipe's number of steps.

        A rule that the recipe does not have is trained as its default rule, with that one's network and initialisation,
        and has no guard of its own.
        """
        return self.meta[rule] if rule in self.meta else replace(self.meta[self.rule], guard=None)


def paper_recipe(recipe: Recipe, app: App, **changes: Any) -> Recipe:
    """The recipe of Fischer & Ritschel 2022: MAML with Meta-SGD from a random initialisation, Overfit for 10,000 steps.

    Outer steps, rates and weight decay are those of the authors' code (config/*.yaml of mfischer-ucl/metappearance),
    which has no clip: here it takes rare spikes of the gradient.

    Args:
        recipe: all else.
        app: with the paper's network.
        changes: fields of the training if it is not of first order with a meta-batch of 5.
    """
    training = MetaTraining(
        steps=1_000_000,
        tasks=5,
        rates={"": 1e-4},
        first=Adam(1e-3),
        decay=1e-6,
        order=1,
        clip=10.0,
        initialisation="random",
    )
    meta = {"meta-sgd": replace(training, **changes)}
    return replace(recipe, overfit_steps=10_000, finetune_steps=1_000, meta=meta, rule="meta-sgd", app=app)


def long_paper_recipe(published: Recipe, rate: float = 1e-3) -> Recipe:
    """The recipe of the paper at a higher outer rate, which decays to 0 in the last quarter of the outer steps.

    At the published constant rate, step sizes and initialisation still move after 10^6 outer steps.
    """
    training = published.training("meta-sgd")
    return replace(published, meta={"meta-sgd": replace(training, rates={"": rate}, hold=0.75, final=0.0)})
