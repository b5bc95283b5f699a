"""Dr.Jit and Mitsuba, imported after a fit libLLVM was chosen: Dr.Jit keeps the first one that it finds.

Code that runs inside Mitsuba's kernels imports them from here. `dr`, `mi` and `nn` are `Any`, since the types of arrays
are different ones in each variant, and Mitsuba's stubs mix the types of two variants.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, NoReturn

from metapp.rendering import types as mt
from metapp.rendering.variant import choose_kernel_folder, choose_llvm

with suppress(ValueError):  # no libLLVM was found: variants for GPUs need none
    choose_kernel_folder()
    choose_llvm()

import drjit
import drjit.nn
import mitsuba

dr: Any = drjit
mi: Any = mitsuba
nn: Any = drjit.nn

MITSUBA_VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")


def register_plugin(kind: str, name: str, make: Callable[[], mt.PluginClass]) -> None:
    """Register a plugin in Mitsuba, in the active variant and in all variants that are set later.

    In variants other than MITSUBA_VARIANTS a scene that names it is refused.

    Args:
        kind: kind of plugin in the names of Mitsuba's functions: bsdf, integrator, ...
        name: name of the plugin in scenes.
        make: returns its class in the active variant.
    """

    def refuse(props: mt.Properties) -> NoReturn:
        raise ValueError(
            f"{name}: variant {mi.variant()}, expected {' or '.join(MITSUBA_VARIANTS)}; mi.set_variant('llvm_ad_rgb')."
        )

    def register(*_: object) -> None:
        # Mitsuba has another function of this name in each variant
        getattr(mi, f"register_{kind}")(name, make() if mi.variant() in MITSUBA_VARIANTS else refuse)

    mi.detail.add_variant_callback(register)
    if mi.variant():
        register()
