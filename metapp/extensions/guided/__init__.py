"""Path guiding while rendering: an integrator of Mitsuba 3, and `--render` of transport."""

from __future__ import annotations

from metapp.registry import Output, Plugin, Registry

_HERE = "metapp.extensions.guided"
GUIDED_NEE = "guided_path + NEE"  # guided at all bounces


def register(registry: Registry) -> None:
    """Add the integrator and `--render`."""
    registry.plugins["metapp_guided_path"] = Plugin(
        f"{_HERE}.integrator:register_guided_path",
        help="guided_path guides all bounces and learns while it renders",
        row=GUIDED_NEE,
    )
    registry.outputs["transport", "render"] = Output(
        f"{_HERE}.rendering:rendered",
        examples=(
            ("meta transport {}/box.xml --render 64", "the scene guided at all bounces, and unguided in the same time"),
        ),
    )
