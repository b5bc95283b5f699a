"""The options of a fit as they were given; nothing is looked up, and nothing large is imported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path


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
    batch: int | None = None
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
        """True if a run that is finished stays as it is, and failures are listed: with --batch."""
        return self.batch is not None
