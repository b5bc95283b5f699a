"""Five ways of training, each an initialisation and a rule."""

from __future__ import annotations

from metapp.paradigms.adam import Finetune, General, Overfit, QuickFT
from metapp.paradigms.meta import Meta
from metapp.paradigms.paradigm import Paradigm

__all__ = ["PARADIGMS", "Paradigm"]

# by name, in the order of the paper's tables
PARADIGMS: dict[str, type[Paradigm]] = {kind.name: kind for kind in (General, Overfit, Finetune, QuickFT, Meta)}
