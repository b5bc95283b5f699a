"""The cost of paradigms: bytes of m exemplars, as m grows, and samples of a task that a fit sees."""

from __future__ import annotations

from torch import Generator

from metapp.evaluation.rows import make_row, paper_figures
from metapp.evaluation.subject import EvaluationRun
from metapp.evaluation.table import Column, Row, Table, bytes_column, columns
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params
from metapp.runs.run import Checkpoint

EXEMPLAR_COUNTS = (1, 10, 100, 1000)
STORAGE_COLUMNS = columns(
    "paradigm",
    *(bytes_column(f"m = {count}", f"bytes_{count}") for count in EXEMPLAR_COUNTS),
    Column("factor", "factor", ".4f"),
    Column("networks", "networks", ".2f"),
    Column("pays from", "pays_from", "d"),
)
SAMPLE_COLUMNS = columns(
    "paradigm",
    Column("seen", "seen", ",d"),
    Column("of", "all", ",d"),
    Column("saved", "saved", ".1%"),
    Column("paper saved", "paper_saved", ".1%"),
    Column("bytes seen", "seen_bytes", ",d"),
    Column("bytes of all", "all_bytes", ",d"),
    Column("steps", "steps", ",d"),
    Column("batch", "batch", ",d"),
)


def parameter_bytes(params: Params) -> int:
    """Return the bytes of parameters in memory."""
    return sum(value.numel() * value.element_size() for value in params.values())


def checkpoint_bytes(checkpoint: Checkpoint | None) -> int | None:
    """Bytes of a checkpoint, from which any fit is made; None if there is none."""
    return None if checkpoint is None else sum(parameter_bytes(part) for part in checkpoint.phi)


def storage(subject: EvaluationRun) -> Table:
    """The bytes that each paradigm must keep: networks of all exemplars, or a checkpoint that makes any of them."""
    network, figures = parameter_bytes(subject.app.init(Generator().manual_seed(0), 1)), paper_figures()["storage"]
    exemplars, rows = figures["exemplars"], []
    for name, run in subject.runs.items():
        once, apiece = (0, network) if run.paradigm.takes_long else (checkpoint_bytes(run.checkpoint), 0)
        entries = {"network_bytes": network, "once_bytes": once, "each_bytes": apiece}
        row = make_row(subject, name, [], entries)
        row["networks"] = None if once is None or apiece else once / network
        for count in dict.fromkeys((*EXEMPLAR_COUNTS, exemplars)):
            row[f"bytes_{count}"] = None if once is None else once + count * apiece
        total = row[f"bytes_{exemplars}"]
        row["factor"] = total / (exemplars * network) if total else None
        row["pays_from"] = -(-once // network) if once else None
        rows.append(row)
    notes = [
        f"one network: {network:,} bytes; factor: bytes for m = {exemplars} over m networks'; from m = 'pays from' on "
        "a checkpoint is smaller than m networks",
        "what is made again from a checkpoint needs the exemplar itself, too, when it is wanted",
        f"paper: {figures['meta_networks']} networks for any m, factor {figures['meta_networks']}/m = "
        f"{figures['factor']:g}",
    ]
    return Table(subject.title, "bytes for m exemplars", STORAGE_COLUMNS, rows, notes)


def samples(subject: EvaluationRun) -> Table:
    """The samples of a task that each paradigm's encoder and steps see, at most all there are."""
    figures = paper_figures()["samples"].get(subject.app.name)
    rows = [_sample_row(subject, name) for name in subject.runs]
    meta = next(row for row in rows if row["paradigm"] == "meta")
    meta["paper_saved"] = figures and figures["saved"]
    if meta["seen"] is None:
        notes = ["how much a fit may see of a task is not known, or there are no tasks yet"]
    else:
        notes = ["of what fits may see; samples that are drawn twice are sent once, so 'seen' is an upper bound"]
        notes += ["each step sees the whole task: nothing to save"] if meta["all"] == 1 else []
    if figures and meta["seen"] is not None:
        saved = f"{1 - min(meta['seen'], figures['all']) / figures['all']:.1%}"
        notes.append(f"paper: meta sees {figures['seen']:,} of {figures['all']:,}; ours, of so many: saved {saved}")
    title = "samples and bytes of a task that a fit sees"
    return Table(subject.title, title, SAMPLE_COLUMNS, rows, notes)


def _sample_row(subject: EvaluationRun, name: str) -> Row:
    run = subject.runs[name]
    batch, steps, tasks = run.recipe.batch, run.paradigm.steps, subject.tasks
    entries = dict.fromkeys(("seen", "all", "seen_bytes", "all_bytes", "saved", "paper_saved"))
    entries |= {"steps": steps, "batch": batch if steps else None}
    row = make_row(subject, name, [], entries)
    visible = subject.presenter.visible(tasks[0]) if tasks else None
    if visible is None:
        return row
    first, none = run.paradigm.preparations[:1], MetaParameters()
    phi = run.checkpoint.phi if run.checkpoint else first[0].template(none) if first else none
    count = min(steps * batch + (visible.encoder if phi.encoder else 0), visible.samples)
    return row | {
        "tasks": len(tasks),
        "seen": count,
        "all": visible.samples,
        "seen_bytes": count * visible.size,
        "all_bytes": visible.samples * visible.size,
        "saved": 1 - count / visible.samples,
    }
