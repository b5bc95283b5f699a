"""Light transport: a scene's light as a density over primary sample space, to guide paths by (paper section 4.1.6).

`app` puts the application together; `path_fits` has the decoder, the paths that fits see, and the judge. Its network is
the flow in `flow`, a chain of the splines in `spline`; `scene_encoder` predicts it from a small picture of the scene.
`guide` makes tables of it, from which paths take their first direction, `scene_renderer` measures the pictures that
such paths make, and `density_pictures` draws densities; `recipes`, `options` and `presenter` are as in every
application.
"""

from __future__ import annotations

from metapp.application import Application, RecipeEntry, SyntheticSet
from metapp.entries import Lazy
from metapp.registry import Registry


def register(registry: Registry) -> None:
    """Add the application and its recipes; extensions read scenes and render them."""
    transport = Application(
        name="transport",
        title="Transport",
        help="Light transport of a scene: densities that guide its paths.",
        app=Lazy("metapp.apps.transport.app:Transport"),
        options=Lazy("metapp.apps.transport.options:TransportOptions"),
        assets={"path guide": Lazy("metapp.apps.transport.path_guide:make_path_guide")},
        presenter=Lazy("metapp.apps.transport.presenter:TransportPresenter"),
        synthetic=SyntheticSet(
            "data_tools.synthetic.transport", "light paths of Cornell boxes; 0.7 MB and 2 s each (40 + 8)"
        ),
    )
    for name in ("quick", "full", "paper", "paper-long"):
        transport.recipes[name] = RecipeEntry(f"metapp.apps.transport.recipes:RECIPES.{name}")
    registry.add(transport)
