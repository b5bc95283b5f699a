"""Three small materials, and the runs of all their tables."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from metapp.evaluation.evaluation_run import EvaluationRun
from tests.evaluation.cli.subjects import call, few_steps, subject_of


@pytest.fixture(autouse=True)
def few() -> Iterator[None]:
    """Few steps, as those of `done`."""
    with few_steps():
        yield


@pytest.fixture(scope="session")
def data(neural_fits: Callable[[int], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three small materials, all of them test tasks."""
    folder = tmp_path_factory.mktemp("data") / "materials"
    with few_steps():
        assert call("data", "nbrdf", neural_fits(3), "--split", "test", "--out", folder, "--samples", "256") == 0
    return folder


@pytest.fixture(scope="session")
def done(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the runs of all tables, by what ships; not to write to."""
    folder = tmp_path_factory.mktemp("done")
    words = ("--data", data, "--out", folder / "runs", "--quiet", "--json")
    with few_steps():
        assert call("evaluate", "brdf", "--which", "all", *words) == 0
    return folder


@pytest.fixture
def evaluate(metapp: Callable, data: Path, tmp_path: Path) -> Callable:
    """`metapp evaluate brdf` on the three materials, into a folder of this test."""
    return lambda *arguments: metapp("evaluate", "brdf", "--data", data, "--out", tmp_path / "runs", *arguments)


@pytest.fixture
def subject(data: Path, done: Path) -> EvaluationRun:
    """The same materials, with all that has been run of them."""
    return subject_of(data, done / "runs")
