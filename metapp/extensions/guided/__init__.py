"""Path guiding while rendering: an integrator of Mitsuba 3, and `--render` of transport."""

from __future__ import annotations

from metapp.door import Output, Plugin

_HERE = "metapp.extensions.guided"
GUIDED_NEE = "guided_path + NEE"  # guided at all bounces
OFFERS = (
    Plugin(
        "metapp_guided_path",
        f"{_HERE}.integrator:register_guided_path",
        row=GUIDED_NEE,
        note="guided_path guides all bounces and learns while it renders",
    ),
    Output(
        "transport",
        "render",
        f"{_HERE}.rendering:rendered",
        examples=(
            ("meta transport {}/box.xml --render 64", "the scene guided at all bounces, and unguided in the same time"),
        ),
    ),
)
