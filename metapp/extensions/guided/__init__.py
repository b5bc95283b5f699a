"""Path guiding while rendering: an integrator of Mitsuba 3, and `--render` of transport."""

from __future__ import annotations

from metapp.door import Option, Output, Plugin

_HERE = "metapp.extensions.guided"
GUIDED_NEE = "guided_path + NEE"  # guided at all bounces
RENDER = Option(
    "render",
    0,
    "Also render each scene at this size, with path guiding and without it in equal time.",
    "PX",
    low=1,
    high=4096,
    panel="Output",
)
OFFERS = (
    Plugin(
        "metapp_guided_path",
        f"{_HERE}.integrator:register_guided_path",
        row=GUIDED_NEE,
        note="guided_path guides all bounces and learns while it renders",
    ),
    Output(
        "transport",
        RENDER,
        f"{_HERE}.rendering:rendered",
        examples=(
            ("meta transport {}/box.xml --render 64", "the scene guided at all bounces, and unguided in the same time"),
        ),
    ),
)
