"""Interactive HTML pages of fits."""

from metapp.registry import Entry, Registry

_HERE = "metapp.extensions.viewer"


def register(registry: Registry) -> None:
    """Add the commands, the method of fits and the pages."""
    registry.commands["view"] = Entry(f"{_HERE}.commands:view")
    registry.commands["try"] = Entry(f"{_HERE}.commands:try_all")
    registry.methods["view"] = Entry(f"{_HERE}.viewing:view_fit")
    for app in ("brdf", "illumination", "transport"):
        registry.pages[app] = Entry(f"{_HERE}.pages.{app}:view")
    for app in ("svbrdf_nonstationary", "svbrdf_stationary", "texture"):
        registry.pages[app] = Entry(f"{_HERE}.pages.flat:{app}")
