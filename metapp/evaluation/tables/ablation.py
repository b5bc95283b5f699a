"""The paper's ablation: General's start with Meta's learned rule, Meta's start with Adam, both, neither; and all rules.

Nothing is trained: what is there is combined anew, as (start, rule) of the same learn.
"""

from __future__ import annotations

from dataclasses import asdict

from metapp.evaluation.tables.comparison import paired_columns, paired_entries, paired_note, paired_of, warned
from metapp.evaluation.tables.results import COMPARED, result_row
from metapp.evaluation.tables.rows import LAST, Row, numbers, words
from metapp.evaluation.tables.subject import Cell, Fit, Subject
from metapp.evaluation.tables.table import Table
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Guard
from metapp.paradigms import Paradigm
from metapp.paradigms.meta import META
from metapp.paradigms.quickft import QUICKFT, adam_of
from metapp.runs.session import Checkpoint, caption_of
from metapp.runs.statistics import apart
from metapp.storage.records import tensor_digest

# what is doubtful of a rule's fits is known of its own start
RULE_ALONE = META._replace(name="ablation-rule", guard=lambda job: Guard(job.recipe.quickft))
START_ALONE = Paradigm("ablation-start", META.needs, META.initialisation, QUICKFT.rule, QUICKFT.steps)


def learned(subject: Subject) -> list[str]:
    """The rows of the results that a learned rule makes from the network that General predicts."""
    meta = {name: fit for name, fit in subject.fits.items() if fit.paradigm.name == "meta"}
    return [name for name, fit in meta.items() if fit.options.app is subject.app]


def combined(subject: Subject, name: str) -> list[tuple[str, str, Cell]]:
    """Half of a learned rule's row at a time: (start, rule, cell); none where a checkpoint is missing.

    Args:
        subject: of which application.
        name: the row, "meta" or "meta:<rule>".
    """
    meta, general, quickft = (subject.fits[each] for each in (name, "general", "quickft"))
    starts = (meta.checkpoint, general.checkpoint, quickft.checkpoint)
    if any(start is None for start in starts):
        return []
    rule = meta.options.rule
    if same_start(subject, name):
        return [("general", rule, subject.cell(name)), (f"meta ({rule})", "adam", subject.cell("quickft"))]
    learnt, encoder, tuned = (start.prepared for start in starts if start)
    digest = "+".join(start.digest for start in starts if start)
    options, found = meta.options, []
    for paradigm, words_of, prepared in (
        (RULE_ALONE, ("general", rule), MetaParameters(alpha=learnt.alpha, encoder=encoder.encoder)),
        (START_ALONE, (f"meta ({rule})", "adam"), learnt._replace(alpha=tuned.alpha)),
    ):
        adam = asdict(adam_of(options.job, tuned)) if paradigm is START_ALONE else None
        settings = {"rule": rule, "adam": adam}
        fit = Fit(f"ablation {' + '.join(words_of)}", options, paradigm, Checkpoint(prepared, "combined", digest))
        found.append((*words_of, subject.fit_cell(fit, settings, rule)))
    return found


def same_start(subject: Subject, name: str) -> bool:
    """Whether a learned rule starts at General's own prediction."""
    meta, general = (subject.fits[each].checkpoint for each in (name, "general"))
    if meta is None or general is None or not meta.prepared.encoder:
        return False
    return tensor_digest(meta.prepared.encoder) == tensor_digest(general.prepared.encoder)


def cells(subject: Subject) -> list[Cell]:
    """Meta's, QuickFT's and General's fits, and what is between them."""
    between = [cell for name in learned(subject) for _, _, cell in combined(subject, name)]
    return [*(subject.cell(name) for name in ("general", "quickft", *learned(subject))), *between]


def rows(subject: Subject) -> list[Row]:
    """Neither, one of the two, and both, for every learned rule that has a checkpoint."""
    found = [result_row(subject, "quickft") | {"start": "general", "rule": "adam"}]
    for name in learned(subject):
        rule = subject.fits[name].options.rule
        steps = META.count(subject.options.job)
        for start, by, cell in combined(subject, name):
            what = f"{start}+{by}"
            row = subject.row(what, cell, start=start, rule=by, steps=steps) | {"paper_error": None}
            for other in COMPARED:
                row |= paired_entries(other, subject.paired(cell, subject.cell(other)))
            found.append(row)
        found.append(result_row(subject, name) | {"start": f"meta ({rule})", "rule": rule})
    for row in found:
        row["apart"] = apart(paired_of(row, "quickft"))
    return found


def notes(subject: Subject, found: list[Row]) -> list[str]:
    """What is the same by construction, and what adam is."""
    said = ["adam: QuickFT's, searched on validation tasks for General's start", caption_of(subject.app)]
    for name in learned(subject):
        rule = subject.fits[name].options.rule
        own = f"{rule}'s start is General's own: rows that differ in it alone are of the same fits"
        said += [own] if same_start(subject, name) else []
    return [*said, *warned(found), *paired_note(found)]


TABLE = Table(
    "ablation",
    "mean error{factor} of starts and rules",
    (
        words("start", "start"),
        words("rule", "rule"),
        numbers("error", "error", ".3f"),
        *paired_columns("quickft"),
        *LAST,
    ),
    cells,
    rows,
    notes,
)
