"""The five paradigms, each an initialisation, a rule and a number of steps: their table, by name.

In order of reading: :mod:`methods` makes a method of fits of each paradigm, and fits tasks by any method.
:mod:`trainings` says how the checkpoints of the paradigms are trained, and :mod:`training` trains them. :mod:`ranks`
shares that work between processes. This table is read before torch is loaded, and imports nothing large. Paradigms
never name an application.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from metapp.entries import Lazy, did_you_mean

__all__ = ["PARADIGMS", "Paradigm", "paradigm_of"]


@dataclass(frozen=True, kw_only=True)
class Paradigm:
    """A paradigm, by which tasks of any application are fitted.

    Attributes:
        help: the help of the command of the paradigm.
        ignored_options: names of options of fits that the paradigm has no use for. The command line accepts them all
            the same, so that scripts give all paradigms equal options.
        steps_field: the field of a recipe that holds the number of gradient steps; "" if the paradigm takes none.
        has_learned_rule: whether the rule is a learned one, which --rule names.
        takes_long: whether fits take so many steps that their results are stored to be read again; quick fits are
            repeated from a checkpoint instead.
        make: the function of :mod:`metapp.paradigms.methods` that makes the method of fits.
    """

    help: str
    ignored_options: tuple[str, ...] = ()
    steps_field: str = ""
    has_learned_rule: bool = False
    takes_long: bool = False
    make: Lazy[Callable[..., Any]]


# paradigms by name, in the order of the paper's tables
PARADIGMS = {
    "general": Paradigm(
        help="Predict fits by an encoder, in one forward pass.",
        ignored_options=("rule", "steps"),
        make=Lazy("metapp.paradigms.methods:general"),
    ),
    "overfit": Paradigm(
        help="Fit by many steps of Adam, from random parameters.",
        ignored_options=("rule", "checkpoint", "train", "train_steps"),
        steps_field="overfit_steps",
        takes_long=True,
        make=Lazy("metapp.paradigms.methods:overfit"),
    ),
    "finetune": Paradigm(
        help="Fit by a tenth of Overfit's steps, from General's prediction.",
        ignored_options=("rule",),
        steps_field="finetune_steps",
        takes_long=True,
        make=Lazy("metapp.paradigms.methods:finetune"),
    ),
    "quickft": Paradigm(
        help="Fit by as many steps as Meta takes, of a searched Adam, from General's prediction.",
        ignored_options=("rule",),
        steps_field="steps",
        make=Lazy("metapp.paradigms.methods:quickft"),
    ),
    "meta": Paradigm(
        help="Fit by a few steps of a learned update rule, from a learned initialisation.",
        steps_field="steps",  # n_l in the paper
        has_learned_rule=True,
        make=Lazy("metapp.paradigms.methods:meta"),
    ),
}


def paradigm_of(name: str) -> Paradigm:
    """Return the paradigm of a name.

    Raises:
        ValueError: there is no such paradigm; the message lists all names.

    >>> paradigm_of("quickft").steps_field
    'steps'
    """
    if name not in PARADIGMS:
        hint = did_you_mean(name, PARADIGMS)
        raise ValueError(f"paradigm '{name}': expected one of {', '.join(PARADIGMS)}.{hint}")
    return PARADIGMS[name]
