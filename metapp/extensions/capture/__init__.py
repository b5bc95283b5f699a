"""Light and materials captured by hand: a mirror ball at several exposures, flat materials in a sheet of markers."""

from metapp.door import Command, Merge, Option

_HERE = "metapp.extensions.capture"
_EXPOSURES = Option(
    "exposures",
    "",
    "Exposure times of INPUT photos of one mirror ball, which are merged: such as 1/20,1/60, or auto.",
    "T,T,...",
    protocol="photo",
    of_inputs=True,
)
OFFERS = (
    Merge("illumination", _EXPOSURES, f"{_HERE}.ball.capture:merge"),
    Command("markers", f"{_HERE}.markers.command:markers", under="data", bare_is_help=True),
    Command("rectify", f"{_HERE}.markers.command:rectify", under="data", bare_is_help=True),
    Command("ball", f"{_HERE}.ball.command:ball", under="data", bare_is_help=True),
)
