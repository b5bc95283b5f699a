"""Interactive HTML pages of fits."""

from metapp.door import Command, FitMethod, Page

_HERE = "metapp.extensions.viewer"
_APPS = ("brdf", "illumination", "svbrdf_nonstationary", "svbrdf_stationary", "texture", "transport")
OFFERS = (
    Command("view", f"{_HERE}.commands:view"),
    Command("try", f"{_HERE}.commands:try_all"),
    FitMethod("view", f"{_HERE}.viewing:view_fit"),
    *(Page(app, f"{_HERE}.pages.{app}:view") for app in _APPS),
)
