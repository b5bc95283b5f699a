"""The paper's ablation: General's initialisation with Meta's rule, Meta's initialisation with Adam, both, neither.

Nothing is trained: the initialisations and rules of existing checkpoints are combined anew, for each learned rule.
"""

from __future__ import annotations

from dataclasses import replace

from metapp.evaluation.error_statistics import is_significant
from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.rows import comparison_notes, make_row
from metapp.evaluation.table import Column, Table, columns
from metapp.evaluation.tables.results import COMPARED_ROWS, result_rows
from metapp.learning.recipe import Guard
from metapp.paradigms.methods import Method
from metapp.runs.fit import Fit
from metapp.runs.fitting import Fitter
from metapp.runs.resolve import app_of
from metapp.storage.checkpoint_files import tensor_digest

ABLATION_COLUMNS = columns(
    Column("initialisation", "start"),
    *("rule", "error", "vs quickft", "interval", "steps", "seconds", "median", "worst"),
)


def ablation(evaluation: EvaluationRun) -> Table:
    """Make the table of learned initialisation and learned rule: neither, each alone, and both, for every rule."""
    names = learned_rule_rows(evaluation)
    quickft_row, _, *rule_rows = result_rows(evaluation, ("quickft", "general", *names))
    rows = [quickft_row | {"start": "general", "rule": "adam"}]
    for name, row in zip(names, rule_rows, strict=True):
        for initialisation, rule, fits in combine_halves(evaluation, name):
            entries = {"start": initialisation, "rule": rule, "steps": row["steps"]}
            rows.append(make_row(evaluation, f"{initialisation}+{rule}", fits, entries, COMPARED_ROWS))
        rows.append(row | {"start": f"meta ({row['rule']})"})
    rows = [row | {"apart": is_significant(row["vs_quickft"])} for row in rows]
    notes = [
        "adam: QuickFT's Adam, whose options were searched on validation tasks from General's initialisation",
        *(
            f"{evaluation.specs[name].rule} begins at General's own prediction, so rows that differ in the "
            "initialisation alone show the same fits"
            for name in names
            if has_general_initialisation(evaluation, name)
        ),
        *comparison_notes(rows),
    ]
    title = f"mean error{evaluation.app.error_measure.factor} of initialisations and rules"
    return Table(evaluation.title, title, ABLATION_COLUMNS, rows, notes, findings=(evaluation.presenter.caption(),))


def learned_rule_rows(evaluation: EvaluationRun) -> list[str]:
    """Return the rows of the results by a learned rule, for the network whose parameters General predicts."""
    return [name for name, spec in evaluation.specs.items() if spec.rule and app_of(spec) == evaluation.app]


def combine_halves(evaluation: EvaluationRun, name: str) -> list[tuple[str, str, list[Fit]]]:
    """Fit the tasks of a learned rule's row with its rule alone and with its initialisation alone.

    Args:
        evaluation: the application, with its tasks and fits.
        name: the row, "meta" or "meta:<rule>".

    Returns:
        (initialisation, rule, fits) of both combinations; [] if a checkpoint is missing.
    """
    rows = (name, "general", "quickft")
    if not all(row in evaluation.fitters for row in rows):
        return []
    meta, general, quickft = (evaluation.fitters[row] for row in rows)
    rule, digests = meta.spec.rule, [meta.spec.digest, general.spec.digest, quickft.spec.digest]
    if has_general_initialisation(evaluation, name):
        return [("general", rule, evaluation.fits(name)), (f"meta ({rule})", "adam", evaluation.fits("quickft"))]
    rule_alone, initialisation_alone = swap_initialisations(meta, quickft)
    halves = []
    for kind, initialisation, rule_name, method in (
        ("ablation-rule", "general", rule, rule_alone),
        ("ablation-start", f"meta ({rule})", "adam", initialisation_alone),
    ):
        conditions = meta.spec.conditions | {"ablation": kind, "checkpoints": digests}
        fitter = meta._replace(spec=replace(meta.spec, conditions=conditions), method=method)
        folder = evaluation.folder(kind, evaluation.given_row(name))
        title = f"ablation {initialisation} + {rule_name}"
        halves.append((initialisation, rule_name, evaluation.fits_by(title, folder, fitter, evaluation.tasks_of(name))))
    return halves


def swap_initialisations(meta: Fitter, quickft: Fitter) -> tuple[Method, Method]:
    """Return Meta's rule from General's prediction, and QuickFT's Adam from Meta's initialisation.

    Thresholds of Meta's guard hold for its own initialisation, so that a fit from General's prediction is doubtful only
    if it ends above the loss of that prediction.
    """
    rule_alone = meta.method._replace(start=quickft.method.start, guard=Guard(meta.recipe.quickft))
    return rule_alone, quickft.method._replace(start=meta.method.start)


def has_general_initialisation(evaluation: EvaluationRun, name: str) -> bool:
    """Return whether a learned rule begins at General's own prediction."""
    meta, general = (evaluation.fitters.get(row) for row in (name, "general"))
    if meta is None or general is None or not meta.phi.encoder:
        return False
    return tensor_digest(meta.phi.encoder) == tensor_digest(general.phi.encoder)
