"""Interactive HTML pages of fits, and pages that follow fits while they run."""

from metapp.door import Command, FitMethod, Option, Page, Watcher

_HERE = "metapp.extensions.viewer"
_WATCH = Option("watch", False, "Show the fit while it runs, on a page for a browser of this machine.", panel="Output")
_APPS = ("brdf", "illumination", "svbrdf_nonstationary", "svbrdf_stationary", "texture", "transport")
OFFERS = (
    Command("view", f"{_HERE}.commands:view"),
    Command("try", f"{_HERE}.commands:try_all"),
    FitMethod("view", f"{_HERE}.viewing:view_fit"),
    Watcher(_WATCH, f"{_HERE}.watching:Watched"),
    *(Page(app, f"{_HERE}.pages.{app}:view") for app in _APPS),
)
