"""What is tried on mutated inputs: how each reader is called as commands call it, and what a good result is."""

from __future__ import annotations

import functools
import json
import math
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from torture import arrays, caches, links, scene_data, seeds
from torture.child import BadResult
from torture.mutate import mutate_bytes, mutate_json, mutate_xml

FEW_ROWS = 8  # of tables of a goniometer


class Target(NamedTuple):
    """A reader.

    Attributes:
        seeds: valid inputs.
        read: takes the input's folder and the mutated file; ValueError is a refusal.
        write: instead of mutating a seed's file; returns the file.
        inputs: so many, and with --quick.
    """

    seeds: Callable[[], list[seeds.Files]]
    read: Callable[[Path, Path], None]
    write: Callable[[random.Random, Path], Path] | None = None
    inputs: tuple[int, int] = (10_000, 250)


def mutated(rng: random.Random, target: Target, folder: Path, valid: list[seeds.Files]) -> Path:
    """Write one mutated input into an empty folder; the mutated file."""
    if target.write:
        return target.write(rng, folder)
    files = rng.choice(valid)
    name = rng.choice(list(files))
    kind = rng.random()
    if name.endswith((".json", ".jsonl")) and kind < 0.7:
        lines = files[name].decode().splitlines() if name.endswith("l") else [files[name].decode()]
        at = rng.randrange(len(lines))
        lines[at] = mutate_json(rng, json.loads(lines[at]))
        content = "\n".join(lines).encode("utf-8", "surrogatepass")
    elif name.endswith(".xml") and kind < 0.7:
        content = mutate_xml(rng, files[name].decode()).encode("utf-8", "surrogatepass")
    elif name.endswith(".safetensors") and kind < 0.5:
        content = _safetensors(rng, files[name])
    else:
        content = mutate_bytes(rng, files[name], [files_[n] for files_ in valid for n in files_])
    for other, whole in files.items():
        (folder / other).write_bytes(content if other == name else whole)
    return folder / name


def _safetensors(rng: random.Random, content: bytes) -> bytes:
    """The header as JSON with changed values, its length put right."""
    length = int.from_bytes(content[:8], "little")
    document = json.loads(content[8 : 8 + length])
    description = document.get("__metadata__", {}).get("metapp")
    if description and rng.random() < 0.6:
        document["__metadata__"]["metapp"] = mutate_json(rng, json.loads(description))
        header = json.dumps(document).encode()
    else:
        header = mutate_json(rng, document).encode("utf-8", "surrogatepass")
    return len(header).to_bytes(8, "little") + header + content[8 + length :]


def finite(task: Any, **shapes: tuple[int, ...] | None) -> None:
    """Refuse a task with values that are not finite, or of other shapes."""
    for key, value in task.data.items():
        if not bool(value.isfinite().all()):
            raise BadResult(f"{key} is not finite")
    for key, shape in shapes.items():
        if shape and (key not in task.data or tuple(task.data[key].shape) != shape):
            raise BadResult(f"{key} is {tuple(task.data[key].shape) if key in task.data else None}, expected {shape}")


def _merl_file(rng: random.Random, folder: Path) -> Path:
    """Mostly headers and sizes, which cost little; one in 20 is whole, with values changed."""
    from data_tools.readers.merl import _HEADER, FILE_BYTES

    file = folder / "gold.binary"
    header = _HEADER.tobytes()
    with file.open("wb") as stream:
        if rng.random() < 0.95:
            stream.write(mutate_bytes(rng, header + bytes(64), [header])[: rng.choice((12, 76))])
            stream.truncate(rng.choice((FILE_BYTES, FILE_BYTES, FILE_BYTES - 1, FILE_BYTES + 8, rng.randrange(200))))
            return file
        stream.write(header)
        for _ in range(rng.choice((1, 10, 1000))):
            stream.seek(rng.randrange(12, FILE_BYTES))
            stream.write(rng.randbytes(8 * rng.choice((1, 2))))
        stream.truncate(FILE_BYTES)
    return file


def _read_merl(folder: Path, file: Path) -> None:
    import numpy as np

    from data_tools.readers.merl import find, read_merl
    from data_tools.readers.merl_table import SHAPE

    find([file])
    table = read_merl(file)
    if table.shape != (*SHAPE, 3) or not np.isfinite(table).all():
        raise BadResult(f"table {table.shape} or not finite")


def _read_nbrdf(folder: Path, file: Path) -> None:
    from data_tools.readers import nbrdf

    for network in nbrdf.find([folder])[0]:
        weights = nbrdf.read_nbrdf(network)
        if any(weights[part].shape != shape for part, shape in nbrdf.SHAPES.items()):
            raise BadResult("weights of other shapes")
        if sum(file.read_bytes()) % 20 == 0:  # its pictures cost more than all else
            finite(nbrdf.read_task(network, samples=64), reflectance=(64, 3))


def _read_rgl(folder: Path, file: Path) -> None:
    import torch

    from metapp.extensions.rgl import rgl

    values = rgl.read_rgl(rgl.find([folder])[0][0])(torch.tensor([[0.1, 0.2, 0.3], [0.6, 0.9, 4.0]]))
    if values.shape != (2, 3) or not bool(values.isfinite().all()):
        raise BadResult(f"reflectance {values.tolist()}")


def _read_gonio(folder: Path, file: Path) -> None:
    from metapp.extensions.few import gonio

    wi, wo, reflectance = gonio.read_pairs(file)
    if not wi.shape == wo.shape == reflectance.shape or not bool((wi + wo + reflectance).isfinite().all()):
        raise BadResult(f"wi {tuple(wi.shape)}, reflectance {tuple(reflectance.shape)}, or not finite")
    if len(wi) <= FEW_ROWS or sum(file.read_bytes()) % 20 == 0:  # its picture costs more than all else
        finite(gonio.read_task(file), reflectance=None)


def _write_gonio(rng: random.Random, folder: Path) -> Path:
    """A mutated table, or one of few rows."""
    if rng.random() < 0.95:
        return mutated(rng, Target(seeds.goniometer_files, _read_gonio), folder, seeds.goniometer_files())
    (folder / "few.csv").write_text(few_rows(rng))
    return folder / "few.csv"


def few_rows(rng: random.Random) -> str:
    """A table of FEW_ROWS at most: angles that are extreme or repeated, in several units, and values of any size."""
    unit = rng.choice(("deg", "deg", "deg", "rad", "", "grad", "cos"))
    columns = rng.choice(
        (["r", "g", "b"], ["r", "g", "b"], ["550nm"], ["400nm", "700nm"], ["1nm", "99999nm"], ["r", "r", "b"])
    )
    names = [f"{name}_{unit}".strip("_") for name in ("theta_i", "phi_i", "theta_o", "phi_o")]
    most = 90 if unit == "deg" else math.pi / 2
    extreme = (0, -0.0, most, most - 1e-9, most + 1e-9, -most, 1e-30, 4 * most, 40 * most, 1e6, float("nan"))
    rows: list[list[float]] = []
    for _ in range(rng.randint(1, FEW_ROWS)):
        angles = [rng.choice(extreme) if rng.random() < 0.1 else rng.uniform(0, most * (1 + i % 2)) for i in range(4)]
        values = [rng.choice((0, 1e-30, 1e4, 1e30, -1, 0.5)) if rng.random() < 0.1 else rng.random() for _ in columns]
        rows.append(rng.choice(rows) if rows and rng.random() < 0.3 else angles + values)
    return "\n".join(rng.choice((",", ", ")).join(map(str, row)) for row in ([*names, *columns], *rows)) + "\n"


def _read_with(module: str, key: str | None, side: int, folder: Path, file: Path) -> None:
    """A reader of pictures."""
    import importlib

    reader = importlib.import_module(f"data_tools.readers.{module}")
    for source in reader.find([file])[0]:
        finite(reader.read_task(source, side), **({key: (3, side, side)} if key else {}))


def _read_maps(folder: Path, file: Path) -> None:
    from data_tools.readers import svbrdf_inputs

    for source in svbrdf_inputs.find([folder])[0]:
        finite(svbrdf_inputs.read_task(source, 32))


def _read_light(folder: Path, file: Path) -> None:
    from data_tools.readers import latlong
    from metapp.extensions.capture.ball import reading

    reader = latlong if latlong.recognises(file) else reading
    finite(reader.read_task(reader.find([file])[0][0]))


def _read_scene(folder: Path, file: Path) -> None:
    from metapp.extensions.scene_files.reading import find, read_scene
    from metapp.extensions.scene_files.trial import try_scene
    from metapp.rendering.scenes.loading import load_scene
    from metapp.rendering.variant import load_mitsuba

    path = next((path for path in find([folder])[0] if path.name.startswith("box")), file)
    scene = read_scene(path)
    try:
        try_scene(scene, load_mitsuba().variant())
        brightest = load_scene(scene).brightest
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None  # as read_task names it
    if not math.isfinite(brightest) or brightest < 0:
        raise BadResult(f"a scene whose brightest light is {brightest}")


def _read_shard(folder: Path, file: Path) -> None:
    from metapp.apps.brdf.app import Brdf
    from metapp.learning.app import stack
    from metapp.runs.inputs.sources import tasks_of_data
    from metapp.storage.shards import check_shard

    app = Brdf()
    check_shard(folder)
    tasks = tasks_of_data(app, folder, True)[0]
    for task in tasks:
        # the picture of the environment is optional
        finite(task, **({"environment": (48, 48, 4)} if "environment" in task.data else {}))
    stack(app, tasks)


def _read_manifest(folder: Path, file: Path) -> None:
    from metapp.storage.manifest import fingerprint, read_manifest

    read_manifest(folder)
    fingerprint(folder)


@functools.cache
def _small_task() -> Any:
    from data_tools.readers.brdf_task import brdf_task
    from metapp.apps.brdf.app import Brdf
    from metapp.learning.app import stack

    return stack(Brdf(), [brdf_task("small", lambda angles: angles * 0 + 0.1, samples=64)])


def _read_checkpoint(folder: Path, file: Path) -> None:
    """As --checkpoint, then one step of a fit."""
    import torch

    from metapp.runs.checkpoints.finding import find_checkpoint
    from metapp.runs.requests.plan import plan
    from metapp.runs.requests.request import Request

    options = {"rule": file.stem, "recipe": "quick", "steps": 1, "checkpoint": file, "out": folder}
    by = find_checkpoint(plan(Request("brdf", **options, device="cpu", quiet=True)))
    by.paradigm.fit(by.job, by.prepared, _small_task(), torch.Generator().manual_seed(0))


def _read_records(folder: Path, file: Path) -> None:
    """As a run that goes on, whose table shows all finished tasks."""
    from metapp.storage.records import FIT, RunFolder, summary

    records = RunFolder(folder, {"app": "brdf", "steps": 10}, FIT).finished()
    for name, record in records.items():
        numbers = [record["seconds"], *([] if record["error"] is None else [record["error"]])]
        if not isinstance(name, str) or not all(math.isfinite(number) for number in numbers):
            raise BadResult(f"a record {record}")
    if records:
        summary(list(records.values()))


def _manifest_alone() -> list[seeds.Files]:
    return [{"manifest.json": files["manifest.json"]} for files in seeds.shards()]


@functools.cache
def _scene_files(kind: str) -> list[seeds.Files]:
    return {"meshes": scene_data.meshes, "volumes": scene_data.volumes}[kind]()


def _write_scene(kind: str, rng: random.Random, folder: Path) -> Path:
    return scene_data.write(rng, folder, _scene_files(kind))


TARGETS: dict[str, Target] = {
    "merl": Target(lambda: [], _read_merl, _merl_file),
    "nbrdf": Target(seeds.networks, _read_nbrdf),
    "rgl": Target(seeds.rgl_files, _read_rgl),
    "gonio": Target(seeds.goniometer_files, _read_gonio, _write_gonio),
    "images": Target(seeds.photographs, functools.partial(_read_with, "photos", "image", 32)),
    "flash": Target(seeds.flash_photos, functools.partial(_read_with, "flash", "image", 32)),
    "strips": Target(seeds.strips, functools.partial(_read_with, "strips", "photo", 32)),
    "material_maps": Target(seeds.material_maps, _read_maps),
    "latlong": Target(seeds.maps_of_light, _read_light),
    "scene_xml": Target(seeds.scenes_xml, _read_scene),
    "scene_json": Target(seeds.scenes_json, _read_scene),
    "scene_old": Target(scene_data.old_scenes, _read_scene),
    "meshes": Target(scene_data.meshes, _read_scene, functools.partial(_write_scene, "meshes")),
    "volumes": Target(scene_data.volumes, _read_scene, functools.partial(_write_scene, "volumes")),
    "shard": Target(seeds.shards, _read_shard),
    "manifest": Target(_manifest_alone, _read_manifest),
    "checkpoint": Target(seeds.checkpoints, _read_checkpoint),
    "record": Target(seeds.records, _read_records),
    "caches": Target(caches.cases, caches.read, caches.write, (1000, 40)),
    "links": Target(links.cases, links.read, links.write, (240, 8)),
    "arrays": Target(arrays.cases, arrays.read, arrays.write, (2000, 40)),
}
