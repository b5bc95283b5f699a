"""What metapp itself leaves, mutated: records that are fitted again."""

from __future__ import annotations

import contextlib
import functools
import json
import random
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torture import seeds
from torture.mutate import mutate_json
from torture.seeds import Files

RECORDS = "record.jsonl"
FITS = (("general", ""), ("meta", "meta-curvature"))


@functools.cache
def runs() -> list[Files]:
    """Data sets of two BRDFs, with the records of a run on them."""
    from metapp.apps.brdf.app import Brdf
    from metapp.runs.fits.execution import execute
    from metapp.runs.inputs.sources import data_folder
    from metapp.runs.requests.plan import plan
    from metapp.runs.requests.request import Request

    (files,), made = seeds.shards(), []
    data_folder(Brdf(), None, quiet=True)  # what records without an origin are fitted on is drawn only once
    with tempfile.TemporaryDirectory() as place:
        data = Path(place) / "input"  # as the folder that they are read in is called, since records say it
        data.mkdir()
        for name, content in files.items():
            (data / name).write_bytes(content)
        for paradigm, rule in FITS:
            options = {"rule": rule, "recipe": "quick", "data": data, "device": "cpu", "quiet": True}
            (run,) = execute(plan(Request("brdf", paradigm, out=Path(place) / "runs", **options)), None)
            records = run.folder.file.read_text().replace(str(data), ".")
            made.append({RECORDS: records.encode(), **files})
    return made


def write_run(rng: random.Random, folder: Path) -> Path:
    """A data set, and records of a run on it of which one is mutated."""
    files = rng.choice(runs())
    lines = files[RECORDS].decode().splitlines()
    at = rng.randrange(len(lines))
    record = json.loads(lines[at])
    lines[at] = _with_mutated(rng, record, (record, record["settings"], record["origin"]))
    for name, content in files.items():
        (folder / name).write_bytes(content)
    (folder / RECORDS).write_bytes("\n".join(lines).encode("utf-8", "surrogatepass"))
    return folder / RECORDS


def _with_mutated(rng: random.Random, document: Any, parts: Sequence[Any]) -> str:
    """The text of a document, one of whose parts is mutated: a mutation goes to the top more often than deep down."""
    part = rng.choice(parts)
    text = mutate_json(rng, part)
    return text if part is document else json.dumps(document).replace(json.dumps(part), text, 1)


def read_run(folder: Path, file: Path) -> None:
    """As `metapp rerun`."""
    from metapp.cli.console import print_json
    from metapp.extensions.reruns.rerun import Instead, rerun
    from metapp.extensions.reruns.rerun_command import _document, _table

    with contextlib.chdir(folder):  # the records' data set is "."
        try:
            rows = rerun(file, "", Instead(), quiet=True)
        except (ValueError, OSError) as error:
            raise ValueError(f"{file}: {error}") from None  # most name the task
    _table(rows)
    print_json({"tasks": [_document(row) for row in rows]})
