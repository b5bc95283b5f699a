"""Any bytes, and any change of a valid file, give a task or one line that names the file: for every reader.

`make test` tries a few of each, the same ones every time; `make fuzz` many more, new ones every time.
"""

import functools
import inspect
import math
import os
import shutil
import signal
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from data_tools.readers.merl import FILE_BYTES
from tests.fuzz import files
from tests.fuzz.mutations import damage_one_file
from tests.needs_mitsuba import REASON_TO_SKIP
from tests.recipe_apps import input_formats
from tests.small_spheres import shrink_spheres

EXAMPLES = int(os.environ.get("METAPP_FUZZ", "0"))  # of each reader; 0: a few, the same ones every time
SECONDS = 20.0  # of CPU time that an input may take


class Hang(BaseException):
    """A reader that takes too long."""


def finite(task: Any) -> None:
    """All values of a task are."""
    for key, value in task.data.items():
        assert bool(value.isfinite().all()), key


def read_input(app: str, folder: Path, file: Path, **options: str) -> None:
    """Read files as the INPUT of a fit with few samples or texels."""
    if file.suffix == ".binary" and file.stat().st_size > 64:  # a whole one takes 35 MB
        os.truncate(file, FILE_BYTES)
    place = folder if file.suffix == ".npy" else file
    for reader in (form.load() for form in input_formats(app).values()):
        read = reader.read_task
        few = {"samples": 64, "size": 32, **options}
        for source in reader.find(place)[0] if reader.recognises(place) else ():
            given = few | {"content": source.content}
            finite(read(source.path, **{key: given[key] for key in given & inspect.signature(read).parameters.keys()}))


def read_scene(folder: Path, file: Path) -> None:
    from metapp.extensions.scene_files.scene_reader import find, read_scene
    from metapp.extensions.scene_files.trial_loading import try_scene
    from metapp.rendering.scenes.loading import load_scene
    from metapp.rendering.variant import load_mitsuba

    path = next(source.path for source in find(folder)[0] if source.name == "box")
    scene = read_scene(path)
    try:
        try_scene(scene, load_mitsuba().variant())
        brightest = load_scene(scene).greatest_luminance
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None  # as read_task names it
    assert math.isfinite(brightest)
    assert brightest >= 0


def read_shard(folder: Path, file: Path) -> None:
    from metapp.apps.brdf.app import Brdf
    from metapp.learning.app import stack_tasks
    from metapp.runs.inputs.finding import find_in_data_set
    from metapp.runs.spec import Spec
    from metapp.storage.shards import fingerprint, list_data_set_problems

    fingerprint(folder)
    list_data_set_problems(folder)
    spec = Spec(app="brdf")
    tasks = [one.read_task(spec, Brdf()) for one in find_in_data_set(spec, folder)]
    for task in tasks:
        finite(task)
    stack_tasks(Brdf(), tasks)


@functools.cache
def small_tasks() -> Any:
    from data_tools.readers.brdf_task import make_brdf_task
    from metapp.apps.brdf.app import Brdf
    from metapp.learning.app import stack_tasks

    return stack_tasks(Brdf(), [make_brdf_task("small", lambda angles: angles * 0 + 0.1, samples=64)])


def read_checkpoint(folder: Path, file: Path) -> None:
    """Read files as --checkpoint, and take one step of a fit by the recipe of the file's name."""
    from metapp.paradigms.methods import fit_tasks
    from metapp.runs.fitting import Fitter
    from metapp.runs.resolve import complete
    from metapp.runs.spec import Spec

    spec = complete(Spec(app="brdf", recipe=file.stem, steps=1, checkpoint=file, device="cpu"))
    method = Fitter.of(spec).method
    try:
        theta = fit_tasks(method, small_tasks(), torch.Generator().manual_seed(0))
    except FloatingPointError:  # a fit that says that it diverged
        return
    assert all(bool(value.isfinite().all()) for value in theta.values())


def read_records(folder: Path, file: Path) -> None:
    """Read files as a table does, which shows all finished tasks."""
    from metapp.runs.fit_tables import summarise
    from metapp.runs.stored_fits import read_fits

    place = folder / "fits" / "a"  # of a run's folder
    place.mkdir(parents=True, exist_ok=True)
    shutil.copy(file, place)
    fits = read_fits(folder / "fits")
    for fit in fits:
        numbers = [number for number in (fit.seconds, fit.error) if number is not None]
        assert all(math.isfinite(number) for number in numbers)
    summarise(fits)


images = functools.partial(functools.partial, files.image_files)
of_materials = functools.partial(read_input, "brdf")
of_photos = functools.partial(read_input, "texture")
of_flash = functools.partial(read_input, "svbrdf_stationary")
of_maps = functools.partial(read_input, "svbrdf_nonstationary")
of_light = functools.partial(read_input, "illumination")
of_balls = functools.partial(read_input, "illumination", observe="photo")
READERS: dict[str, tuple[Callable[[], list[files.Files]], Callable[[Path, Path], None]]] = {
    "merl": (files.merl_tables, of_materials),
    "nbrdf": (files.nbrdf_networks, of_materials),
    "rgl": (files.rgl_tables, of_materials),
    "table": (files.goniometer_tables, of_materials),
    "png": (images(".png uint8", ".png uint16"), of_photos),
    "jpeg": (images(".jpg uint8"), of_photos),
    "tiff": (images(".tif uint8", ".tif float"), of_photos),
    "pfm": (images(".pfm float"), of_photos),
    "other images": (images(".bmp uint8", ".tga uint8", ".gif uint8", ".webp uint8", ".ppm uint8"), of_photos),
    "flash": (images(".png uint8", ".jpg uint8"), of_flash),
    "exr": (images(".exr half"), of_light),
    "hdr": (images(".hdr float"), of_light),
    "windows": (files.exr_windows, of_light),
    "layers": (files.exr_layers, of_light),
    "deep": (files.deep_exr, of_light),
    "radiance": (files.radiance_pictures, of_light),
    "profiles": (files.photos_with_stated_colours, of_photos),
    "balls": (files.ball_photos, of_balls),
    "strips": (files.component_strips, of_maps),
    "maps": (files.material_maps, of_maps),
    "scene": (files.scene_files, read_scene),
    "mesh": (files.scenes_with_data_files, read_scene),
    "shard": (files.data_sets, read_shard),
    "checkpoint": (files.checkpoints, read_checkpoint),
    "record": (files.records, read_records),
}
REFUSED = {"deep": "a deep image, expected one colour a pixel; flatten it."}  # whole, too
NEED_MITSUBA = pytest.mark.skipif(bool(REASON_TO_SKIP), reason=REASON_TO_SKIP)
NAMES = [pytest.param(name, marks=NEED_MITSUBA if name in ("scene", "mesh") else ()) for name in READERS]


def hang(*_: Any) -> None:
    raise Hang


def attempt(name: str, content: files.Files, file: str) -> str:
    """What a reader says of files: one line, or nothing for a good result."""
    place = Path(tempfile.mkdtemp())
    folder = place / "fuzzed"
    folder.mkdir()
    for file_name, written in content.items():
        (folder / file_name).write_bytes(written)
    before = signal.signal(signal.SIGPROF, hang)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        READERS[name][1](folder, folder / file)
    except ValueError as error:
        if isinstance(error, UnicodeError):
            raise
        return str(error).replace(str(place), "")
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
        shutil.rmtree(place)
    return ""


@pytest.fixture(autouse=True)
def _cheap(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Pictures of BRDFs cost nothing; what a file has warnings of is no matter."""
    shrink_spheres(monkeypatch)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@pytest.mark.parametrize("name", NAMES)
def test_valid_files_are_read(name: str) -> None:
    for whole in READERS[name][0]():
        output = attempt(name, whole, next(iter(whole)))
        assert output.endswith(REFUSED[name]) if name in REFUSED else output == ""


@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_give_a_task_or_one_line(name: str) -> None:
    whole = READERS[name][0]()

    @settings(
        max_examples=EXAMPLES or 25,
        derandomize=not EXAMPLES,
        database=None,
        deadline=None,
        print_blob=True,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.data())
    def check(data: Any) -> None:
        output = attempt(name, *data.draw(damage_one_file(whole)))
        assert len(output.splitlines()) <= 1, output
        assert not output or "fuzzed" in output, output

    check()
