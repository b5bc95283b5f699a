"""The core without the viewer: fits work, and what is missing names the extension."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from metapp import door
from metapp.extensions.viewer.view import view_of
from metapp.runs import api

pytestmark = pytest.mark.usefixtures("small_spheres")
NETWORKS = 1


def test_without_it_fits_work_and_its_command_and_method_are_refused(
    metapp: Callable, fitted: Callable, networks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = fitted("meta")
    monkeypatch.setenv(door.WITHOUT, "viewer")
    assert "a command of the extension viewer" in metapp("view", run).misuse
    assert fitted("meta") == run
    fit = api.fit("brdf", networks, recipe="quick")
    with pytest.raises(AttributeError, match=r"fit\.view: a method of the extension viewer"):
        fit.view()
    assert "view" not in dir(fit)
    assert fit._repr_html_()


def test_an_application_without_a_page_shows_its_pictures(networks: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fit = api.fit("brdf", networks, recipe="quick")
    assert view_of(fit.presentation, fit.parameters, fit.task).kind == "brdf"
    monkeypatch.setattr(door, "offers_of", lambda kind, app: ())
    view = view_of(fit.presentation, fit.parameters, fit.task)
    assert (view.kind, set(view.pictures)) == ("pictures", {"reference", "fit"})
