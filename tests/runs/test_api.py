"""The Python API gives what the command line gives."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import metapp as api
from metapp.apps.brdf.few import Few
from metapp.rendering.variant import load_mitsuba
from metapp.storage.tensors import read_tensors


@pytest.fixture
def network(neural_fits: Callable[[int], Path]) -> Path:
    """A folder with one small network."""
    return next(iter(sorted(neural_fits(1).iterdir())))


def test_a_fit_is_that_of_the_command(metapp: Callable, network: Path, tmp_path: Path) -> None:
    told = metapp("meta", "brdf", network, "--out", tmp_path, "--json", "--quiet").document
    fit = api.fit("brdf", network)
    assert (fit.name, fit.error) == (told["tasks"][0]["name"], told["error"])
    kept = read_tensors(next((Path(told["out"]) / "params").iterdir()))
    assert kept.keys() == fit.parameters.keys()
    assert all(torch.equal(kept[key], value) for key, value in fit.parameters.items())
    assert fit.seconds > 0
    assert fit.errors["error"] == fit.error
    assert set(fit.pictures()) == {"reference", "fit"}


def test_a_fit_is_saved_and_exported(network: Path, tmp_path: Path) -> None:
    fit = api.fit("brdf", network, paradigm="general")
    saved = read_tensors(fit.save(tmp_path / "below" / "a.safetensors"))
    assert all(torch.equal(saved[key], value) for key, value in fit.parameters.items())
    fit.export("nbrdf", tmp_path / "again")
    again = api.fit("brdf", tmp_path / "again", paradigm="general")
    assert again.name == "again"
    for name in ("gold.bsdf", "gold.1"):  # the suffix may be given; what follows another dot is none
        fit.export("bsdf", tmp_path / "files" / name)
    assert {path.name for path in (tmp_path / "files").iterdir()} == {"gold.bsdf", "gold.1.bsdf"}
    with pytest.raises(ValueError, match=r"--export 'blend': brdf expects one of bsdf, merl, mitsuba, nbrdf"):
        fit.export("blend", tmp_path / "x")


def test_options_are_those_of_the_command(network: Path) -> None:
    one, two = (api.fit("brdf", network, steps=steps, rule="meta-adam") for steps in (1, 2))
    assert one.error != two.error
    with pytest.raises(ValueError, match="'brdfs' is not an application; expected one of brdf"):
        api.fit("brdfs", network)
    with pytest.raises(ValueError, match="paradigm 'magic': expected one of general"):
        api.fit("brdf", network, paradigm="magic")
    with pytest.raises(ValueError, match="--rule: rule 'magic': 'magic' is unknown"):
        api.fit("brdf", network, rule="magic")


@pytest.mark.filterwarnings("ignore:.* times the light that comes in")  # random networks
def test_several_tasks(neural_fits: Callable[[int], Path]) -> None:
    folder = neural_fits(2)
    assert len(api.fit_all("brdf", [folder])) == 2
    with pytest.raises(ValueError, match=r"2 tasks, expected one; take metapp\.fit_all"):
        api.fit("brdf", folder)
    with pytest.raises(ValueError, match="no such file or folder"):
        api.fit("brdf", folder / "none")


def test_nothing_is_printed_and_threads_stay(network: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = torch.get_num_threads()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        api.fit("brdf", network)
    assert capfd.readouterr() == ("", "")
    assert torch.get_num_threads() == before


def test_the_package_imports_at_once() -> None:
    lines = "import sys, metapp\nprint({'torch', 'numpy', 'typer', 'rich'} & sys.modules.keys(), metapp.__version__)"
    done = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("set()")
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = api.nothing


def lambertian(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    return np.full((len(wi), 3), (0.2, 0.4, 0.6)) / np.pi


def directions(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    wi, wo = rng.normal(size=(2, count, 3))
    return tuple(np.abs(each) / np.linalg.norm(each, axis=1, keepdims=True) for each in (wi, wo))


def test_a_function_is_fitted() -> None:
    fit = api.fit("brdf", lambertian)
    assert fit.name == "lambertian"
    assert fit.error < 0.5
    angles = torch.tensor([[0.3, 0.4, 1.0]])
    torch.testing.assert_close(
        fit.app.reflectance(fit.parameters, angles)[0], torch.tensor([0.2, 0.4, 0.6]) / np.pi, rtol=0.1, atol=0.01
    )
    gray = api.fit("brdf", lambda wi, wo: torch.full((len(wi),), 0.1), paradigm="general")
    assert torch.equal(gray.task.data["reflectance"][:, 0], gray.task.data["reflectance"][:, 2])


def test_arrays_of_samples_are_fitted() -> None:
    wi, wo = directions(600)
    fit = api.fit("brdf", (wi, wo, lambertian(wi, wo)))
    assert fit.error < 1
    assert len(fit.task.data["angles"]) == 600
    few = api.fit("brdf", (wi[:20], wo[:20], lambertian(wi[:20], wo[:20])))
    assert few.app.setup == Few()  # by the model for few samples, which sees all of them
    angles = fit.task.data["angles"]
    known = torch.tensor([0.2, 0.4, 0.6]) / np.pi
    assert float((few.app.reflectance(few.parameters, angles) - known).abs().median()) < 0.01


def test_a_bsdf_of_mitsuba_is_fitted() -> None:
    mi = load_mitsuba()
    bsdf = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}})
    fit = api.fit("brdf", bsdf, paradigm="general")
    known = torch.tensor([0.2, 0.4, 0.6]) / np.pi
    torch.testing.assert_close(fit.task.data["reflectance"], known.expand(len(fit.task.data["angles"]), 3))


@pytest.mark.parametrize(
    ("source", "line"),
    [
        (3, "object: int, expected a path, a function"),
        ((1, 2), "2 arrays, expected 3"),
        ((np.zeros((9, 3)), np.ones((9, 3)), np.ones((9, 3))), "wi of length 0, expected unit vectors"),
        ((*directions(3), np.ones((3, 3))), "3 pairs of directions, expected 4"),
        ((*directions(80), -np.ones((80, 3))), "reflectance that is negative"),
        (lambda wi, wo: wi[:, :2], r"values \(\d+, 2\), expected"),
        (lambda wi, wo: -np.abs(wi), "reflectance of -1 /sr, expected 0 or more"),
    ],
)
def test_what_is_no_brdf_in_memory_is_refused_in_a_line(source: object, line: str) -> None:
    with pytest.raises(ValueError, match=line):
        api.fit("brdf", source)


def test_other_applications_read_paths() -> None:
    with pytest.raises(ValueError, match="function: no path, expected one; texture reads files"):
        api.fit("texture", lambertian)
    with pytest.raises(ValueError, match="1 of 2 sources are no paths"):
        api.fit_all("brdf", ["a", lambertian])


def test_names_of_the_api_are_listed() -> None:
    assert {"fit", "fit_all", "Fit"} <= set(dir(api))
