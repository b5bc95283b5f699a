"""Path guiding while rendering: an integrator of Mitsuba 3, and `--render` of transport."""

from metapp.door import Option, Output, Plugin

_HERE = "metapp.extensions.guided"
_RENDER = Option(
    "render",
    0,
    "Also render each scene at this size, with path guiding and without it in equal time.",
    "PX",
    low=0,
    high=4096,
    panel="Output",
)
OFFERS = (
    Output("transport", _RENDER, f"{_HERE}.rendering:rendered"),
    Plugin("guided_path", f"{_HERE}.integrator:register_guided_path"),
)
