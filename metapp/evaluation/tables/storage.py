"""The paper's storage argument: bytes for m exemplars, as m grows, of the parameters that are really there."""

from __future__ import annotations

from torch import Generator

from metapp.evaluation.rows import Row, Table, blank, bytes_column, columns, numbers, paper
from metapp.evaluation.subject import Subject
from metapp.learning.task import Params
from metapp.runs.naming import observe_of
from metapp.runs.plan import Checkpoint

COUNTS = (1, 10, 100, 1000)


def size(params: Params) -> int:
    """Bytes."""
    return sum(value.numel() * value.element_size() for value in params.values())


def stored(checkpoint: Checkpoint | None) -> int | None:
    """Bytes of a checkpoint, from which any fit is made; None where there is none."""
    return None if checkpoint is None else sum(size(part) for part in checkpoint.prepared)


def rows(subject: Subject) -> list[Row]:
    """What each paradigm must keep: networks of all exemplars, or what makes any of them when it is needed."""
    network = size(subject.app.init(Generator().manual_seed(0), 1))
    exemplars = paper()["storage"]["exemplars"]
    all_rows = []
    for name, fit in subject.fits.items():
        # fits that take long are kept; those that take no time are made again from their checkpoint
        once, each = (0, network) if name in ("overfit", "finetune") else (stored(fit.checkpoint), 0)
        row = blank(subject.app.name, name, beside_paper=False, **observe_of(subject.app))
        row |= {"network_bytes": network, "once_bytes": once, "each_bytes": each}
        row["networks"] = None if once is None or each else once / network
        for count in dict.fromkeys((*COUNTS, exemplars)):
            row[f"bytes_{count}"] = None if once is None else once + count * each
        total = row[f"bytes_{exemplars}"]
        row["factor"] = total / (exemplars * network) if total else None
        row["pays_from"] = -(-once // network) if once else None
        all_rows.append(row)
    return all_rows


def notes(subject: Subject, all_rows: list[Row]) -> list[str]:
    """What a factor is, what else is kept, and the paper's."""
    known = paper()["storage"]
    count = known["exemplars"]
    first = f"one network: {all_rows[0]['network_bytes']:,} bytes; factor: bytes for m = {count} over m networks'"
    return [
        f"{first}; from m = 'pays from' on a checkpoint is smaller than m networks",
        "what is made again from a checkpoint needs the exemplar itself, too, when it is wanted",
        f"paper: {known['meta_networks']} networks for any m, factor {known['meta_networks']}/m = {known['factor']:g}",
    ]


COLUMNS = columns(
    "paradigm",
    *(bytes_column(f"m = {count}", f"bytes_{count}") for count in COUNTS),
    numbers("factor", "factor", ".4f"),
    numbers("networks", "networks", ".2f"),
    numbers("pays from", "pays_from", "d"),
)
TABLE = Table("storage", "bytes for m exemplars", COLUMNS, rows, notes)
