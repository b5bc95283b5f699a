"""Light and materials captured by hand: a mirror ball at several exposures, flat materials in a sheet of markers."""

from metapp.registry import Entry, Format, Registry

_HERE = "metapp.extensions.capture"


def register(registry: Registry) -> None:
    """Add photos of balls as inputs, and the commands of captures."""
    registry.formats["ball"] = Format(
        f"{_HERE}.ball.reading",
        app="illumination",
        inputs="LDR photos of a ball",
        takes=("rows", "fov_rad"),
    )
    registry.merges["illumination", "shutter"] = Entry(f"{_HERE}.ball.capture:merge")
    registry.commands["data markers"] = Entry(f"{_HERE}.markers.command:markers")
    registry.commands["data rectify"] = Entry(f"{_HERE}.markers.command:rectify")
    registry.commands["data ball"] = Entry(f"{_HERE}.ball.command:ball")
