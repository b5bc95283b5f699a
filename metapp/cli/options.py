"""Arguments and options that several commands have alike."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder, or the record.jsonl in it.")]
FittedData = Annotated[Path | None, typer.Option(help="The data set that was fitted, for the same.")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object as last line of standard output.")]
