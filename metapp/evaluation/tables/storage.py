"""The cost of paradigms: bytes stored for m exemplars, as m grows, and samples of a task that a fit sees.

Both are counted from recipes, parameters and checkpoints; nothing is fitted for them.
"""

from __future__ import annotations

from torch import Generator

from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.rows import make_row, paper_figure, paper_figures
from metapp.evaluation.table import Column, Row, Table, bytes_column, columns
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params
from metapp.paradigms import PARADIGMS
from metapp.paradigms.trainings import trainings_of
from metapp.runs.fitting import Fitter
from metapp.runs.resolve import app_of, recipe_of

EXEMPLAR_COUNTS = (1, 10, 100, 1000)  # exemplars, m in the paper, that the columns of bytes are for
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
    Column("paper saved", "paper_saved", ".1%", is_optional=True),
    Column("bytes seen", "seen_bytes", ",d"),
    Column("bytes of all", "all_bytes", ",d"),
    Column("steps", "steps", ",d"),
    Column("batch", "batch", ",d"),
)


def parameter_bytes(params: Params) -> int:
    """Return the bytes that parameters take in memory."""
    return sum(value.numel() * value.element_size() for value in params.values())


def checkpoint_bytes(fitter: Fitter | None) -> int | None:
    """Return the bytes of the checkpoint of a fitter, from which any fit is made; None without a fitter."""
    return None if fitter is None else sum(parameter_bytes(part) for part in fitter.phi)


def storage(evaluation: EvaluationRun) -> Table:
    """Make the table of bytes that each paradigm keeps: networks of all exemplars, or one checkpoint for all."""
    network_bytes, figures = (
        parameter_bytes(evaluation.app.init(Generator().manual_seed(0), 1)),
        paper_figures()["storage"],
    )
    exemplars, rows = figures["exemplars"], []
    for name, spec in evaluation.specs.items():
        takes_long = PARADIGMS[spec.paradigm].takes_long
        shared_bytes, exemplar_bytes = (
            (0, network_bytes) if takes_long else (checkpoint_bytes(evaluation.fitters.get(name)), 0)
        )
        entries = {"network_bytes": network_bytes, "once_bytes": shared_bytes, "each_bytes": exemplar_bytes}
        row = make_row(evaluation, name, [], entries)
        row["networks"] = None if shared_bytes is None or exemplar_bytes else shared_bytes / network_bytes
        for count in dict.fromkeys((*EXEMPLAR_COUNTS, exemplars)):
            row[f"bytes_{count}"] = None if shared_bytes is None else shared_bytes + count * exemplar_bytes
        total = row[f"bytes_{exemplars}"]
        row["factor"] = total / (exemplars * network_bytes) if total else None
        row["pays_from"] = -(-shared_bytes // network_bytes) if shared_bytes else None
        rows.append(row)
    notes = [
        f"one network: {network_bytes:,} bytes; factor: bytes for m = {exemplars} over the bytes of m networks; pays "
        "from: the m from which on a checkpoint is smaller than m networks",
        "a checkpoint makes a network anew only from the exemplar itself, whose bytes are not counted",
    ]
    if (networks := paper_figure(evaluation, "storage", "meta_networks")) is not None:
        notes.append(f"paper: {networks} networks for any m, factor {networks}/m = {figures['factor']:g}")
    return Table(evaluation.title, "bytes for m exemplars", STORAGE_COLUMNS, rows, notes)


def samples(evaluation: EvaluationRun) -> Table:
    """Make the table of samples of a task that each paradigm's encoder and steps see, at most all there are."""
    figures = paper_figure(evaluation, "samples", evaluation.app.name)
    rows = [_make_sample_row(evaluation, name) for name in evaluation.specs]
    meta_row = next(row for row in rows if row["paradigm"] == "meta")
    meta_row["paper_saved"] = figures and figures["saved"]
    if meta_row["seen"] is None:
        notes = ["it is not known how many samples of a task a fit may see, or there are no tasks yet"]
    else:
        notes = [
            "of: the samples that fits may see; seen: an upper bound, since a sample that is drawn twice counts twice"
        ]
        notes += ["each step sees the whole task, so no samples are saved"] if meta_row["all"] == 1 else []
    if figures and meta_row["seen"] is not None:
        saved = f"{1 - min(meta_row['seen'], figures['all']) / figures['all']:.1%}"
        notes.append(
            f"paper: meta sees {figures['seen']:,} of {figures['all']:,}; if it saw as many as here: {saved} saved"
        )
    title = "samples and bytes of a task that a fit sees"
    return Table(evaluation.title, title, SAMPLE_COLUMNS, rows, notes)


def _make_sample_row(evaluation: EvaluationRun, name: str) -> Row:
    """Make the row of one paradigm: samples and bytes that it sees of a task."""
    spec, fitter, tasks = evaluation.specs[name], evaluation.fitters.get(name), evaluation.tasks
    recipe, steps = recipe_of(spec), evaluation.steps(name)
    samples = recipe.samples
    entries = dict.fromkeys(("seen", "all", "seen_bytes", "all_bytes", "saved", "paper_saved"))
    entries |= {"steps": steps, "batch": samples if steps else None}
    row = make_row(evaluation, name, [], entries)
    visible = evaluation.app.sight.describe_visible(tasks[0]) if tasks else None
    if visible is None:
        return row
    trainings, empty_phi = trainings_of(spec.paradigm, app_of(spec), recipe, spec.rule)[:1], MetaParameters()
    phi = fitter.phi if fitter else trainings[0].template(empty_phi) if trainings else empty_phi
    count = min(steps * samples + (visible.encoder_samples if phi.encoder else 0), visible.sample_count)
    return row | {
        "tasks": len(tasks),
        "seen": count,
        "all": visible.sample_count,
        "seen_bytes": count * visible.sample_bytes,
        "all_bytes": visible.sample_count * visible.sample_bytes,
        "saved": 1 - count / visible.sample_count,
    }
