"""The paper's ablation: General's initialisation with Meta's rule, Meta's initialisation with Adam, both, neither.

Nothing is trained: initialisations and rules that are there are combined anew in the same fit, for all learned rules.
"""

from __future__ import annotations

from dataclasses import asdict, replace

from metapp.evaluation.error_statistics import is_significant
from metapp.evaluation.rows import comparison_notes, make_row
from metapp.evaluation.subject import EvaluationRun
from metapp.evaluation.table import Column, Table, columns
from metapp.evaluation.tables.results import COMPARED_ROWS, result_rows
from metapp.learning.learn import MetaParameters
from metapp.learning.random_tensors import Rng
from metapp.learning.recipe import Guard
from metapp.learning.task import Params, Tasks
from metapp.paradigms.adam import QuickFT
from metapp.paradigms.meta import Meta
from metapp.runs.run import Checkpoint
from metapp.storage.checkpoint_files import tensor_digest
from metapp.storage.fit_folders import Record

ABLATION_COLUMNS = columns(
    Column("initialisation", "start"),
    *("rule", "error", "vs quickft", "interval", "steps", "seconds", "median", "worst"),
)


class RuleAlone(Meta):
    """Meta's rule from General's prediction."""

    name = "ablation-rule"

    @property
    def guard(self) -> Guard:
        """A fit is doubtful by its own initialisation alone."""
        return Guard(self.recipe.quickft)


class InitialisationAlone(QuickFT):
    """QuickFT's Adam from Meta's initialisation."""

    name = "ablation-start"

    def initialisation(self, phi: MetaParameters, tasks: Tasks, rng: Rng) -> Params:
        """Meta's initialisation."""
        return Meta.of(self.app, self.recipe).initialisation(phi, tasks, rng)


def ablation(subject: EvaluationRun) -> Table:
    """Neither, one of the two, and both, for every learned rule that has a checkpoint."""
    names = learned_rule_rows(subject)
    of_quickft, _, *both = result_rows(subject, ("quickft", "general", *names))
    rows = [of_quickft | {"start": "general", "rule": "adam"}]
    for name, row in zip(names, both, strict=True):
        for start, by, records in combine_halves(subject, name):
            entries = {"start": start, "rule": by, "steps": row["steps"]}
            rows.append(make_row(subject, f"{start}+{by}", records, entries, COMPARED_ROWS))
        rows.append(row | {"start": f"meta ({row['rule']})"})
    rows = [row | {"apart": is_significant(row["vs_quickft"])} for row in rows]
    notes = [
        "adam: QuickFT's, searched on validation tasks for General's initialisation",
        *(
            f"{subject.runs[name].options.rule} begins at General's own prediction: rows that differ in the "
            "initialisation alone are of the same fits"
            for name in names
            if has_general_initialisation(subject, name)
        ),
        *comparison_notes(rows),
    ]
    title = f"mean error{subject.app.error_measure.factor} of initialisations and rules"
    return Table(subject.title, title, ABLATION_COLUMNS, rows, notes, findings=(subject.presenter.caption(),))


def learned_rule_rows(subject: EvaluationRun) -> list[str]:
    """The rows of the results by a learned rule, with the network that General predicts."""
    return [name for name, run in subject.runs.items() if run.paradigm.has_learned_rule and run.app == subject.app]


def combine_halves(subject: EvaluationRun, name: str) -> list[tuple[str, str, list[Record]]]:
    """A learned rule's row with one of its halves replaced: (initialisation, rule, records) of both.

    Args:
        subject: of which application.
        name: the row, "meta" or "meta:<rule>".

    Returns:
        Nothing if a checkpoint is missing.
    """
    runs = [subject.runs[row] for row in (name, "general", "quickft")]
    found = [run.checkpoint for run in runs if run.checkpoint]
    if len(found) < len(runs):
        return []
    run, (meta, general, quickft) = runs[0], (checkpoint.phi for checkpoint in found)
    rule, adam = run.options.rule, runs[2].paradigm.adam(quickft)
    if has_general_initialisation(subject, name):
        return [("general", rule, subject.records(name)), (f"meta ({rule})", "adam", subject.records("quickft"))]

    def fitted(kind: type[RuleAlone | InitialisationAlone], start: str, by: str, phi: MetaParameters) -> list[Record]:
        paradigm = kind.of(run.app, run.recipe, rule, run.paradigm.steps)
        checkpoint = Checkpoint(phi, "combined", "+".join(one.digest for one in found))
        settings = {"rule": rule, "adam": asdict(adam) if adam and kind is InitialisationAlone else None}
        changed = replace(run, paradigm=paradigm, checkpoint=checkpoint)
        return subject.fitted(f"ablation {start} + {by}", changed, subject.tasks_of(name), settings)

    halves = (
        (RuleAlone, "general", rule, MetaParameters(alpha=meta.alpha, encoder=general.encoder)),
        (InitialisationAlone, f"meta ({rule})", "adam", meta._replace(alpha=quickft.alpha)),
    )
    return [(start, by, fitted(kind, start, by, phi)) for kind, start, by, phi in halves]


def has_general_initialisation(subject: EvaluationRun, name: str) -> bool:
    """True if a learned rule begins at General's own prediction."""
    meta, general = (subject.runs[row].checkpoint for row in (name, "general"))
    if meta is None or general is None or not meta.phi.encoder:
        return False
    return tensor_digest(meta.phi.encoder) == tensor_digest(general.phi.encoder)
