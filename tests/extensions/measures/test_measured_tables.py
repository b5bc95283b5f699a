"""The table of pictures of each application, with the extension, without it, and without what it needs."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from torch import Generator

from metapp.appearance.picture_measures import measure_pictures
from metapp.appearance.pictures import TimedFit
from metapp.evaluation.table import format_tables
from metapp.evaluation.tables.image import make_image_table
from metapp.learning.app import App, stack_tasks
from metapp.learning.task import Task
from metapp.paradigms import PARADIGMS
from metapp.registry import WITHOUT_VARIABLE
from tests.extensions.measures.test_measures import needs_weights
from tests.kept_fits import fit_of
from tests.paradigms.small import NETWORK_KINDS
from tests.recipe_apps import presenter_of

# small tasks of transport have no scene: tests/cli/test_cli_transport.py measures its pictures
pytestmark = [
    pytest.mark.usefixtures("small_spheres"),
    pytest.mark.parametrize("app", [kind for kind in NETWORK_KINDS if kind != "transport"], indirect=True),
]

FLAT = {"LPIPS", "DISTS"}
OWN = {name: {"SSIM"} for name in ("brdf", "illumination", "svbrdf_nonstationary")}
FURTHER = {
    "brdf": {"CIE 2000, median", "CIE 2000, 95 %", "PSNR"},
    "illumination": {"PSNR", "LPIPS"},
    "svbrdf_nonstationary": {"PSNR", *FLAT},
    "svbrdf_stationary": FLAT,
    "texture": {"sliced Wasserstein", *FLAT},
    "transport": {"PSNR", "LPIPS"},
}


def printed(app: App, sources: list[Task]) -> tuple[set[str], str]:
    """The measures in the rows of a random fit, and the table with its notes."""
    task = sources[0]
    batch = app.init(Generator().manual_seed(1), 1) | app.task_parameters(stack_tasks(app, [task]))
    theta = {key: value[0] for key, value in batch.items()}
    measures = measure_pictures(presenter_of(app), {"meta": TimedFit(theta, 0.1)}, task)
    records = [fit_of(name=task.name, error=None, figures={"measures": measures})]
    subject: Any = SimpleNamespace(
        app=app,
        presenter=presenter_of(app),
        title=presenter_of(app).title,
        tasks=[task],
        groups={task.name: task.name},
        specs={},
        fitters={},
        is_of_subset=lambda name: False,
        has_paper_figures=True,
    )
    table = make_image_table(subject, records)
    others = PARADIGMS.keys() - {"meta"}
    assert all(row["error"] is not None for row in table.rows if row["measure"] and row["paradigm"] not in others)
    return {row["measure"] for row in table.rows} - {None}, format_tables([table], "markdown")


@needs_weights
def test_each_table_has_its_measures_and_names_missing_ones(
    app: App, sources: list[Task], monkeypatch: pytest.MonkeyPatch, cache: Path, random_vgg_file: Path
) -> None:
    further = FURTHER[app.name]
    measures, text = printed(app, sources)
    assert measures >= further - FLAT
    assert not measures & FLAT
    for name in further & FLAT:
        assert f"\n- {name}: the weights of VGG-16 are missing: metapp data vgg" in text
    (cache / "vgg16.safetensors").symlink_to(random_vgg_file)
    measures, text = printed(app, sources)
    assert measures >= further | OWN.get(app.name, set())
    for name in further:
        assert f"| {name} |" in text
        assert f"\n- {name}: " in text


@pytest.mark.usefixtures("random_vgg_in_cache")
def test_tables_have_all_other_columns_without_the_extension(
    app: App, sources: list[Task], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(WITHOUT_VARIABLE, "measures")
    measures, text = printed(app, sources)
    assert measures >= OWN.get(app.name, set())
    assert not measures & set().union(*FURTHER.values())
    assert presenter_of(app).picture_measure in text
