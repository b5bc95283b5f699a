"""The options of a fit as they were given; nothing is looked up, and nothing large is imported."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeVar

from metapp.runs import BadOption

Item = TypeVar("Item")


@dataclass(frozen=True)
class Request:
    """The options that all fits have; those of the command line have the same names, and --help says what each means.

    Attributes:
        app: name of the application.
        paradigm: general, overfit, finetune, quickft or meta.
        inputs: files and folders; none: the test tasks of the data set.
        objects: of a program, in memory, instead of files.
        export: forms to write fits in, with commas between them.
        options: what was given of the options that extensions declare, by name (`metapp.runs.requests.options`).
        quiet: no progress, no messages but warnings.
    """

    app: str
    paradigm: str = "meta"
    inputs: Sequence[Path] = ()
    objects: Sequence[object] = ()
    steps: int | None = None
    rule: str = ""
    recipe: str = ""
    observe: str = ""
    train: bool = False
    train_steps: int | None = None
    checkpoint: Path | None = None
    data: Path | None = None
    out: Path = Path("runs")
    batch: str = ""
    shard: str = ""
    export: str = ""
    options: Mapping[str, object] = field(default_factory=dict)
    seed: int = 0
    device: str = "auto"
    quiet: bool = False

    @property
    def exports(self) -> tuple[str, ...]:
        """The forms to write fits in, each once."""
        return tuple(dict.fromkeys(name for name in self.export.split(",") if name))

    @property
    def resumes(self) -> bool:
        """True if a run that is finished stays as it is, and failures are listed: with --batch or --shard."""
        return bool(self.batch or self.shard)


class Portion(NamedTuple):
    """The share of one machine in a run: every `parts`-th of its tasks from the `number`-th on, both counted from 1."""

    number: int = 1
    parts: int = 1

    def of(self, items: Sequence[Item]) -> list[Item]:
        """The items of this portion."""
        return list(items[self.number - 1 :: self.parts])


def portion_of(text: str) -> Portion:
    """Read I/N; all of "".

    Raises:
        BadOption: it is no such text, or there is no such portion.
    """
    match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text or "1/1")
    portion = Portion(int(match[1]), int(match[2])) if match else Portion(0, 0)
    if not 1 <= portion.number <= portion.parts:
        raise BadOption(f"--shard '{text}': expected I/N, the I-th of N parts, such as 1/4 to 4/4.")
    return portion
