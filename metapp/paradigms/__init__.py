"""Five ways of training, each an initialisation and a rule: their table, by name; nothing large is imported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from metapp.names import did_you_mean
from metapp.registry import Entry

if TYPE_CHECKING:
    from metapp.paradigms.paradigm import Paradigm

__all__ = ["PARADIGMS", "ParadigmEntry", "paradigm_of"]


@dataclass(frozen=True, kw_only=True)
class ParadigmEntry(Entry["type[Paradigm]"]):
    """A subclass of `metapp.paradigms.paradigm.Paradigm`; `help` is its command's.

    Attributes:
        ignored_options: the names of options of fits that it has no use for; scripts give all paradigms the same options.
    """

    ignored_options: tuple[str, ...] = ()


# by name, in the order of the paper's tables
PARADIGMS = {
    "general": ParadigmEntry(
        reference="metapp.paradigms.adam:General",
        help="One forward pass of an encoder trained over all tasks.",
        ignored_options=("rule", "steps"),
    ),
    "overfit": ParadigmEntry(
        reference="metapp.paradigms.adam:Overfit",
        help="Train on each task alone, from a random initialisation.",
        ignored_options=("rule", "checkpoint", "train", "train_steps"),
    ),
    "finetune": ParadigmEntry(
        reference="metapp.paradigms.adam:Finetune",
        help="A tenth of Overfit's steps, from General's result.",
        ignored_options=("rule",),
    ),
    "quickft": ParadigmEntry(
        reference="metapp.paradigms.adam:QuickFT",
        help="As many Adam steps as Meta takes, from General's result.",
        ignored_options=("rule",),
    ),
    "meta": ParadigmEntry(
        reference="metapp.paradigms.meta:Meta",
        help="A few steps of a learned rule from a learned initialisation.",
    ),
}


def paradigm_of(name: str) -> type[Paradigm]:
    """Return the paradigm of a name.

    Raises:
        ValueError: there is none; lists those that there are.

    >>> paradigm_of("quickft").name
    'quickft'
    """
    if name not in PARADIGMS:
        hint = did_you_mean(name, PARADIGMS)
        raise ValueError(f"paradigm '{name}': expected one of {', '.join(PARADIGMS)}.{hint}")
    return PARADIGMS[name].load()
