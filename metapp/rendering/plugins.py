"""Plugins for Mitsuba 3 that are written in Python, registered in every variant.

Choose a libLLVM before this module is imported: `metapp.rendering.variant.choose_llvm`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi

VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")


def register_plugin(kind: str, name: str, make: Callable[[], Any]) -> None:
    """Have Mitsuba know a plugin, in the variant that is active and in all that will be.

    In variants other than VARIANTS a scene that names it is refused.

    Args:
        kind: of plugin, as Mitsuba's functions name it: bsdf, integrator, ...
        name: of the plugin in scenes.
        make: returns its class in the active variant.
    """

    def refuse(props: Any) -> Any:
        raise ValueError(
            f"{name}: variant {mi.variant()}, expected {' or '.join(VARIANTS)}; mi.set_variant('llvm_ad_rgb')."
        )

    def register(*_: Any) -> None:
        # the function is another one in each variant
        getattr(mi, f"register_{kind}")(name, make() if mi.variant() in VARIANTS else refuse)

    mi.detail.add_variant_callback(register)
    if mi.variant():
        register()
