"""Validation: which training tasks validate, and the error of fits of them."""

from __future__ import annotations

import torch
from torch import Generator

from metapp.learning.learn import MetaParameters
from metapp.learning.task import Tasks
from metapp.paradigms.paradigm import AT_ONCE, Paradigm


def split_validation(tasks: Tasks) -> tuple[Tasks, Tasks]:
    """(to train on, to validate on): of the groups, sorted by name, every eighth from the fourth on validates.

    Sorting spreads the validation tasks over the families that names begin with.

    Raises:
        ValueError: fewer than 4 groups.
    """
    groups = [(tasks.groups or tasks.names)[row] for row in tasks.rows.tolist()]
    if len(set(groups)) < 4:
        raise ValueError(
            f"training set: {len(tasks)} tasks that show {len(set(groups))} things, expected at least 4 (some are kept "
            "for validation)."
        )
    validating = set(sorted(set(groups))[3::8])
    rows = range(len(tasks))
    return (
        tasks.select([row for row in rows if groups[row] not in validating]),
        tasks.select([row for row in rows if groups[row] in validating]),
    )


def validation_error(paradigm: Paradigm, prepared: MetaParameters, tasks: Tasks) -> float:
    """Mean error of fits of all tasks with fixed seeds, as the table prints it; infinite where a fit diverges.

    Kinds of tasks count alike. Learned rules fit without their guard: the best rule is kept, not the best fallback.
    """
    paradigm, app = paradigm.unguarded(), paradigm.app
    total, weights, seeds = 0.0, tasks.weights(), 1 if app.deterministic else 2
    for seed in range(seeds):
        rng = Generator(tasks.rows.device).manual_seed(seed)
        for some in torch.arange(len(tasks)).split(AT_ONCE):
            part = tasks.select(some)
            try:
                theta = paradigm.fit(prepared, part, rng)
            except FloatingPointError:
                return float("inf")
            total += float((weights[some] * app.errors(theta, part)["error"]).sum())
    return app.scale * total / (seeds * float(weights.sum()))
