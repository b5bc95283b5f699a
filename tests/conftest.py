"""Fixtures for all tests: isolated caches, seeded draws, commands run in this process, small networks and recipes."""

import functools
import itertools
import json
import math
import os
import shutil
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from data_tools.readers.nbrdf_files import NBRDF_ARRAY_SHAPES
from metapp.appearance import features
from metapp.appearance.features import vgg_weights_path
from metapp.appearance.flash import camera_distance
from metapp.appearance.geometry import is_above_horizon
from metapp.extensions.native import compiler
from metapp.learning.recipe import Recipe
from metapp.rendering.second_scene.relighting import matrix_file
from tests.needs_mitsuba import skip_without_mitsuba
from tests.small_spheres import run_with_small_spheres, shrink_spheres

# small networks run many times slower where threads of several workers fight over them; Mitsuba takes its two by itself
os.environ.setdefault("OMP_NUM_THREADS", "1")  # commands that tests start inherit it
torch.set_num_threads(int(os.environ["OMP_NUM_THREADS"]))
os.environ[features.FLOAT32_VARIABLE] = "1"  # so that figures are the same on all machines
HAS_GPU = torch.cuda.is_available()


class CommandResult(NamedTuple):
    """The result of a command: exit code, standard output and standard error."""

    code: int
    out: str
    err: str

    @property
    def json_document(self) -> dict[str, Any]:
        """The JSON object in the last line of standard output, which --json prints."""
        result: dict[str, Any] = json.loads(self.out.splitlines()[-1])
        return result

    @property
    def json_result(self) -> dict[str, Any]:
        """The JSON object that a command with --json prints; fails the test unless the exit code is 0."""
        assert self.code == 0, self.err
        return self.json_document

    @property
    def error(self) -> str:
        """The single error line of a command that ended with code 1; it may have printed warnings before."""
        assert self.code == 1, self.err
        assert "Traceback" not in self.err
        (line,) = [line for line in self.err.splitlines() if line.startswith("error: ")]
        return line

    @property
    def misuse(self) -> str:
        """The single error line of a command that was called with wrong options: code 2 and no output."""
        assert (self.code, self.out) == (2, ""), self.err
        (line,) = [line for line in self.err.splitlines() if line.startswith("Error: ")]
        return line

    @property
    def refusal(self) -> str:
        """The single line that a command with code 1 printed, an error, and nothing else."""
        assert (self.code, self.out) == (1, "")
        (line,) = self.err.splitlines()
        assert line.startswith("error: ")
        return line


@pytest.fixture(autouse=True)
def _seed_generators() -> None:
    """Seed torch before each test, so that its draws do not depend on the tests before it.

    `torch.manual_seed` is not called: where there is no GPU, it stores three stack traces, which takes milliseconds.
    """
    torch.default_generator.manual_seed(0)
    if HAS_GPU:
        torch.cuda.manual_seed_all(0)


@pytest.fixture(scope="session", autouse=True)
def _shared_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Give fixtures that several tests share a cache of their own, without files that the user has fetched."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setenv("METAPP_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="session")
def _cache_folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return paths for the caches of tests, numbered. `mktemp` would list the folders of all tests before each time."""
    folder = tmp_path_factory.mktemp("caches")
    return (folder / str(i) for i in itertools.count())


@pytest.fixture(autouse=True)
def cache(_cache_folders: Iterator[Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give each test an empty cache folder, so that none touches the user's."""
    folder = next(_cache_folders)
    folder.mkdir()
    monkeypatch.setenv("METAPP_CACHE", str(folder))
    return folder


@pytest.fixture(scope="session", autouse=True)
def _shared_native_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Compile C sources once for the tests of all workers, into the folder that this fixture returns."""
    base = tmp_path_factory.getbasetemp()
    folder = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "cache_folder", lambda: folder)
        yield folder / "native"


@pytest.fixture
def compiled_in_cache(cache: Path, _shared_native_folder: Path) -> None:
    """Link the compiled C sources into the test's cache, for processes that the test starts.

    The files are linked, not the folder: metapp does not trust a folder that is a link.
    """
    _shared_native_folder.mkdir(mode=0o700, exist_ok=True)
    shutil.copytree(_shared_native_folder, cache / _shared_native_folder.name, copy_function=os.link)


USER_WEIGHTS, USER_MATRIX = vgg_weights_path(), matrix_file()  # before any test moves the cache


@pytest.fixture
def vgg_weights(cache: Path) -> Path:
    """Link the VGG weights that `make setup` fetched into the test's cache, whose folder is returned."""
    return link_into_cache(USER_WEIGHTS, cache, "the VGG weights are not there: metapp data vgg fetches them")


@pytest.fixture
def with_bfloat16(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Store random VGG weights up to relu2_1, and have metapp take this CPU for one that computes in bfloat16."""
    rng = torch.Generator().manual_seed(5)
    shapes = zip(range(3), (64, 64, 128), (3, 64, 64), strict=True)
    weights = {f"conv{i}.weight": torch.randn(out, of, 3, 3, generator=rng) / (9 * of) ** 0.5 for i, out, of in shapes}
    biases = {key.replace("weight", "bias"): torch.zeros(len(value)) for key, value in weights.items()}
    save_file(weights | biases, cache / "vgg16.safetensors")
    monkeypatch.setattr(features, "has_bfloat16", lambda: True)
    monkeypatch.delenv(features.FLOAT32_VARIABLE)


@pytest.fixture
def second_scene(cache: Path) -> Path:
    """Link the second scene's matrix that `make setup` built into the test's cache, whose folder is returned."""
    return link_scene_matrix(cache)


@pytest.fixture(scope="session")
def shared_second_scene(_shared_cache: Path) -> Path:
    """Link the second scene's matrix into the cache of fixtures that several tests share: it takes long to build."""
    return link_scene_matrix(_shared_cache)


def link_scene_matrix(cache: Path) -> Path:
    """Link the matrix of the second scene into a cache; skip the test where `make setup` has not built it."""
    return link_into_cache(USER_MATRIX, cache, "the second scene's matrix is not there: make setup builds it")


def link_into_cache(file: Path, cache: Path, reason: str) -> Path:
    """Link a file of the user's cache into another cache, whose folder is returned; skip the test if it is missing."""
    if not file.is_file():
        pytest.skip(reason)
    (cache / file.name).symlink_to(file)
    return cache


@functools.cache
def typer_command() -> Callable[..., Any]:
    """Return the commands as typer builds them at each call; built once here, since building takes 40 ms."""
    import typer

    from metapp.cli.command_tree import app

    return typer.main.get_command(app)


@pytest.fixture
def metapp(capsys: pytest.CaptureFixture[str]) -> Callable[..., CommandResult]:
    """Return a function that runs `metapp <arguments>` in this process, without the seconds that a new one takes.

    It prints no line about waiting, so that its output does not depend on how busy the machine is.
    """
    from metapp.cli.command_process import run_command
    from metapp.cli.progress import Terminal

    typer_command()  # built with all extensions, before a test leaves one out

    def run_metapp(*arguments: str | Path) -> CommandResult:
        words = [str(argument) for argument in arguments]
        with warnings.catch_warnings():
            terminal = Terminal(wait_seconds=3600.0)
            code = run_command(lambda: typer_command()(words, standalone_mode=False, prog_name="metapp"), terminal)
        captured = capsys.readouterr()
        return CommandResult(int(code), captured.out, captured.err)

    return run_metapp


@pytest.fixture
def rng() -> torch.Generator:
    return torch.Generator().manual_seed(3)


@pytest.fixture(scope="session")
def random_angles() -> Callable[..., Tensor]:
    """Return a function that draws up to `count` half and difference angles, float64 [N, 3] in rad.

    Every call draws the same angles. Unless `above` is false, directions below the horizon are left out.
    """

    def draw(count: int = 4000, *, above: bool = True) -> Tensor:
        rng = torch.Generator().manual_seed(3)
        high = torch.tensor([math.pi / 2, math.pi / 2, math.pi], dtype=torch.float64)
        angles = 1e-4 + torch.rand(count, 3, generator=rng, dtype=torch.float64) * (high - 2e-4)
        return angles[is_above_horizon(angles)] if above else angles

    return draw


@pytest.fixture(scope="module")
def mitsuba() -> Iterator[Any]:
    """Mitsuba in the variant scalar_rgb, which evaluates one direction at a time."""
    module = pytest.importorskip("mitsuba", reason="needs libatomic1", exc_type=ImportError)
    before = module.variant()
    module.set_variant("scalar_rgb")
    yield module
    if before:
        module.set_variant(before)


@pytest.fixture(scope="module")
def photograph(mitsuba: Any) -> Callable[..., Tensor]:
    """Return a function that renders the square [-1, 1]^2 with a BSDF under a point light by Mitsuba, [3, size, size].

    The camera is above the middle, at `camera_distance()`.
    """

    def render(bsdf: Callable[[Any], dict[str, Any]], light: Tensor, size: int, samples: int) -> Tensor:
        pose = mitsuba.ScalarTransform4f().look_at(origin=[0, 0, camera_distance()], target=[0, 0, 0], up=[0, 1, 0])
        film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
        sampler = {"type": "stratified", "sample_count": samples}
        scene = mitsuba.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "direct"},
                "sensor": {"type": "perspective", "fov": 45, "to_world": pose, "film": film, "sampler": sampler},
                "light": {
                    "type": "point",
                    "position": light.tolist(),
                    # stated as RGB: scalar_rgb takes a bare number for a spectrum of that height
                    "intensity": {"type": "rgb", "value": [math.pi * camera_distance() ** 2] * 3},
                },
                "patch": {"type": "rectangle", "bsdf": bsdf(mitsuba)},
            }
        )
        pixels = torch.tensor(mitsuba.render(scene, seed=0).array, dtype=torch.float64)
        return pixels.reshape(size, size, 3).movedim(-1, 0)

    return render


@pytest.fixture(scope="module")
def mitsuba_brdf(mitsuba: Any) -> Callable[[dict[str, Any], Tensor, Tensor], Tensor]:
    """Return a function that evaluates a Mitsuba plugin's BRDF, [N, 3] in 1/sr, for directions [N, 3].

    The plugin's values include the outgoing cosine, which is divided out.
    """

    def evaluate(bsdf: dict[str, Any], wi: Tensor, wo: Tensor) -> Tensor:
        plugin, context, values = mitsuba.load_dict(bsdf), mitsuba.BSDFContext(), []
        for incident, outgoing in zip(wi.tolist(), wo.tolist(), strict=True):
            interaction = mitsuba.SurfaceInteraction3f()
            interaction.wi = mitsuba.Vector3f(incident)
            values.append(list(plugin.eval(context, interaction, mitsuba.Vector3f(outgoing))))
        return torch.tensor(values, dtype=torch.float64) / wo[:, 2:]

    return evaluate


@pytest.fixture
def shorten_recipes(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that gives the recipes "quick" and "full" of several tables other networks and a few steps.

    Components that are given by name replace those of the applications. It also keeps torch from compiling, which takes
    longer than so few steps.
    """

    def shorten(tables: Sequence[dict[str, Recipe]], quick: Any, full: Any, **components: Any) -> None:
        for recipes in tables:
            for name, network in (("quick", quick), ("full", full)):
                app: Any = recipes[name].app
                app = replace(app, decoder=replace(app.decoder, network=network), **components)
                monkeypatch.setitem(recipes, name, replace(_shorten_recipe(recipes[name]), app=app))
        monkeypatch.setenv("TORCH_COMPILE_DISABLE", "1")

    return shorten


def _shorten_recipe(recipe: Recipe) -> Recipe:
    few_steps: dict[str, Any] = {"steps": 2, "tasks": 2, "warmup_steps": 0}
    return replace(
        recipe,
        steps=3,
        overfit_steps=30,
        finetune_steps=5,
        general=replace(recipe.general, **few_steps),
        meta={name: replace(training, **few_steps, searches_adam=False) for name, training in recipe.meta.items()},
    )


@pytest.fixture(scope="session")
def write_nbrdf_networks(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """Return a function that writes a folder of `count` random NBRDF networks, m0, m1, ..., alike at each call."""

    def write(count: int) -> Path:
        folder, rng = tmp_path_factory.mktemp("networks"), np.random.default_rng(0)
        for i in range(count):
            (folder / f"m{i}").mkdir()
            for part, shape in NBRDF_ARRAY_SHAPES.items():
                np.save(folder / f"m{i}" / f"{part}.npy", rng.normal(0, 0.3, shape).astype(np.float32))
        return folder

    return write


@pytest.fixture(scope="module")
def network(write_nbrdf_networks: Callable[[int], Path]) -> Path:
    """The folder of one random NBRDF network, not to write to."""
    return write_nbrdf_networks(1) / "m0"


@pytest.fixture
def fit(metapp: Callable) -> Callable:
    """Return a function that runs `metapp PARADIGM brdf ARGUMENTS... --quiet`."""
    return lambda paradigm, *arguments: metapp(paradigm, "brdf", *arguments, "--quiet")


@pytest.fixture(scope="session")
def ten_materials(write_nbrdf_networks: Callable[[int], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of ten small materials, eight of them for training. Tests copy it and do not write to it."""
    folder = tmp_path_factory.mktemp("data") / "materials"
    run_with_small_spheres("data", "nbrdf", write_nbrdf_networks(10), "--out", folder, "--samples", "512")
    return folder


@pytest.fixture
def few_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have commands trace 2**16 paths of a scene at a time instead of 2**19: these tests need few samples."""
    monkeypatch.setattr("metapp.rendering.paths.path_space.BATCH_PATHS", 2**16)


@pytest.fixture
def small_spheres(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have pictures of BRDFs drawn at 16 px instead of 96, for tests to which their content does not matter."""
    shrink_spheres(monkeypatch)


@pytest.fixture
def mi() -> Iterator[Any]:
    """Mitsuba with metapp's plugins, in the variant llvm_ad_rgb; the variant before is restored after the test."""
    skip_without_mitsuba()
    import mitsuba

    import metapp.mitsuba  # noqa: F401  (registers the plugins)

    before = mitsuba.variant()
    mitsuba.set_variant("llvm_ad_rgb")
    yield mitsuba
    if before:
        mitsuba.set_variant(before)
