"""Shader code of BRDFs: its values, run by compilers and GPUs that are installed, agree with the network."""

import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Generator

from metapp.appearance.geometry import directions_to_full_rusinkiewicz
from metapp.apps.brdf.nbrdf_network import NBRDF_NETWORK
from metapp.extensions.shaders import shader_files
from metapp.learning.task import Params, Task
from tests.extensions.shaders.shader_runners import RUNNERS, Array
from tests.recipe_apps import asset_of, recipes_of

NAME = "red paint-2"
APP = recipes_of("brdf")["quick"].app
LANGUAGES = sorted(RUNNERS)


@pytest.fixture(scope="module")
def theta() -> Params:
    """A random network, brighter where directions mirror each other."""
    theta = {key: value[0] for key, value in NBRDF_NETWORK.init(Generator().manual_seed(4), 1).items()}
    theta["w1"][:, 2] += 1
    theta["b3"] -= 1
    return theta


@pytest.fixture(scope="module")
def written(theta: Params, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("code")
    for language in ("cpp", "glsl", "hlsl", "materialx", "osl", "wgsl"):
        getattr(shader_files, f"write_{language}")(asset_of(APP, theta, Task(NAME, {})), folder / NAME, {})
    return folder


def code(folder: Path, language: str) -> str:
    return (folder / f"{NAME}.{shader_files.LANGUAGES[language].suffix}").read_text()


def hemisphere(count: int, seed: int) -> Array:
    """Directions above the surface, evenly, a few along the normal."""
    rng = np.random.default_rng(seed)
    z, phi = 1 - 0.99 * rng.random(count), 2 * np.pi * rng.random(count)
    z[:10] = 1
    sine = np.sqrt(1 - z * z)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), z], 1).astype(np.float32)


@pytest.mark.parametrize("language", LANGUAGES)
def test_shader_values_agree_with_the_network(language: str, theta: Params, written: Path, tmp_path: Path) -> None:
    light, viewer = hemisphere(10_000, 0), hemisphere(10_000, 1)
    found = RUNNERS[language](code(written, language), shader_files.function_prefix(NAME), light, viewer, tmp_path)[
        :, :3
    ]
    angles = directions_to_full_rusinkiewicz(torch.from_numpy(light).double(), torch.from_numpy(viewer).double())
    exact = NBRDF_NETWORK.evaluate({key: value.double() for key, value in theta.items()}, angles).numpy()
    np.testing.assert_allclose(found, exact, rtol=1e-4, atol=1e-4 * exact.mean())
    below = light * np.float32([1, 1, -1])
    nothing = RUNNERS[language](code(written, language), shader_files.function_prefix(NAME), below, viewer, tmp_path)
    assert not nothing[:, :4].any()


@pytest.mark.parametrize("angle", [0.0, 30.0, 69.0, 85.0])
def test_sampled_directions_follow_the_stated_density(angle: float, written: Path, tmp_path: Path) -> None:
    """The mean of any density over that of samples is 1, to a few standard errors."""
    theta, count = np.radians(angle), 400_000
    viewer = np.tile(np.float32([np.sin(theta), 0, np.cos(theta)]), (count, 1))
    numbers = np.random.default_rng(2).random((count, 3), dtype=np.float32)
    run, name = RUNNERS["cpp"], shader_files.function_prefix(NAME)
    light = np.ascontiguousarray(run(code(written, "cpp"), name, numbers, viewer, tmp_path)[:, 4:])
    assert (light[:, 2] > 0).all()
    np.testing.assert_allclose(np.linalg.norm(light, axis=1), 1, atol=1e-4)
    density = run(code(written, "cpp"), name, light, viewer, tmp_path)[:, 3].astype(float)
    cosine = light[:, 2].astype(float)
    mirrored = np.clip(light @ np.float32([-np.sin(theta), 0, np.cos(theta)]), 0, 1).astype(float)
    around = mirrored**60 + np.clip(mirrored - 2 * cosine * np.cos(theta), 0, 1) ** 60  # of both sides of the surface
    for other in (cosine / np.pi, np.full(count, 1 / (2 * np.pi)), around * 61 / (2 * np.pi)):
        ratio = other / density
        assert abs(ratio.mean() - 1) < 5 * ratio.std() / np.sqrt(count) + 1e-4


def test_glsl_compiles(written: Path, tmp_path: Path) -> None:
    """The reference compiler accepts the code."""
    compiler = shutil.which("glslangValidator")
    if compiler is None:
        pytest.skip("no glslangValidator")
    (tmp_path / "a.comp").write_text(f"#version 450\n{code(written, 'glsl')}\nvoid main() {{}}\n")
    subprocess.run([compiler, "-V", "-o", "a.spv", "a.comp"], cwd=tmp_path, check=True)


def test_materialx_node_is_valid(written: Path) -> None:
    """The files of its implementations have the functions that it names, and the document is valid."""
    document = written / NAME / f"{NAME}.mtlx"
    found = ET.parse(document).getroot().findall("implementation")
    assert [implementation.attrib["target"] for implementation in found] == ["genglsl", "genosl"]
    for implementation in found:
        assert (
            f"void {implementation.attrib['function']}("
            in (document.parent / implementation.attrib["file"]).read_text()
        )
    mx = pytest.importorskip("MaterialX")
    read = mx.createDocument()
    mx.readFromXmlFile(read, str(document))
    libraries = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), libraries)
    read.importLibrary(libraries)
    valid, output = read.validate()
    assert valid, output


def test_names_are_identifiers() -> None:
    assert shader_files.function_prefix("gold__paint.v2") == "brdf_gold_paint_v2"
    assert shader_files.function_prefix("漆") == "brdf"
