"""Dr.Jit and Mitsuba, imported after a fit libLLVM was chosen: Dr.Jit keeps the first one that it finds.

All are `Any`, since the types of arrays are other ones in each variant, and Mitsuba's stubs mix those of two.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from metapp.rendering.variant import choose_llvm

with suppress(ValueError):  # none is there: variants of GPUs need none
    choose_llvm()

import drjit
import drjit.nn
import mitsuba

dr: Any = drjit
mi: Any = mitsuba
nn: Any = drjit.nn
