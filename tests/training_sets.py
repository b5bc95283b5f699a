"""What cards of checkpoints state of the training tasks that were drawn, and what the sources draw now.

    python -m tests.training_sets        # prints the table of drawn tasks of each card

A card has two tables. Each entry of a checkpoint has a row, such as `quick/general`: the data that its description
names, the first commit that held these weights, the command that makes it, and the sets of drawn tasks among its
training tasks. Each set has a row: the command that draws it, and the mean and the standard deviation of each tensor
over its first training tasks. These numbers change with any change of the draws, but hardly with the processor, with
which a digest of the bytes would change.
"""

import itertools
import re
import shlex
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from metapp.storage.checkpoint_files import read_headers

ROOT = Path(__file__).parent.parent
FOLDERS = [ROOT / "metapp/checkpoints", ROOT / "metapp/extensions"]
ENTRY_COLUMNS = ["entry", "data", "first commit", "made by", "drawn tasks"]
SET_COLUMNS = ["drawn tasks", "command", "tensor: mean, standard deviation over the first tasks"]
FIRST_TASKS = (
    3  # tasks that are drawn of a set without families, of BRDFs and of large pictures, which take seconds each
)
NO_SET = "none"  # stands in the row of an entry that no drawn task trained
OMITTED = ("scene",)  # tensors that hold text


class EntryRow(NamedTuple):
    """What a card states of an entry of a checkpoint; `sets` are the names of its sets of drawn tasks."""

    entry: str
    data: str
    commit: str
    command: str
    sets: list[str]


class SetRow(NamedTuple):
    """What a card states of a set of drawn tasks."""

    name: str
    command: str
    summary: str


def read_table(text: str, columns: list[str]) -> list[list[str]]:
    """Return the cells of all rows of the tables of a page that have these columns, without code marks."""
    rows, is_inside = [], False
    for line in text.splitlines():
        cells = (
            [cell.strip().strip("`") for cell in line.strip().strip("|").split(" | ")] if line.startswith("|") else []
        )
        if cells == columns:
            is_inside = True
        elif is_inside and cells and not cells[0].startswith("---"):
            rows.append(cells)
        elif not cells:
            is_inside = False
    return rows


def cards() -> list[Path]:
    """Return the pages that state how checkpoints were made."""
    return sorted(path for folder in FOLDERS for path in folder.rglob("*.md") if "checkpoints" in path.parts)


def entry_rows(card: Path) -> list[EntryRow]:
    """Return the rows of a card's entries."""
    return [
        EntryRow(*cells[:4], re.findall(r"[^,\s`]+", cells[4])) for cells in read_table(card.read_text(), ENTRY_COLUMNS)
    ]


def set_rows(card: Path) -> list[SetRow]:
    """Return the rows of a card's sets."""
    return [SetRow(*cells) for cells in read_table(card.read_text(), SET_COLUMNS)]


def stated_data(folder: Path) -> dict[tuple[Path, str], str]:
    """Return what the description of each entry of all checkpoints calls the data that it was trained on.

    Returns:
        The data by the file's path without suffix, and the entry's name.
    """
    paths = sorted(folder.rglob("*.safetensors"))
    headers = {(path.with_suffix(""), entry): header for path in paths for entry, header in read_headers(path).items()}
    return {place: str(header.get("data")) for place, header in headers.items()}


def summarise_draws(command: str) -> str:
    """Draw the first training tasks of a set, one of each family or FIRST_TASKS, and summarise their tensors.

    Args:
        command: such as `metapp data synth texture --size 512 --count 48`.

    Returns:
        Such as "image: 125.1, 32.73"; several tensors are separated by semicolons.
    """
    words = shlex.split(command.removeprefix("metapp data synth "))
    app, options, words = words[0], {}, words[1:]
    while words:
        name = words.pop(0).removeprefix("--")
        options[name] = int(words.pop(0)) if words and not words[0].startswith("--") else True
    options.pop("count", None)  # a larger set begins with the smaller one
    source = import_module(f"data_tools.synthetic.{app}")
    task_count = (
        FIRST_TASKS if {"size", "rows"} & options.keys() else len(getattr(source, "FAMILIES", ())) or FIRST_TASKS
    )
    tasks = source.synthetic_tasks("train", task_count, options.pop("seed", 0), **options)
    sums: dict[str, list[tuple[float, float]]] = {}
    for task in itertools.islice(tasks, task_count):
        for name, tensor in task.data.items():
            values = tensor.double()
            sums.setdefault(name, []).append((float(values.mean()), float(values.std(correction=0))))
    means = {name: [sum(column) / len(column) for column in zip(*values, strict=True)] for name, values in sums.items()}
    return "; ".join(
        f"{name}: {mean:.5g}, {deviation:.5g}" for name, (mean, deviation) in means.items() if name not in OMITTED
    )


def read_summary(summary: str) -> dict[str, list[float]]:
    """Return the numbers of a summary by the names of tensors."""
    pairs = (part.split(":") for part in summary.split(";"))
    return {name.strip(): [float(number) for number in numbers.split(",")] for name, numbers in pairs}


if __name__ == "__main__":
    for page in cards():
        print(page.relative_to(ROOT))
        for row in set_rows(page):
            print(f"| {row.name} | `{row.command}` | {summarise_draws(row.command)} |")
