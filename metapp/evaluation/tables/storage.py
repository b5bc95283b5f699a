"""The paper's storage argument: bytes for m exemplars, as m grows, of the parameters that are really there."""

from __future__ import annotations

from torch import Generator

from metapp.evaluation.tables.rows import Row, blank, bytes_column, numbers, paper, words
from metapp.evaluation.tables.subject import Cell, Subject
from metapp.evaluation.tables.table import Table
from metapp.learning.task import Params
from metapp.runs.naming import observe_of
from metapp.runs.plan import Checkpoint

COUNTS = (1, 10, 100, 1000)


def size(params: Params) -> int:
    """Bytes."""
    return sum(value.numel() * value.element_size() for value in params.values())


def cells(subject: Subject) -> list[Cell]:
    """Nothing has to be run."""
    return []


def rows(subject: Subject) -> list[Row]:
    """What each paradigm must keep: networks of all exemplars, or what makes any of them when it is needed."""
    network = size(subject.app.init(Generator().manual_seed(0), 1))
    exemplars = paper()["storage"]["exemplars"]
    found = []
    for name, fit in subject.fits.items():
        # what takes long is kept; what takes no time is made again from its start
        once, each = (0, network) if name in ("overfit", "finetune") else (kept(fit.plan.checkpoint), 0)
        row = blank(subject.app.name, name, **observe_of(subject.app)) | {
            "paper_error": None,
            "paper_seconds": None,
            "network_bytes": network,
            "once_bytes": once,
            "each_bytes": each,
            "networks": None if once is None or each else once / network,
        }
        for count in dict.fromkeys((*COUNTS, exemplars)):
            row[f"bytes_{count}"] = None if once is None else once + count * each
        total = row[f"bytes_{exemplars}"]
        row["factor"] = total / (exemplars * network) if total else None
        row["pays_from"] = -(-once // network) if once else None
        found.append(row)
    return found


def kept(checkpoint: Checkpoint | None) -> int | None:
    """Bytes of all that a fit starts from; None where there is no checkpoint."""
    return None if checkpoint is None else sum(size(part) for part in checkpoint.prepared)


def notes(subject: Subject, found: list[Row]) -> list[str]:
    """What a factor is, what else is kept, and the paper's."""
    said = paper()["storage"]
    count = said["exemplars"]
    first = f"one network: {found[0]['network_bytes']:,} bytes; factor: bytes for m = {count} over m networks'"
    return [
        f"{first}; from m = 'pays from' on a start is smaller than m networks",
        "what is made again from a start needs the exemplar itself, too, when it is wanted",
        f"paper: {said['meta_networks']} networks for any m, factor {said['meta_networks']}/m = {said['factor']:g}",
    ]


TABLE = Table(
    "storage",
    "bytes for m exemplars",
    (
        words("paradigm", "paradigm"),
        *(bytes_column(f"m = {count}", f"bytes_{count}") for count in COUNTS),
        numbers("factor", "factor", ".4f"),
        numbers("networks", "networks", ".2f"),
        numbers("pays from", "pays_from", "d"),
    ),
    cells,
    rows,
    notes,
)
