"""The paper's ablation: General's initialisation with Meta's rule, Meta's initialisation with Adam, both, neither.

Nothing is trained: the initialisations and rules of existing checkpoints are combined anew, for each learned rule.
"""

from __future__ import annotations

from dataclasses import asdict, replace

from typing_extensions import override

from metapp.evaluation.error_statistics import is_significant
from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.rows import comparison_notes, make_row
from metapp.evaluation.table import Column, Table, columns
from metapp.evaluation.tables.results import COMPARED_ROWS, result_rows
from metapp.learning.learn import MetaParameters
from metapp.learning.random_tensors import Rng
from metapp.learning.recipe import Guard
from metapp.learning.task import Params, Tasks
from metapp.paradigms.adam import QuickFT
from metapp.paradigms.meta import Meta
from metapp.runs.checkpoint_selection import Checkpoint
from metapp.runs.fitter import Fitter
from metapp.storage.checkpoint_files import tensor_digest
from metapp.storage.fit_records import FitRecord

ABLATION_COLUMNS = columns(
    Column("initialisation", "start"),
    *("rule", "error", "vs quickft", "interval", "steps", "seconds", "median", "worst"),
)


class RuleAlone(Meta):
    """Meta's learned rule, from General's prediction instead of Meta's initialisation."""

    name = "ablation-rule"

    @property
    @override
    def guard(self) -> Guard:
        """The guard by QuickFT's Adam: a fit is doubtful by its own initialisation alone."""
        return Guard(self.recipe.quickft)


class InitialisationAlone(QuickFT):
    """QuickFT's Adam, from Meta's initialisation instead of General's prediction."""

    name = "ablation-start"

    @override
    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        return Meta.of(self.app, self.recipe).initialisation(phi, tasks, rng)


def ablation(evaluation: EvaluationRun) -> Table:
    """Make the table of learned initialisation and learned rule: neither, each alone, and both, for every rule."""
    names = learned_rule_rows(evaluation)
    quickft_row, _, *rule_rows = result_rows(evaluation, ("quickft", "general", *names))
    rows = [quickft_row | {"start": "general", "rule": "adam"}]
    for name, row in zip(names, rule_rows, strict=True):
        for initialisation, rule, records in combine_halves(evaluation, name):
            entries = {"start": initialisation, "rule": rule, "steps": row["steps"]}
            rows.append(make_row(evaluation, f"{initialisation}+{rule}", records, entries, COMPARED_ROWS))
        rows.append(row | {"start": f"meta ({row['rule']})"})
    rows = [row | {"apart": is_significant(row["vs_quickft"])} for row in rows]
    notes = [
        "adam: QuickFT's Adam, whose options were searched on validation tasks from General's initialisation",
        *(
            f"{evaluation.choices[name].options.rule} begins at General's own prediction, so rows that differ in the "
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
    return [
        name
        for name, choice in evaluation.choices.items()
        if choice.paradigm.has_learned_rule and choice.app == evaluation.app
    ]


def combine_halves(evaluation: EvaluationRun, name: str) -> list[tuple[str, str, list[FitRecord]]]:
    """Fit the tasks of a learned rule's row with its rule alone and with its initialisation alone.

    Args:
        evaluation: the application, with its tasks and records.
        name: the row, "meta" or "meta:<rule>".

    Returns:
        (initialisation, rule, records) of both combinations; [] if a checkpoint is missing.
    """
    rows = (name, "general", "quickft")
    if not all(row in evaluation.fitters for row in rows):
        return []
    fitters = [evaluation.fitters[row] for row in rows]
    choice, (meta, general, quickft) = fitters[0].choice, (fitter.checkpoint.phi for fitter in fitters)
    rule, adam = choice.options.rule, fitters[2].choice.paradigm.adam(quickft)
    if has_general_initialisation(evaluation, name):
        return [("general", rule, evaluation.records(name)), (f"meta ({rule})", "adam", evaluation.records("quickft"))]

    def fit_half(
        paradigm_class: type[RuleAlone | InitialisationAlone], initialisation: str, rule_name: str, phi: MetaParameters
    ) -> list[FitRecord]:
        paradigm = paradigm_class.of(choice.app, choice.recipe, rule, choice.paradigm.steps)
        checkpoint = Checkpoint(phi, "combined", "+".join(fitter.checkpoint.digest for fitter in fitters))
        settings = {"rule": rule, "adam": asdict(adam) if adam and paradigm_class is InitialisationAlone else None}
        combined = Fitter(replace(choice, paradigm=paradigm), checkpoint, evaluation.label)
        return evaluation.fit_records(
            f"ablation {initialisation} + {rule_name}", combined, evaluation.tasks_of(name), settings
        )

    halves = (
        (RuleAlone, "general", rule, MetaParameters(alpha=meta.alpha, encoder=general.encoder)),
        (InitialisationAlone, f"meta ({rule})", "adam", meta._replace(alpha=quickft.alpha)),
    )
    return [
        (initialisation, rule_name, fit_half(half, initialisation, rule_name, phi))
        for half, initialisation, rule_name, phi in halves
    ]


def has_general_initialisation(evaluation: EvaluationRun, name: str) -> bool:
    """Return whether a learned rule begins at General's own prediction."""
    meta, general = (evaluation.fitters.get(row) for row in (name, "general"))
    if meta is None or general is None or not meta.checkpoint.phi.encoder:
        return False
    return tensor_digest(meta.checkpoint.phi.encoder) == tensor_digest(general.checkpoint.phi.encoder)
