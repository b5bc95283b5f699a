"""Fixtures for tests of `metapp evaluate`: three small materials, and the runs of all their tables."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from metapp.evaluation.evaluation_run import EvaluationRun
from tests.evaluation.cli.evaluation_runs import evaluation_run_of, few_steps, run_metapp


@pytest.fixture(autouse=True)
def _few_steps() -> Iterator[None]:
    """Shorten fits in every test, as `evaluated_folder` does, so that its runs count for the same settings."""
    with few_steps():
        yield


@pytest.fixture(scope="session")
def data(write_nbrdf_networks: Callable[[int], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three small materials, all of them test tasks."""
    folder = tmp_path_factory.mktemp("data") / "materials"
    with few_steps():
        assert (
            run_metapp("data", "nbrdf", write_nbrdf_networks(3), "--split", "test", "--out", folder, "--samples", "256")
            == 0
        )
    return folder


@pytest.fixture(scope="session")
def evaluated_folder(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the runs of all tables, by checkpoints that ship; not to write to."""
    folder = tmp_path_factory.mktemp("done")
    words = ("--data", data, "--out", folder / "runs", "--quiet", "--json")
    with few_steps():
        assert run_metapp("evaluate", "brdf", "--which", "all", *words) == 0
    return folder


@pytest.fixture
def evaluate(metapp: Callable, data: Path, tmp_path: Path) -> Callable:
    """Return a function that runs `metapp evaluate brdf` on the three materials, into the test's folder."""
    return lambda *arguments: metapp("evaluate", "brdf", "--data", data, "--out", tmp_path / "runs", *arguments)


@pytest.fixture
def evaluation_run(data: Path, evaluated_folder: Path) -> EvaluationRun:
    """The evaluation of the three materials, with the runs of all tables."""
    return evaluation_run_of(data, evaluated_folder / "runs")
