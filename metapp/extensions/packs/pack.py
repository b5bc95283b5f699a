"""The fits of a run as one small file: the quantised difference from the checkpoint that whoever reads it has, too.

The paper's client and server share what training has made; what is sent of a fit is its difference from that.
"""

from __future__ import annotations

import bisect
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.extensions.packs.file import BITS, Pack, PackFile, Steps, in_steps, write_pack
from metapp.learning.app import App, stack
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params, Task
from metapp.paradigms import paradigms
from metapp.runs.checkpoints.finding import find_checkpoint
from metapp.runs.outputs.recorded import ORIGIN, SETTINGS, plan_as, read_run, tasks_as
from metapp.runs.reporter import progress, say
from metapp.runs.requests.plan import Plan
from metapp.storage import Document
from metapp.storage.files import named
from metapp.storage.forms import OPTIONAL, holds
from metapp.storage.plain import write_plainly
from metapp.storage.records import FIT, RunFolder, read_theta

GROWTH = 0.01  # of the mean error, at most, where the number of bits is chosen
WITHOUT = 12  # bits where there is no error to choose by
OF_FIT = {**SETTINGS, "paradigm": str, "rule": str, "checkpoint": str}
ABOUT = {"settings": OF_FIT, "bits": range(BITS[0], BITS[1] + 1), "records": [{**FIT, "name": str, "before": OPTIONAL}]}


class Packed(NamedTuple):
    """A pack that was written or read.

    Attributes:
        file: the pack.
        out: the run's folder.
        tasks: names of the fits.
        bits: of a number, before entropy coding.
        size: bytes of the file.
        shared: bytes of the checkpoint, which whoever reads it must have; 0 where nothing is needed of one.
        before: mean error of the fits; None where there is no reference, or it is not to be had.
        after: of what the file holds.
    """

    file: str
    out: str
    tasks: list[str]
    bits: int
    size: int
    shared: int
    before: float | None
    after: float | None


class Stack(NamedTuple):
    """Fits of one run: their tensors [T, ...], and the tasks, where they have references."""

    app: App
    thetas: Params
    tasks: list[Task]

    def errors(self, thetas: Params) -> list[float | None]:
        """As tables print them, of parameters [T, ...]; None where there is no reference."""
        scaled: list[float | None] = []
        for i, task in enumerate(self.tasks):
            one = {key: value[i : i + 1] for key, value in thetas.items()}
            errors = self.app.errors(one, stack(self.app, [task])) if task.data else {}
            scaled.append(self.app.traits.scale * float(errors["error"][0]) if errors else None)
        return scaled


def pack(
    run: Path,
    out: Path | None,
    bits: int | None,
    inputs: list[Path],
    *,
    data: Path | None = None,
    checkpoint: Path | None = None,
    quiet: bool = False,
) -> Packed:
    """Write the fits of a run as one file.

    Args:
        run: its folder, or the record file in it.
        out: the file; None: fits.pack in the folder.
        bits: of a number; None: as few as let the mean error grow by GROWTH at most.
        inputs: what was fitted, where records do not say where it is.
        data: the data set that was fitted, for the same.
        checkpoint: what was fitted by, where it is none that is found.
        quiet: no progress.

    Raises:
        ValueError: no run, records of several, another checkpoint than that of the fits, or too few bits.
    """
    folder, records = read_run(run, {**FIT, "key": str, "settings": OF_FIT, "origin?": ORIGIN})
    if any(record["settings"] != records[0]["settings"] for record in records):
        raise ValueError(f"{run}: records of several runs, expected those of one; fit into another --out.")
    settings = records[0]["settings"]
    plan = _plan_of(settings, str(run), checkpoint)
    names = [record["name"] for record in records]
    thetas = _stacked([read_theta(folder, name) for name in names], names)
    tasks = tasks_as(records, plan.app, inputs, data)
    if 0 < len(tasks) < len(names):
        say(f"note: errors of {len(tasks)} of {len(names)} fits, as what the others saw is not there or has changed.")
    fits = Stack(plan.app, thetas, [tasks.get(name, Task(name, {})) for name in names])
    base = shared_with(plan.prepared, {key: tuple(value.shape[1:]) for key, value in thetas.items()})
    before = fits.errors(thetas)
    with progress("pack", quiet=quiet) as bar:
        chosen = bits or _fewest_bits(fits, base, before, bar.name)
    steps = _in_steps(thetas, base, chosen)
    after = fits.errors(restored(steps, base))
    for name, error in zip(names, after, strict=True):
        if error is not None and not math.isfinite(error):
            raise ValueError(f"{run}: {name}: no finite error at {chosen} bits a number; give more --bits, or none.")
    kept = [
        {"name": name, "error": now, "seconds": record["seconds"], "before": then}
        for name, record, now, then in zip(names, records, after, before, strict=True)
    ]
    file = out or folder / "fits.pack"
    size = write_pack(file, Pack(names, steps, {"settings": settings, "bits": chosen, "records": kept}))
    return Packed(str(file), str(folder), names, chosen, size, _size_of(plan.prepared), _mean(before), _mean(after))


def unpack(file: Path, out: Path | None, checkpoint: Path | None, *, overwrite: bool = False) -> Packed:
    """Make a run's folder of a pack.

    Args:
        file: what `pack` wrote.
        out: the folder; None: named as the file, without its suffix.
        checkpoint: what was fitted by, where it is none that is found.

    Raises:
        ValueError: a damaged file, tensors that are not of the network, or another checkpoint than that of the fits.
    """
    packed = PackFile(file)
    names, about = packed.tasks, packed.about
    if not holds(about, ABOUT) or [record["name"] for record in about["records"]] != names:
        raise ValueError(f"{file}: not what metapp pack writes, expected settings and a record of each fit.")
    settings, records = about["settings"], about["records"]
    plan = _plan_of(settings, str(file), checkpoint)
    _require_network(file, plan.app, packed.shapes)
    steps = packed.read().tensors
    base = shared_with(plan.prepared, packed.shapes)
    _require_finite(file, plan.app, steps, base)
    folder = RunFolder(out or file.with_suffix(""), {**settings, "bits": about["bits"]})
    write_plainly(folder.path)
    if os.path.lexists(folder.file):
        if not overwrite:
            raise ValueError(f"{folder.file}: is there already, expected a new folder; add --overwrite to replace it.")
        folder.file.unlink()
    for i, record in enumerate(records):
        folder.add(record, restored(steps, base, i))
    before, after = ([record[key] for record in records] for key in ("before", "error"))
    size = file.stat().st_size
    return Packed(
        str(file), str(folder.path), names, about["bits"], size, _size_of(plan.prepared), _mean(before), _mean(after)
    )


def _require_network(file: Path, app: App, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse tensors that are not of the application's network: anybody may have written a pack.

    Raises:
        ValueError: one is missing or of another shape.
    """
    network = {key: tuple(value.shape[1:]) for key, value in app.init(torch.Generator().manual_seed(0), 1).items()}
    network |= {key: shape for key, shape in app.traits.given if key in shapes}
    for key in sorted({*network, *shapes}):
        if network.get(key) != shapes.get(key):
            raise ValueError(_NOT_OF.format(file, key, app.name))


def _require_finite(file: Path, app: App, steps: Mapping[str, Steps], base: Params) -> None:
    """Refuse steps by which whole numbers of BITS come to what is not finite.

    Raises:
        ValueError: there are such.
    """
    for key, of in steps.items():
        if not math.isfinite(float(base[key].abs().max()) + torch.tensor(of.step * 2 ** (BITS[1] - 1)).float().item()):
            raise ValueError(_NOT_OF.format(file, key, app.name))


_NOT_OF = "{}: tensor '{}' is not one of {}, expected a fit's; pack the fits again."


def shared_with(prepared: MetaParameters, shapes: Mapping[str, tuple[int, ...]]) -> Params:
    """Parameters that all fits by a checkpoint share: the learned initialisation, or the decoder.

    Args:
        prepared: the checkpoint.
        shapes: of a fit's tensors.

    Returns:
        A tensor of each name and shape: 0 for what an encoder predicts.
    """
    decoder = {key.removeprefix("decoder."): value for key, value in prepared.encoder.items()}
    shared = {**decoder, **prepared.theta}
    return {
        key: shared[key].cpu() if key in shared and shared[key].shape == shape else torch.zeros(shape)
        for key, shape in shapes.items()
    }


def restored(steps: Mapping[str, Steps], base: Params, fit: int | slice = slice(None)) -> Params:
    """Parameters [...] of a fit, or [T, ...] of several, of differences from what all fits share."""
    return {key: base[key] + of.values(fit) for key, of in steps.items()}


def _in_steps(thetas: Params, base: Params, bits: int) -> dict[str, Steps]:
    return {key: in_steps(value - base[key], bits) for key, value in thetas.items()}


def _fewest_bits(fits: Stack, base: Params, before: list[float | None], tell: Callable[[str], None]) -> int:
    """As few as let the mean error grow by GROWTH at most; WITHOUT where there is none."""
    mean = _mean(before)
    if mean is None:
        say(
            "note: no errors to choose bits by, as what was fitted is not there or has no reference; give it after RUN."
        )
        return WITHOUT

    def enough(bits: int) -> bool:
        tell(f"{bits} bits")
        now = _mean(fits.errors(restored(_in_steps(fits.thetas, base, bits), base)))
        return now is not None and now - mean <= GROWTH * abs(mean)

    return BITS[0] + bisect.bisect_left(range(BITS[0], BITS[1]), True, key=enough)


def _plan_of(settings: Document, subject: str, path: Path | None) -> Plan:
    """The plan of fits, with the checkpoint that they began at.

    Raises:
        ValueError: it is another one.
    """
    if settings["paradigm"] not in paradigms():
        names = ", ".join(paradigms())
        raise ValueError(f"{subject}: fits by {settings['paradigm']}, expected one of {names}; fit again.")
    digest = settings["checkpoint"]
    try:
        plan = find_checkpoint(plan_as(settings, checkpoint=path if digest else None, device="cpu"))
    except ValueError as error:
        raise named(error, Path(subject)) from None
    assert plan.checkpoint is not None
    if plan.checkpoint.digest != digest:
        raise ValueError(
            f"{subject}: checkpoint {plan.checkpoint.digest} ({plan.checkpoint.source}), expected {digest}, by which "
            "the fits were made; give that file by --checkpoint."
        )
    return plan


def _stacked(thetas: list[Params], names: list[str]) -> Params:
    shapes = {key: value.shape for key, value in thetas[0].items()}
    for name, theta in zip(names, thetas, strict=True):
        if {key: value.shape for key, value in theta.items()} != shapes:
            raise ValueError(f"{name}: other tensors than {names[0]}, expected fits of one network; fit again.")
        if not all(bool(value.isfinite().all()) for value in theta.values()):
            raise ValueError(f"{name}: NaN or infinite parameters, expected finite ones; fit again.")
    return {key: torch.stack([theta[key].float() for theta in thetas]) for key in shapes}


def _size_of(prepared: MetaParameters) -> int:
    """Bytes of the tensors that packs are differences from."""
    decoder = [value for key, value in prepared.encoder.items() if key.startswith("decoder.")]
    return sum(value.numel() * value.element_size() for value in [*prepared.theta.values(), *decoder])


def _mean(errors: list[float | None]) -> float | None:
    measured = [error for error in errors if error is not None]
    return sum(measured) / len(measured) if measured else None
