"""Dr.Jit and Mitsuba, imported after a fit libLLVM was chosen: Dr.Jit keeps the first one that it finds.

All are `Any`, since the types of arrays are other ones in each variant, and Mitsuba's stubs mix those of two.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, NoReturn

from metapp.rendering import types as mt
from metapp.rendering.variant import choose_kernel_folder, choose_llvm

with suppress(ValueError):  # there is no libLLVM: variants of GPUs need none
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
    """Have Mitsuba know a plugin, in the variant that is active and in all that will be.

    In variants other than VARIANTS a scene that names it is refused.

    Args:
        kind: of plugin, as Mitsuba's functions name it: bsdf, integrator, ...
        name: of the plugin in scenes.
        make: returns its class in the active variant.
    """

    def refuse(props: mt.Properties) -> NoReturn:
        raise ValueError(
            f"{name}: variant {mi.variant()}, expected {' or '.join(MITSUBA_VARIANTS)}; mi.set_variant('llvm_ad_rgb')."
        )

    def register(*_: object) -> None:
        # the function is another one in each variant
        getattr(mi, f"register_{kind}")(name, make() if mi.variant() in MITSUBA_VARIANTS else refuse)

    mi.detail.add_variant_callback(register)
    if mi.variant():
        register()
