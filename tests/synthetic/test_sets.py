"""What all synthetic sets have in common: counts, names, tensors, and the same draws for a seed everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import pytest
import torch

from data_tools.synthetic import brdf
from data_tools.synthetic.svbrdf_stationary import FLAT
from metapp.runs.inputs.embedded import embedded_data
from metapp.storage.shards import read_manifest
from tests.synthetic.drawn import Drawn, drawn, source_of

Kind = tuple[torch.dtype, tuple[int, ...]]
IMAGE: Kind = (torch.uint8, (3, 256, 256))


class Expected(NamedTuple):
    """What a set has.

    Attributes:
        counts: tasks for training and for testing.
        names: some, by their place.
        tensors: of all tasks, by name; the first of them is compared.
        means: of its channels over all tasks.
        spread: standard deviations of the tasks' own means.
        tolerance: absolute, of both.
        apart: the least mean difference of two tasks at an eighth of their size, and of tasks of the same place by
            another seed.
    """

    counts: tuple[int, int]
    names: dict[int, str]
    tensors: dict[str, Kind]
    means: tuple[float, ...]
    spread: tuple[float, ...]
    tolerance: float
    apart: float


SETS = {
    "texture": Expected(
        (240, 20), {0: "bricks-000", 100: "bricks-t000"}, {"image": IMAGE},
        (136.20, 127.91, 115.55), (28.56, 24.97, 24.67), 0.05, 2.55,
    ),
    "svbrdf_stationary": Expected(
        (120, 16), {}, {"image": IMAGE}, (113.60, 102.12, 98.08), (27.89, 23.31, 26.08), 0.05, 2.55
    ),
    "svbrdf_nonstationary": Expected(
        (1200, 16), {0: "inlay-000", 48: "inlay-t000"},
        {"maps": (torch.float16, (10, 128, 128)), "photo": (torch.uint8, (3, 128, 128))},
        (0.0030, 0.0025, 0.9560, 0.2005, 0.1732, 0.1500, 0.4850, 0.2092, 0.1883, 0.1628),
        (0.0159, 0.0193, 0.0400, 0.1772, 0.1593, 0.1434, 0.1530, 0.2263, 0.2046, 0.1852), 0.0005, 0.02,
    ),
    "illumination": Expected(
        (900, 16), {0: "meadow-000", 1: "apartment-001", 48: "meadow-t000"},
        {"map": (torch.float32, (3, 64, 128)), "photos": (torch.uint8, (4, 3, 64, 64)), "scale": (torch.float32, ())},
        (1.0210, 0.9278, 0.8813), (0.2404, 0.1904, 0.2582), 0.0015, 0.15,
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
    counts, some, tensors = SETS[app][:3]
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
        assert (one.data[key].float() - two.data[key].float()).abs().mean() > SETS[app].apart


@pytest.mark.long
def test_draws_are_the_same_on_every_machine_and_no_two_are_alike(app: str, data: Drawn) -> None:
    """Whoever changes a draw changes the default data set, and with it all checkpoints and tables."""
    expected = SETS[app]
    tensors = torch.stack([task.data[next(iter(expected.tensors))] for task in data.tasks]).float()
    own = tensors.mean((2, 3))
    found = torch.stack([own.mean(0), own.std(0)])
    wanted = torch.tensor([expected.means, expected.spread])
    torch.testing.assert_close(found, wanted, atol=expected.tolerance, rtol=0)
    small = torch.nn.functional.avg_pool2d(tensors, 8).flatten(1)
    apart = torch.cdist(small, small, p=1).fill_diagonal_(float("inf")) / small.shape[1]
    assert apart.min() > expected.apart  # with that no test task is a training task


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
