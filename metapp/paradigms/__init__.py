"""The five paradigms, each an initialisation, a rule and a number of steps: their table, by name.

In order of reading: :mod:`paradigm` has the contracts of a paradigm and of the training of its checkpoints. :mod:`adam`
has General, Overfit, Finetune and QuickFT, :mod:`meta` has Meta. :mod:`training` trains checkpoints, :mod:`ranks`
shares that work between processes. This table is read before torch is loaded, and imports nothing large. Paradigms
never name an application.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from metapp.entries import Lazy, did_you_mean

if TYPE_CHECKING:
    from metapp.paradigms.paradigm import Paradigm

__all__ = ["PARADIGMS", "ParadigmEntry", "paradigm_of"]


@dataclass(frozen=True, kw_only=True)
class ParadigmEntry(Lazy["type[Paradigm]"]):
    """The entry of a paradigm, a subclass of `metapp.paradigms.paradigm.Paradigm`.

    Attributes:
        help: the help of the command of the paradigm.
        ignored_options: names of options of fits that the paradigm has no use for. The command line accepts them all
            the same, so that scripts give all paradigms equal options.
    """

    help: str
    ignored_options: tuple[str, ...] = ()


# paradigms by name, in the order of the paper's tables
PARADIGMS = {
    "general": ParadigmEntry(
        reference="metapp.paradigms.adam:General",
        help="Predict fits by an encoder, in one forward pass.",
        ignored_options=("rule", "steps"),
    ),
    "overfit": ParadigmEntry(
        reference="metapp.paradigms.adam:Overfit",
        help="Fit by many steps of Adam, from random parameters.",
        ignored_options=("rule", "checkpoint", "train", "train_steps"),
    ),
    "finetune": ParadigmEntry(
        reference="metapp.paradigms.adam:Finetune",
        help="Fit by a tenth of Overfit's steps, from General's prediction.",
        ignored_options=("rule",),
    ),
    "quickft": ParadigmEntry(
        reference="metapp.paradigms.adam:QuickFT",
        help="Fit by as many steps as Meta takes, of a searched Adam, from General's prediction.",
        ignored_options=("rule",),
    ),
    "meta": ParadigmEntry(
        reference="metapp.paradigms.meta:Meta",
        help="Fit by a few steps of a learned update rule, from a learned initialisation.",
    ),
}


def paradigm_of(name: str) -> type[Paradigm]:
    """Return the paradigm of a name.

    Raises:
        ValueError: there is no such paradigm; the message lists all names.

    >>> paradigm_of("quickft").name
    'quickft'
    """
    if name not in PARADIGMS:
        hint = did_you_mean(name, PARADIGMS)
        raise ValueError(f"paradigm '{name}': expected one of {', '.join(PARADIGMS)}.{hint}")
    return PARADIGMS[name].load()
