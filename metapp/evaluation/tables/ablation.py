"""The paper's ablation: General's initialisation with Meta's rule, Meta's initialisation with Adam, both, neither.

Nothing is trained: initialisations and rules that are there are combined anew in the same fit, for all learned rules.
"""

from __future__ import annotations

from dataclasses import asdict, replace

from metapp.evaluation.cell import Cell
from metapp.evaluation.notes import paired_note, warned
from metapp.evaluation.rows import Row, Table, against, columns, paired_of, row_of, words
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables.results import COMPARED, result_row
from metapp.learning.draws import Rng
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Guard
from metapp.learning.task import Params, Tasks
from metapp.paradigms.meta import Meta
from metapp.paradigms.quickft import QuickFT
from metapp.runs.naming import caption_of
from metapp.runs.outputs.statistics import apart
from metapp.runs.run import Checkpoint
from metapp.storage.checkpoints import tensor_digest


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
        return Meta(self.app, self.recipe, self.rule_name).initialisation(phi, tasks, rng)


def learned(subject: Subject) -> list[str]:
    """The rows of the results by a learned rule, with the network that General predicts."""
    return [name for name, fit in subject.fits.items() if fit.paradigm.name == "meta" and fit.app == subject.app]


def combined(subject: Subject, name: str) -> list[tuple[str, str, Cell]]:
    """A learned rule's row with one of its halves replaced: (initialisation, rule, cell) of both.

    Args:
        subject: of which application.
        name: the row, "meta" or "meta:<rule>".

    Returns:
        None where a checkpoint is missing.
    """
    meta, general, quickft = (subject.fits[row] for row in (name, "general", "quickft"))
    if meta.checkpoint is None or general.checkpoint is None or quickft.checkpoint is None:
        return []
    rule, adam = meta.paradigm.rule_name, quickft.paradigm.adam(quickft.checkpoint.phi)
    if same_initialisation(subject, name):
        return [("general", rule, subject.cell(name)), (f"meta ({rule})", "adam", subject.cell("quickft"))]
    digest = "+".join(fit.checkpoint.digest for fit in (meta, general, quickft) if fit.checkpoint)
    combinations = (
        (
            RuleAlone,
            ("general", rule),
            MetaParameters(alpha=meta.checkpoint.phi.alpha, encoder=general.checkpoint.phi.encoder),
            None,
        ),
        (
            InitialisationAlone,
            (f"meta ({rule})", "adam"),
            meta.checkpoint.phi._replace(alpha=quickft.checkpoint.phi.alpha),
            adam and asdict(adam),
        ),
    )
    halves = []
    for kind, (initialisation, by), prepared, settings in combinations:
        paradigm = kind(meta.app, meta.recipe, rule, meta.paradigm.asked_steps)
        checkpoint = Checkpoint(prepared, "combined", digest)
        plan = replace(meta, paradigm=paradigm, checkpoint=checkpoint)
        cell = subject.fit_cell(f"ablation {initialisation} + {by}", plan, {"rule": rule, "adam": settings}, rule)
        halves.append((initialisation, by, cell))
    return halves


def same_initialisation(subject: Subject, name: str) -> bool:
    """True if a learned rule begins at General's own prediction."""
    meta, general = (subject.fits[row].checkpoint for row in (name, "general"))
    if meta is None or general is None or not meta.phi.encoder:
        return False
    return tensor_digest(meta.phi.encoder) == tensor_digest(general.phi.encoder)


def cells(subject: Subject) -> list[Cell]:
    """Meta's, QuickFT's and General's fits, and what is between them."""
    between = [cell for name in learned(subject) for _, _, cell in combined(subject, name)]
    return [*(subject.cell(name) for name in ("general", "quickft", *learned(subject))), *between]


def rows(subject: Subject) -> list[Row]:
    """Neither, one of the two, and both, for every learned rule that has a checkpoint."""
    all_rows = [result_row(subject, "quickft") | {"start": "general", "rule": "adam"}]
    for name in learned(subject):
        rule, steps = subject.fits[name].paradigm.rule_name, subject.fits[name].steps
        for start, by, cell in combined(subject, name):
            what = f"{start}+{by}"
            entries = {"start": start, "rule": by, "steps": steps, "paper_error": None}
            all_rows.append(row_of(subject, what, [cell], entries, against=against(subject, what, *COMPARED)))
        all_rows.append(result_row(subject, name) | {"start": f"meta ({rule})", "rule": rule})
    for row in all_rows:
        row["apart"] = apart(paired_of(row, "quickft"))
    return all_rows


def notes(subject: Subject, all_rows: list[Row]) -> list[str]:
    """Notes on rows that are the same by construction, and on adam."""
    lines = ["adam: QuickFT's, searched on validation tasks for General's initialisation", caption_of(subject.app)]
    lines += [
        f"{subject.fits[name].paradigm.rule_name} begins at General's own prediction: rows that differ in the "
        "initialisation alone are of the same fits"
        for name in learned(subject)
        if same_initialisation(subject, name)
    ]
    return [*lines, *warned(all_rows), *paired_note(all_rows)]


COLUMNS = columns(
    words("initialisation", "start"),
    *("rule", "error", "vs quickft", "interval", "steps", "seconds", "median", "worst"),
)
ABLATION = Table(
    "ablation",
    "mean error{factor} of initialisations and rules",
    COLUMNS,
    rows,
    notes,
    cells,
    heading="Ablation: initialisation and rule",
)
