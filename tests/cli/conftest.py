"""What tests of commands share."""

from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands run in the test's folder, where they keep runs unless told otherwise; so do programs that they start."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))


@pytest.fixture(scope="module")
def networks(request: pytest.FixtureRequest, neural_fits: Callable[[int], Path]) -> Path:
    """As many random networks as a file of tests has for its NETWORKS, not to write to."""
    return neural_fits(request.module.NETWORKS)


@pytest.fixture
def fitted(metapp: Callable, networks: Path) -> Callable[..., Path]:
    """Fits them, or other inputs, and returns the run's folder."""

    def fit(paradigm: str, *more: str | Path, inputs: Path = networks) -> Path:
        return Path(metapp(paradigm, "brdf", inputs, "--recipe", "quick", "--json", "--quiet", *more).done["out"])

    return fit
