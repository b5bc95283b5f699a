"""Fixtures for tests that run commands: a working folder, inputs, and runs on them."""

from collections.abc import Callable
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def _work_in_test_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run commands in the test's folder, where they write runs by default; programs that they start find metapp."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY))


@pytest.fixture(scope="module")
def networks(request: pytest.FixtureRequest, write_nbrdf_networks: Callable[[int], Path]) -> Path:
    """A folder of as many random networks as the test module's NETWORKS says, not to write to."""
    return write_nbrdf_networks(request.module.NETWORKS)


@pytest.fixture
def fit_networks(metapp: Callable, networks: Path) -> Callable[..., Path]:
    """Return a function that fits the random networks, or other inputs, and returns the run's folder."""

    def fit_inputs(paradigm: str, *more: str | Path, inputs: Path = networks) -> Path:
        return Path(
            metapp(paradigm, "brdf", inputs, "--recipe", "quick", "--json", "--quiet", *more).json_result["out"]
        )

    return fit_inputs
