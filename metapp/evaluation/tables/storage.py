"""The cost of paradigms: bytes of m exemplars, as m grows, and samples of a task that a fit sees."""

from __future__ import annotations

from torch import Generator

from metapp.evaluation.rows import Row, Table, blank, bytes_column, columns, numbers, paper
from metapp.evaluation.subject import Subject
from metapp.learning.task import Params
from metapp.runs.naming import observe_of
from metapp.runs.run import Checkpoint, Run

COUNTS = (1, 10, 100, 1000)


def size(params: Params) -> int:
    """Bytes."""
    return sum(value.numel() * value.element_size() for value in params.values())


def stored(checkpoint: Checkpoint | None) -> int | None:
    """Bytes of a checkpoint, from which any fit is made; None where there is none."""
    return None if checkpoint is None else sum(size(part) for part in checkpoint.phi)


def rows(subject: Subject) -> list[Row]:
    """The bytes that each paradigm must keep: networks of all exemplars, or a checkpoint that makes any of them."""
    network = size(subject.app.init(Generator().manual_seed(0), 1))
    exemplars = paper()["storage"]["exemplars"]
    all_rows = []
    for name, fit in subject.fits.items():
        # fits that take long are kept; those that take no time are made again from their checkpoint
        once, apiece = (0, network) if name in ("overfit", "finetune") else (stored(fit.checkpoint), 0)
        row = blank(subject.app.name, name, beside_paper=False, **observe_of(subject.app))
        row |= {"network_bytes": network, "once_bytes": once, "each_bytes": apiece}
        row["networks"] = None if once is None or apiece else once / network
        for count in dict.fromkeys((*COUNTS, exemplars)):
            row[f"bytes_{count}"] = None if once is None else once + count * apiece
        total = row[f"bytes_{exemplars}"]
        row["factor"] = total / (exemplars * network) if total else None
        row["pays_from"] = -(-once // network) if once else None
        all_rows.append(row)
    return all_rows


def notes(subject: Subject, all_rows: list[Row]) -> list[str]:
    """Notes on factors, on what else is kept, and on the paper's."""
    figures = paper()["storage"]
    count, networks = figures["exemplars"], figures["meta_networks"]
    first = f"one network: {all_rows[0]['network_bytes']:,} bytes; factor: bytes for m = {count} over m networks'"
    return [
        f"{first}; from m = 'pays from' on a checkpoint is smaller than m networks",
        "what is made again from a checkpoint needs the exemplar itself, too, when it is wanted",
        f"paper: {networks} networks for any m, factor {networks}/m = {figures['factor']:g}",
    ]


def sample_rows(subject: Subject) -> list[Row]:
    """For each paradigm, the samples that its encoder and its steps see, at most all there are."""
    all_rows = [_sample_row(subject, name, fit) for name, fit in subject.fits.items()]
    for row in all_rows:
        if row["paradigm"] == "meta":
            row["paper_saved"] = paper()["samples"].get(subject.app.name, {}).get("saved")
    return all_rows


def _sample_row(subject: Subject, name: str, fit: Run) -> Row:
    batch = fit.recipe.batch
    row = blank(subject.app.name, name, beside_paper=False, **observe_of(subject.app))
    row |= {"steps": fit.steps, "batch": batch if fit.steps else None}
    row |= dict.fromkeys(("seen", "all", "seen_bytes", "all_bytes", "saved", "paper_saved"))
    visible = subject.app.visible(subject.tasks[0]) if subject.tasks else None
    if visible is None:
        return row
    encodes = "general" in fit.paradigm.needs or bool(fit.checkpoint and fit.checkpoint.phi.encoder)
    count = min(fit.steps * batch + (visible.encoder if encodes else 0), visible.samples)
    return row | {
        "tasks": len(subject.tasks),
        "seen": count,
        "all": visible.samples,
        "seen_bytes": count * visible.size,
        "all_bytes": visible.samples * visible.size,
        "saved": 1 - count / visible.samples,
    }


def sample_notes(subject: Subject, all_rows: list[Row]) -> list[str]:
    """Notes on samples, here and in the paper."""
    if all(row["seen"] is None for row in all_rows):
        return ["how much a fit may see of a task is not known, or there are no tasks yet"]
    lines = ["of what fits may see; samples that are drawn twice are sent once, so 'seen' is an upper bound"]
    if all_rows[0]["all"] == 1:
        lines.append("each step sees the whole task: nothing to save")
    if figures := paper()["samples"].get(subject.app.name):
        meta = next(row["seen"] for row in all_rows if row["paradigm"] == "meta")
        saved = f"{1 - min(meta, figures['all']) / figures['all']:.1%}"
        lines.append(f"paper: meta sees {figures['seen']:,} of {figures['all']:,}; ours, of so many: saved {saved}")
    return lines


COLUMNS = columns(
    "paradigm",
    *(bytes_column(f"m = {count}", f"bytes_{count}") for count in COUNTS),
    numbers("factor", "factor", ".4f"),
    numbers("networks", "networks", ".2f"),
    numbers("pays from", "pays_from", "d"),
)
STORAGE = Table("storage", "bytes for m exemplars", COLUMNS, rows, notes, heading="Storage")
SAMPLE_COLUMNS = columns(
    "paradigm",
    numbers("seen", "seen", ",d"),
    numbers("of", "all", ",d"),
    numbers("saved", "saved", ".1%"),
    numbers("paper saved", "paper_saved", ".1%"),
    numbers("bytes seen", "seen_bytes", ",d"),
    numbers("bytes of all", "all_bytes", ",d"),
    numbers("steps", "steps", ",d"),
    numbers("batch", "batch", ",d"),
)
SAMPLES = Table(
    "samples",
    "samples and bytes of a task that a fit sees",
    SAMPLE_COLUMNS,
    sample_rows,
    sample_notes,
    heading="Samples seen",
)
