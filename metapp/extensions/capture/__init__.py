"""Light and materials captured by hand: a mirror ball at several exposures, flat materials in a sheet of markers."""

from data_tools.formats.options import FOV_OF_FITS
from metapp.door import Command, Format, Merge, Option

_HERE = "metapp.extensions.capture"
_EXPOSURES = Option(
    "exposures",
    "",
    "Exposure times of INPUT photos of one mirror ball, which are merged: such as 1/20,1/60; auto: of EXIF.",
    "T,T,...",
    protocol="photo",
    of_inputs=True,
)
_FOV = FOV_OF_FITS._replace(
    help="Camera field of view along the shorter side; default: from EXIF, else a distant camera."
)
OFFERS = (
    Format(
        "ball",
        "illumination",
        f"{_HERE}.ball.reading",
        "LDR photos of a ball",
        takes=("size",),
        options=(_FOV,),
    ),
    Merge("illumination", _EXPOSURES, f"{_HERE}.ball.capture:merge"),
    Command("markers", f"{_HERE}.markers.command:markers", under="data", bare_is_help=True),
    Command("rectify", f"{_HERE}.markers.command:rectify", under="data", bare_is_help=True),
    Command("ball", f"{_HERE}.ball.command:ball", under="data", bare_is_help=True),
)
