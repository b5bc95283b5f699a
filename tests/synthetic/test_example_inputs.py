"""The example inputs: small files, the same each time, that the formats of their application read."""

from __future__ import annotations

import pytest
import torch
from torch import Generator

from data_tools.formats import inputs_of
from data_tools.synthetic.cornell import random_scene, to_xml
from data_tools.synthetic.examples import EXAMPLES, write_example
from metapp.apps import app_names
from metapp.extensions.scene_files.reading import read_scene
from tests.needs_mitsuba import needs_mitsuba


@pytest.mark.parametrize("app", app_names())
def test_example_inputs_are_small_files_of_the_names_that_are_listed(app, tmp_path):
    files = write_example(app, tmp_path / "new")
    assert files == [tmp_path / "new" / name for name in EXAMPLES[app].files]
    assert sorted((tmp_path / "new").iterdir()) == sorted(files)
    assert all(file.stat().st_size < 500_000 for file in files)


@pytest.mark.parametrize("app", [app for app in app_names() if app != "transport"])
def test_example_inputs_are_read_by_formats_and_the_same_each_time(app, tmp_path):
    first, again = (
        [
            form.read(file, {})
            for file in write_example(app, tmp_path)
            for form in inputs_of(app)
            if form.recognises(file)
        ]
        for _ in range(2)
    )
    assert [task.name for task in first] == [file.partition(".")[0] for file in EXAMPLES[app].files]
    for one, other in zip(first, again, strict=True):
        assert all(torch.equal(one.data[key], other.data[key]) for key in one.data)


def test_no_example_inputs_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"smell: no example inputs, expected one of brdf, .*\.$"):
        write_example("smell", tmp_path)


def test_the_ball_of_the_example_is_found_to_be_a_mirror(tmp_path):
    _, ball = write_example("illumination", tmp_path)
    (form,) = [form for form in inputs_of("illumination") if form.recognises(ball)]
    data = form.read(ball, {}).data
    assert "seen" in data
    assert 0.2 < float((data["certain"] > 0).float().mean()) < 1


def test_the_scene_of_the_example_is_one_that_fits_take(tmp_path):
    (file,) = write_example("transport", tmp_path)
    assert read_scene(file)["xml"].startswith("<scene")


@needs_mitsuba
def test_a_scene_as_xml_is_the_same_as_its_dictionary():
    from metapp.rendering.paths.path_space import Tracer

    points, scene = torch.rand(4000, 4, generator=Generator().manual_seed(0)), random_scene(3)
    carried = [
        Tracer(each).contributions(points, Generator().manual_seed(0)) for each in (scene, {"xml": to_xml(scene)})
    ]
    assert carried[0].any()
    torch.testing.assert_close(*carried, rtol=1e-4, atol=1e-5)
