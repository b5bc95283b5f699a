"""Baselines: methods without a network, fitted to the data that fits see and judged by the same errors.

Read `baseline` first, the contract of a method. `brdf`, `illumination`, `svbrdf_nonstationary`, `svbrdf_stationary` and
`texture` have the methods of one application each, and `blending`, `components`, `ggx_lobes` and `harmonics` the
mathematics of some. `baseline_fits` fits methods to tasks; `baseline_run` with `baseline_command`, and
`baselines_table`, are the command and the table.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metapp.registry import registry

if TYPE_CHECKING:
    from metapp.application import Application
    from metapp.extensions.baselines.baseline import Baseline
    from metapp.learning.app import App


def baselines_of(application: Application, app: App) -> tuple[Baseline, ...]:
    """Return the baselines of an application, for what its fits see; () if no extension offers one.

    Args:
        application: the application.
        app: its network and sizes, at the recipe of the fits that methods are compared with.
    """
    functions = dict.fromkeys(registry().load_all(f"baselines of {application.name}").values())
    return tuple(method for function in functions for method in function(app))
