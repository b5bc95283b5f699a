"""What several test files share."""

import functools
import itertools
import json
import math
import os
import shutil
import warnings
from collections.abc import Callable, Iterator
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
from tests.small_spheres import run_small, shrink_spheres

# small networks run many times slower where threads of several workers fight over them; Mitsuba takes its two by itself
os.environ.setdefault("OMP_NUM_THREADS", "1")  # of the commands that tests start
torch.set_num_threads(int(os.environ["OMP_NUM_THREADS"]))
os.environ[features.FLOAT32_VARIABLE] = "1"  # figures are the same on all machines
HAS_GPU = torch.cuda.is_available()


class Result(NamedTuple):
    """What a command left: exit code, standard output, standard error."""

    code: int
    out: str
    err: str

    @property
    def document(self) -> dict[str, Any]:
        """The object that --json prints last."""
        result: dict[str, Any] = json.loads(self.out.splitlines()[-1])
        return result

    @property
    def done(self) -> dict[str, Any]:
        """The same, of a command that did all that it was to do."""
        assert self.code == 0, self.err
        return self.document

    @property
    def error(self) -> str:
        """The one line of a command that could not use its data, after what else it said."""
        assert self.code == 1, self.err
        assert "Traceback" not in self.err
        (line,) = [line for line in self.err.splitlines() if line.startswith("error: ")]
        return line

    @property
    def misuse(self) -> str:
        """The one line of a command that could not use its options."""
        assert (self.code, self.out) == (2, ""), self.err
        (line,) = [line for line in self.err.splitlines() if line.startswith("Error: ")]
        return line

    @property
    def refusal(self) -> str:
        """The one line of a command that could not use its data."""
        assert (self.code, self.out) == (1, "")
        (line,) = self.err.splitlines()
        assert line.startswith("error: ")
        return line


@pytest.fixture(autouse=True)
def _seed() -> None:
    """The same draws in every run, whatever ran before.

    Where there is no GPU, `torch.manual_seed` keeps three stacks for later: milliseconds for each of many tests.
    """
    torch.default_generator.manual_seed(0)
    if HAS_GPU:
        torch.cuda.manual_seed_all(0)


@pytest.fixture(scope="session", autouse=True)
def _shared_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """What fixtures that several tests share have for a cache: none depends on what the user has fetched."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setenv("METAPP_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="session")
def _caches(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Names for the caches of tests: `mktemp` would look at those of all tests before."""
    folder = tmp_path_factory.mktemp("caches")
    return (folder / str(i) for i in itertools.count())


@pytest.fixture(autouse=True)
def cache(_caches: Iterator[Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """No test touches the user's cache; each has an empty one of its own."""
    folder = next(_caches)
    folder.mkdir()
    monkeypatch.setenv("METAPP_CACHE", str(folder))
    return folder


@pytest.fixture(scope="session", autouse=True)
def _compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """C sources are compiled once for the tests of all workers; the folder that holds the compiled ones."""
    base = tmp_path_factory.getbasetemp()
    folder = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "cache_folder", lambda: folder)
        yield folder / "native"


@pytest.fixture
def compiled(cache: Path, _compiled_once: Path) -> None:
    """The same for processes that a test starts; as links of files, since a linked folder may be somebody else's."""
    _compiled_once.mkdir(mode=0o700, exist_ok=True)
    shutil.copytree(_compiled_once, cache / _compiled_once.name, copy_function=os.link)


USER_WEIGHTS, USER_MATRIX = vgg_weights_path(), matrix_file()  # before any test moves the cache


@pytest.fixture
def vgg(cache: Path) -> Path:
    """The VGG weights that `make setup` fetched, in the test's cache."""
    return lend(USER_WEIGHTS, cache, "the VGG weights are not there: metapp data vgg fetches them")


@pytest.fixture
def with_bfloat16(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """VGG with made-up weights, and a CPU that is said to be made for bfloat16."""
    rng = torch.Generator().manual_seed(5)
    shapes = zip(range(3), (64, 64, 128), (3, 64, 64), strict=True)  # up to relu2_1
    weights = {f"conv{i}.weight": torch.randn(out, of, 3, 3, generator=rng) / (9 * of) ** 0.5 for i, out, of in shapes}
    biases = {key.replace("weight", "bias"): torch.zeros(len(value)) for key, value in weights.items()}
    save_file(weights | biases, cache / "vgg16.safetensors")
    monkeypatch.setattr(features, "has_bfloat16", lambda: True)
    monkeypatch.delenv(features.FLOAT32_VARIABLE)


@pytest.fixture
def scene(cache: Path) -> Path:
    """The matrix of the second scene that `make setup` built, in the test's cache."""
    return lend_scene(cache)


@pytest.fixture(scope="session")
def shared_scene(_shared_cache: Path) -> Path:
    """The same for fixtures that several tests share: building the matrix takes a minute."""
    return lend_scene(_shared_cache)


def lend_scene(cache: Path) -> Path:
    return lend(USER_MATRIX, cache, "the second scene's matrix is not there: make setup builds it")


def lend(file: Path, cache: Path, reason: str) -> Path:
    """The cache with a file of the user's; skips the test where there is none."""
    if not file.is_file():
        pytest.skip(reason)
    (cache / file.name).symlink_to(file)
    return cache


@functools.cache
def made_command() -> Callable[..., Any]:
    """What typer makes of the commands whenever they are called, which takes 40 ms, made once."""
    import typer

    from metapp.cli.command_tree import app

    return typer.main.get_command(app)


@pytest.fixture
def metapp(capsys: pytest.CaptureFixture[str]) -> Callable[..., Result]:
    """Runs `metapp <arguments>` as the command does, without the seconds that a new process takes.

    No line tells of a wait: what a test reads does not depend on how busy the machine is.
    """
    from metapp.cli.console import Terminal, run_command

    made_command()  # of all extensions, before a test leaves one out

    def call(*arguments: str | Path) -> Result:
        words = [str(each) for each in arguments]
        with warnings.catch_warnings():
            terminal = Terminal(wait_seconds=3600.0)
            code = run_command(lambda: made_command()(words, standalone_mode=False, prog_name="metapp"), terminal)
        captured = capsys.readouterr()
        return Result(int(code), captured.out, captured.err)

    return call


@pytest.fixture
def rng() -> torch.Generator:
    return torch.Generator().manual_seed(3)


@pytest.fixture(scope="session")
def random_angles() -> Callable[..., Tensor]:
    """Draws up to `count` half and difference angles, float64 [N, 3] rad, the same each time; all above the horizon."""

    def draw(count: int = 4000, *, above: bool = True) -> Tensor:
        rng = torch.Generator().manual_seed(3)
        high = torch.tensor([math.pi / 2, math.pi / 2, math.pi], dtype=torch.float64)
        angles = 1e-4 + torch.rand(count, 3, generator=rng, dtype=torch.float64) * (high - 2e-4)
        return angles[is_above_horizon(angles)] if above else angles

    return draw


@pytest.fixture(scope="module")
def mitsuba() -> Iterator[Any]:
    """Mitsuba, in the variant that evaluates one thing at a time."""
    module = pytest.importorskip("mitsuba", reason="needs libatomic1", exc_type=ImportError)
    before = module.variant()
    module.set_variant("scalar_rgb")
    yield module
    if before:
        module.set_variant(before)


@pytest.fixture(scope="module")
def photograph(mitsuba: Any) -> Callable[..., Tensor]:
    """Photo [3, size, size] by Mitsuba of the square [-1, 1]^2 with a BSDF, under a point light, from `camera()`."""

    def photo(bsdf: Callable[[Any], dict[str, Any]], light: Tensor, size: int, samples: int) -> Tensor:
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
                    # scalar_rgb would take a bare number for a spectrum of that height as well; RGB is explicit.
                    "intensity": {"type": "rgb", "value": [math.pi * camera_distance() ** 2] * 3},
                },
                "patch": {"type": "rectangle", "bsdf": bsdf(mitsuba)},
            }
        )
        pixels = torch.tensor(mitsuba.render(scene, seed=0).array, dtype=torch.float64)
        return pixels.reshape(size, size, 3).movedim(-1, 0)

    return photo


@pytest.fixture(scope="module")
def mitsuba_brdf(mitsuba: Any) -> Callable[[dict[str, Any], Tensor, Tensor], Tensor]:
    """BRDF [N, 3] of a Mitsuba plugin for directions [N, 3]; the plugin's own values include the outgoing cosine."""

    def evaluate(bsdf: dict[str, Any], wi: Tensor, wo: Tensor) -> Tensor:
        plugin, context, values = mitsuba.load_dict(bsdf), mitsuba.BSDFContext(), []
        for incident, outgoing in zip(wi.tolist(), wo.tolist(), strict=True):
            interaction = mitsuba.SurfaceInteraction3f()
            interaction.wi = mitsuba.Vector3f(incident)
            values.append(list(plugin.eval(context, interaction, mitsuba.Vector3f(outgoing))))
        return torch.tensor(values, dtype=torch.float64) / wo[:, 2:]

    return evaluate


@pytest.fixture
def short_by_protocol(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Gives the recipes "quick" and "full" of all protocols other networks and a few steps; without a compiler."""

    def shorten(recipes: dict[str, dict[str, Recipe]], quick: Any, full: Any, **fields: Any) -> None:
        for of_protocol in recipes.values():
            for name, network in (("quick", quick), ("full", full)):
                app = type(of_protocol[name].app)(network, **fields)
                monkeypatch.setitem(of_protocol, name, replace(_short(of_protocol[name]), app=app))
        monkeypatch.setenv("TORCH_COMPILE_DISABLE", "1")

    return shorten


def _short(recipe: Recipe) -> Recipe:
    few: dict[str, Any] = {"steps": 2, "tasks": 2, "warmup": 0}
    return replace(
        recipe,
        steps=3,
        overfit_steps=30,
        finetune_steps=5,
        general=replace(recipe.general, **few),
        meta={name: replace(training, **few, tuned=False) for name, training in recipe.meta.items()},
    )


@pytest.fixture(scope="session")
def neural_fits(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """Makes a folder of so many random NBRDF networks, m0, m1, ..., the same each time."""

    def write(count: int) -> Path:
        folder, rng = tmp_path_factory.mktemp("networks"), np.random.default_rng(0)
        for i in range(count):
            (folder / f"m{i}").mkdir()
            for part, shape in NBRDF_ARRAY_SHAPES.items():
                np.save(folder / f"m{i}" / f"{part}.npy", rng.normal(0, 0.3, shape).astype(np.float32))
        return folder

    return write


@pytest.fixture(scope="module")
def network(neural_fits: Callable[[int], Path]) -> Path:
    """One such network."""
    return neural_fits(1) / "m0"


@pytest.fixture
def fit(metapp: Callable) -> Callable:
    """`metapp PARADIGM brdf ARGUMENTS... --quiet`."""
    return lambda paradigm, *arguments: metapp(paradigm, "brdf", *arguments, "--quiet")


@pytest.fixture(scope="session")
def ten_materials(neural_fits: Callable[[int], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of ten small materials, eight of them for training; for tests to copy, not to write to."""
    folder = tmp_path_factory.mktemp("data") / "materials"
    run_small("data", "nbrdf", neural_fits(10), "--out", folder, "--samples", "512")
    return folder


@pytest.fixture
def few_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands trace 2**16 paths of a scene at a time instead of 2**19, where samples are few."""
    monkeypatch.setattr("metapp.rendering.paths.path_space.BATCH_PATHS", 2**16)


@pytest.fixture
def small_spheres(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures of BRDFs of 16 px instead of 96, where what they show does not matter."""
    shrink_spheres(monkeypatch)


@pytest.fixture
def mi() -> Iterator[Any]:
    """Mitsuba with the plugins, in the variant llvm_ad_rgb; as it was afterwards."""
    skip_without_mitsuba()
    import mitsuba

    import metapp.mitsuba  # noqa: F401  (registers the plugins)

    before = mitsuba.variant()
    mitsuba.set_variant("llvm_ad_rgb")
    yield mitsuba
    if before:
        mitsuba.set_variant(before)
