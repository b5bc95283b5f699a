"""What metapp itself leaves, mutated: packs of fits and records that are fitted again."""

from __future__ import annotations

import contextlib
import functools
import json
import lzma
import random
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torture import seeds
from torture.child import BadResult
from torture.mutate import mutate_bytes, mutate_json
from torture.seeds import Files

RECORDS, PACK = "record.jsonl", "fits.pack"
FITS = (("general", ""), ("meta", "meta-curvature"))


@functools.cache
def runs() -> list[Files]:
    """Data sets of two BRDFs, with the records of a run on them and its fits as a pack."""
    from metapp.apps.brdf.app import Brdf
    from metapp.extensions.packs.pack import pack
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
            pack(run.folder.path, Path(place) / PACK, 8, [], data=data, quiet=True)
            records = run.folder.file.read_text().replace(str(data), ".")
            made.append({RECORDS: records.encode(), **files, PACK: (Path(place) / PACK).read_bytes()})
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


def packs() -> list[Files]:
    """The fits of these runs."""
    return [{PACK: files[PACK]} for files in runs()]


def write_pack(rng: random.Random, folder: Path) -> Path:
    """A pack whose bytes are mutated, or those that it unfolds to, or values of its header, the length put right."""
    content, kind = rng.choice(packs())[PACK], rng.random()
    if kind < 0.2:
        content = mutate_bytes(rng, content, [content])
    else:
        unfolded = lzma.decompress(content)
        length = int.from_bytes(unfolded[:4], "little")
        head, planes = unfolded[4 : 4 + length], unfolded[4 + length :]
        if kind < 0.8:
            said = json.loads(head)
            about = said["about"]
            parts = (said, about, about["settings"], about["records"][0], said["tensors"][0])
            head = _with_mutated(rng, said, parts).encode("utf-8", "surrogatepass")
        if not 0.3 < kind < 0.8:
            planes = mutate_bytes(rng, planes, [planes])
        content = lzma.compress(len(head).to_bytes(4, "little") + head + planes, preset=0)
    (folder / PACK).write_bytes(content)
    return folder / PACK


def read_pack(folder: Path, file: Path) -> None:
    """As `metapp unpack`; what it makes is read again."""
    from metapp.extensions.packs.pack import unpack
    from metapp.runs.outputs.recorded import read_run
    from metapp.storage.records import read_theta

    run = Path(unpack(file, folder / "out", None).out)
    for record in read_run(run).records:
        if not all(bool(value.isfinite().all()) for value in read_theta(run, record["name"]).values()):
            raise BadResult("parameters that are not finite")
