"""What the extension registers: the method of fits, the pages of applications; and the core without them."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from metapp.extensions.viewer.view import view_of
from metapp.registry import WITHOUT, registry
from metapp.runs import api
from metapp.storage.records import file_name

pytestmark = pytest.mark.usefixtures("small_spheres")
NETWORKS = 1


def test_without_it_fits_work_and_its_command_and_method_are_refused(
    metapp: Callable, fitted: Callable, networks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = fitted("meta")
    monkeypatch.setenv(WITHOUT, "viewer")
    assert "a command of the extension viewer" in metapp("view", run).misuse
    assert fitted("meta") == run
    fit = api.fit("brdf", networks, recipe="quick")
    with pytest.raises(AttributeError, match=r"fit\.view: a method of the extension viewer"):
        fit.view()
    assert "view" not in dir(fit)
    assert fit._repr_html_()


def test_an_application_without_a_page_shows_its_pictures(networks: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fit = api.fit("brdf", networks, recipe="quick")
    assert view_of(fit.app, fit.parameters, fit.task).kind == "brdf"
    monkeypatch.delitem(registry().pages, "brdf")
    view = view_of(fit.app, fit.parameters, fit.task)
    assert (view.kind, set(view.pictures)) == ("pictures", {"reference", "fit"})


def test_a_fit_writes_its_page(networks: Path, tmp_path: Path) -> None:
    fit = api.fit("brdf", networks)
    assert "view" in dir(fit)
    page = fit.view()
    assert page == Path(f"{file_name(fit.name)}.html")
    assert "VIEWERS.brdf" in page.read_text(encoding="utf-8")
    assert fit.view(tmp_path / "a b.html").is_file()
    assert fit.view(os.fsencode(tmp_path) + b"/\xff.html").is_file()
