"""Five ways of training, each an initialisation and a rule."""

from __future__ import annotations

from metapp.paradigms.finetune import FINETUNE
from metapp.paradigms.general import GENERAL
from metapp.paradigms.meta import META
from metapp.paradigms.overfit import OVERFIT
from metapp.paradigms.paradigm import Job, Paradigm
from metapp.paradigms.quickft import QUICKFT

__all__ = ["Job", "Paradigm", "paradigms"]


def paradigms() -> dict[str, Paradigm]:
    """Return all five by name, in the order of the paper's tables."""
    return {paradigm.name: paradigm for paradigm in (GENERAL, OVERFIT, FINETUNE, QUICKFT, META)}
