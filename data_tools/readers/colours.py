"""colour-science, imported without what else it does."""

from __future__ import annotations

import sys
import warnings
from types import ModuleType
from unittest.mock import NonCallableMock


def colour_science() -> ModuleType:
    """colour-science, imported without its warning of a missing SciPy, which nothing here needs.

    It may not see OpenImageIO: what it keeps of it would be reported as leaks when Python ends. The mocks that it
    leaves in place of SciPy go again: other libraries would take them for the package.
    """
    import OpenImageIO as oiio

    sys.modules["OpenImageIO"] = None  # type: ignore[assignment]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import colour
    finally:
        sys.modules["OpenImageIO"] = oiio
    for name in [name for name, module in sys.modules.items() if isinstance(module, NonCallableMock)]:
        del sys.modules[name]
    return colour
