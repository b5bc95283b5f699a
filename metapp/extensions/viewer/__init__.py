"""Interactive HTML pages of fits."""

from metapp.door import Command, FitMethod, Page

_HERE = "metapp.extensions.viewer"
OFFERS = (
    Command("view", f"{_HERE}.commands:view"),
    Command("try", f"{_HERE}.commands:try_all"),
    FitMethod("view", f"{_HERE}.viewing:view_fit"),
    *(Page(app, f"{_HERE}.pages.{app}:view") for app in ("brdf", "illumination", "transport")),
    *(Page(app, f"{_HERE}.pages.flat:{app}") for app in ("svbrdf_nonstationary", "svbrdf_stationary", "texture")),
)
