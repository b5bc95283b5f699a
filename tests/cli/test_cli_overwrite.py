"""What is there stays, unless --overwrite is given: files and data sets that a user names."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import Result
from tests.small_spheres import run_small

pytestmark = pytest.mark.usefixtures("small_spheres")


@pytest.fixture(scope="module")
def runs(neural_fits: Callable[[int], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run, and the network that it is a fit of."""
    folder = tmp_path_factory.mktemp("overwrite")
    network = shutil.copytree(neural_fits(1) / "m0", folder / "m0")
    run_small("meta", "brdf", network, "--rule", "meta-curvature", "--steps", "1", "--out", folder / "runs", "--quiet")
    (run,) = (folder / "runs" / "brdf").iterdir()
    run.rename(folder / "run")
    return folder


FILES = {
    "view": "view {run} --no-open --quiet --out",
    "compare": "compare {run} {run} --quiet --out",
    "plan": "plan brdf --samples 2 --quiet --out",
    "markers": "data markers",
    "report": "evaluate brdf --no-run --quiet --report",
}


@pytest.mark.parametrize("command", FILES.values(), ids=FILES)
def test_a_file_is_replaced_by_overwrite_alone(metapp: Callable[..., Result], runs: Path, command: str) -> None:
    if "markers" in command:
        pytest.importorskip("cv2")
    file = out = Path("out.pdf")
    if "report" in command:
        out, file = Path("."), Path("index.md")
    file.write_text("mine")
    words = command.format(run=runs / "run").split()
    refused = metapp(*words, out)
    assert f"{file}: is there already, expected a new file; add --overwrite to replace it" in refused.misuse
    assert file.read_text() == "mine"
    assert metapp(*words, out, "--overwrite").code == 0
    assert file.read_bytes() != b"mine"


SETS = {
    "nbrdf": "data nbrdf {network} --samples 512 --split test",
    "synth": "data synth texture --count 2 --size 64",
    "join": "data join {set}",
}


@pytest.mark.parametrize("command", SETS.values(), ids=SETS)
def test_a_data_set_is_replaced_by_overwrite_alone(metapp: Callable[..., Result], runs: Path, command: str) -> None:
    if "{set}" in command:
        run_small("data", "nbrdf", runs / "m0", "--out", "other", "--samples", "512", "--split", "test")
    words = [*command.format(network=runs / "m0", set="other").split(), "--quiet", "--out", "set"]
    assert metapp(*words).code == 0
    Path("set/manifest.json").write_text(Path("set/manifest.json").read_text() + " ")
    before = {path.name: path.read_bytes() for path in Path("set").iterdir()}
    refused = metapp(*words)
    assert "set: holds a data set of " in refused.error
    assert "expected a new folder; add --overwrite to replace it" in refused.error
    assert {path.name: path.read_bytes() for path in Path("set").iterdir()} == before
    assert metapp(*words, "--overwrite").code == 0
    assert not Path("set/manifest.json").read_text().endswith(" ")


@pytest.mark.parametrize(
    ("paths", "split", "expected"),
    [
        ("sets", "auto", ("one", "two")),
        ("sets", "test", ("", "one two")),
        ("sets/train sets/test", "auto", ("one", "two")),
        ("sets/train/../test/two sets/train/one", "auto", ("one", "two")),
        ("sets/test", "auto", ("", "two")),
        ("sets/train/one", "auto", ("one", "")),
    ],
)
def test_folders_train_and_test_stay_apart(
    metapp: Callable[..., Result], runs: Path, paths: str, split: str, expected: tuple[str, str]
) -> None:
    """Held-out materials must not be trained on, whatever `auto` would make of their names."""
    for folder, name in (("train", "one"), ("test", "two")):
        shutil.copytree(runs / "m0", Path("sets") / folder / name)
    done = metapp("data", "nbrdf", *paths.split(), "--samples", 512, "--split", split, "--out", "set", "--json")
    assert tuple(" ".join(sorted(done.document[part])) for part in ("train", "test")) == expected
    assert ("train/ and test/ keep their tasks apart" in done.err) == (split == "auto")
