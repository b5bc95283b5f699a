"""What all synthetic sets have in common: counts, names, tensors, and the same draws for a seed everywhere."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor

from data_tools.synthetic import brdf
from data_tools.synthetic.svbrdf_stationary import FLAT
from metapp.runs.inputs.embedded import embedded_data
from metapp.storage.manifest import read_manifest
from tests.synthetic.drawn import Drawn, drawn, source_of

Kind = tuple[torch.dtype, tuple[int, ...]]
IMAGE: Kind = (torch.uint8, (3, 256, 256))


def means(rows: Tensor) -> Tensor:
    return rows.float().mean((2, 3))


def channels(maps: Tensor) -> Tensor:
    """Normal x, diffuse green, roughness and specular green."""
    return maps[:, [0, 4, 6, 8]].float().mean((2, 3))


def halves(light: Tensor) -> Tensor:
    """The upper and the lower half of red, green and blue."""
    return light.unflatten(2, (2, 32)).mean((3, 4)).flatten(1)


class Expected(NamedTuple):
    """What a set has.

    Attributes:
        counts: tasks for training and for testing.
        names: some, by their place.
        tensors: of all tasks, by name; the first of them is compared.
        measure: reduces the first tensor of each task to some numbers: of those of `rows` they are all but the last of
            `figures`, to an absolute and a relative tolerance; the last are the means over all, to a sixth of these.
        least: the least mean difference of tasks of the same place by another seed.
    """

    counts: tuple[int, int]
    names: dict[int, str]
    tensors: dict[str, Kind]
    measure: Callable[[Tensor], Tensor]
    rows: tuple[int, int, int]
    figures: tuple[tuple[float, ...], ...]
    tolerances: tuple[float, float]
    least: float


SETS = {
    "texture": Expected(
        (240, 20), {0: "bricks-000", 100: "bricks-t000"}, {"image": IMAGE}, means, (0, 33, 112),
        ((120.05, 94.97, 89.41), (184.26, 124.76, 93.63), (159.70, 158.05, 156.52), (136.20, 127.91, 115.55)),
        (0.3, 0), 2,
    ),
    "svbrdf_stationary": Expected(
        (120, 16), {}, {"image": IMAGE}, means, (3, 40, 69),
        ((117.12, 107.52, 90.58), (106.62, 105.66, 102.13), (105.63, 110.56, 111.35), (113.60, 102.12, 98.08)),
        (0.3, 0), 2,
    ),
    "svbrdf_nonstationary": Expected(
        (1200, 16), {0: "inlay-000", 48: "inlay-t000"},
        {"maps": (torch.float16, (10, 128, 128)), "photo": (torch.uint8, (3, 128, 128))}, channels, (4, 21, 60),
        ((-0.0032, 0.1001, 0.4919, 0.3050), (0.0001, 0.0211, 0.4600, 0.5278), (0.0015, 0.0900, 0.6739, 0.0442),
         (0.0030, 0.1732, 0.4850, 0.1883)), (0.003, 0), 0.02,
    ),
    "illumination": Expected(
        (900, 16), {0: "meadow-000", 1: "apartment-001", 48: "meadow-t000"},
        {"map": (torch.float32, (3, 64, 128)), "photos": (torch.uint8, (4, 3, 64, 64)), "scale": (torch.float32, ())},
        halves, (0, 21, 60),
        ((1.2468, 0.4939, 1.4069, 0.4491, 1.6428, 0.3528), (2.2516, 0.2897, 1.9984, 0.2339, 1.6686, 0.1976),
         (1.3883, 0.1651, 1.5073, 0.1827, 1.6945, 0.0962), (1.5877, 0.4542, 1.4638, 0.3918, 1.4376, 0.3249)),
        (0, 0.01), 0.1,
    ),
}  # fmt: skip


@pytest.fixture(params=SETS)
def app(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def data(app: str) -> Drawn:
    return drawn(app)


@pytest.mark.long
def test_counts_names_and_tensors(app: str, data: Drawn) -> None:
    counts, some, tensors, *_ = SETS[app]
    assert (data.source.COUNTS["train"], data.source.COUNTS["test"]) == counts
    names = [task.name for task in data.tasks]
    assert len(set(names)) == len(names) == len(data.train) + counts[1]
    assert {place: names[place] for place in some} == some
    families = FLAT if app == "svbrdf_stationary" else data.source.FAMILIES
    for split in (names[: len(families)], names[len(data.train) :]):
        assert {name.split("-")[0] for name in split} == set(families) or len(split) < len(families)
    for task in data.tasks:
        more = {"relit" if task in data.test else "truth"} if app == "svbrdf_stationary" else set()
        assert set(task.data) == tensors.keys() | more <= set(data.source.UNITS)
        assert {key: (task.data[key].dtype, task.data[key].shape) for key in tensors} == tensors


@pytest.mark.long
def test_a_larger_set_begins_with_the_smaller_one_and_a_seed_changes_all(app: str, data: Drawn) -> None:
    for one, two in zip(data.source.synthetic_tasks("train", 6), data.train, strict=False):
        assert one.name == two.name
        assert all(torch.equal(one.data[key], two.data[key]) for key in two.data)
    key = next(iter(SETS[app].tensors))
    for one, two in zip(data.source.synthetic_tasks("train", 8, seed=1), data.train, strict=False):
        assert (one.data[key].float() - two.data[key].float()).abs().mean() > SETS[app].least


@pytest.mark.long
def test_draws_are_the_same_on_every_machine(app: str, data: Drawn) -> None:
    """Whoever changes a draw changes the default data set, and with it all checkpoints and tables."""
    expected = SETS[app]
    key, (absolute, relative) = next(iter(expected.tensors)), expected.tolerances
    found = expected.measure(torch.stack([task.data[key] for task in data.tasks]))
    *figures, means = torch.tensor(expected.figures)
    torch.testing.assert_close(found[list(expected.rows)], torch.stack(figures), atol=absolute, rtol=relative)
    torch.testing.assert_close(found.mean(0), means, atol=absolute / 6, rtol=relative / 6)


def test_the_embedded_set_has_all_units(app: str, tmp_path: Path) -> None:
    manifest = read_manifest(embedded_data(app, count=5, out=tmp_path / "set", quiet=True))
    assert (manifest.app, manifest.units) == (app, source_of(app).UNITS)
    assert [entry.split for entry in manifest.tasks].count("test") >= 1


@pytest.mark.parametrize("arguments", [("validation", 1), ("train", -1), ("test", 5, -2)])
def test_impossible_sets_are_errors(app: str, arguments: tuple[Any, ...]) -> None:
    with pytest.raises(ValueError, match="expected"):
        next(source_of(app).synthetic_tasks(*arguments))
    with pytest.raises(ValueError, match="expected"):
        brdf.synthetic_materials(*arguments)
