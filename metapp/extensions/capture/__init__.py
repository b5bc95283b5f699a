"""Light and materials captured by hand: a mirror ball at several exposures, flat materials in a sheet of markers."""

from metapp.door import Command, Format, Merge

_HERE = "metapp.extensions.capture"
OFFERS = (
    Format(
        "ball",
        "illumination",
        f"{_HERE}.ball.reading",
        "LDR photos of a ball",
        takes=("rows", "fov_rad"),
    ),
    Merge("illumination", "shutter", f"{_HERE}.ball.capture:merge"),
    Command("markers", f"{_HERE}.markers.command:markers", under="data", bare_is_help=True),
    Command("rectify", f"{_HERE}.markers.command:rectify", under="data", bare_is_help=True),
    Command("ball", f"{_HERE}.ball.command:ball", under="data", bare_is_help=True),
)
