"""A fitted BRDF as an ONNX model, which returns `reflectance` [n, 3] for directions `wi` and `wo` [n, 3].

It lets renderers and other tools evaluate a fit without this package. The export reads parameters alone, not the run.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.geometry import directions_to_four_angles, half_difference_and_cosine
from metapp.apps.brdf.brdf_network import find_network
from metapp.extensions.onnx_files.models import encode_model
from metapp.learning.task import Params
from metapp.storage.files import add_suffix, write_bytes

if TYPE_CHECKING:
    from metapp.apps.brdf.app import Brdf

REFLECTANCE_DESCRIPTION = {
    "wi, wo": "unit vectors away from the surface, whose normal is z",
    "reflectance": "1/sr, linear RGB, without the cosine; 0 below the horizon",
}


class ReflectanceModule(torch.nn.Module):
    """A fitted BRDF as a module to trace: reflectance [n, 3] of directions of light and viewer, [n, 3] each.

    Args:
        theta: the parameters of the fit, without a task axis.
    """

    def __init__(self, theta: Params) -> None:
        super().__init__()
        self.network = find_network(theta)
        self.theta = torch.nn.ParameterDict({key: value.float()[None] for key, value in theta.items()})

    @override
    def forward(self, wi: Tensor, wo: Tensor) -> Tensor:
        angles = directions_to_four_angles(wi, wo)
        where = half_difference_and_cosine(angles if self.network.anisotropic else angles[:, :3])
        values = self.network.reflectance(dict(self.theta.items()), where.T[None])[0].T.clamp_min(0)
        above = torch.minimum(wi[:, 2:], wo[:, 2:]) > 0
        return torch.where(above, values, torch.zeros_like(values))


def write_onnx(app: Brdf, theta: Params, path: Path) -> None:
    """Write a fitted BRDF as the ONNX model <path>.onnx.

    Args:
        app: the application, which the signature of exports asks for; all that counts is in the parameters.
        theta: the parameters of the fit, without a task axis.
        path: the file, to which the suffix is added.

    Raises:
        ValueError: onnx or onnxscript is not installed.
    """
    examples = {name: torch.nn.functional.normalize(torch.rand(16, 3) + 0.1, dim=1) for name in ("wi", "wo")}
    sizes = {name: {0: "n"} for name in examples}
    about = {"made_by": "metapp export", "of": path.name, **REFLECTANCE_DESCRIPTION}
    model = encode_model(ReflectanceModule(theta), examples, ["reflectance"], sizes, about)
    write_bytes(add_suffix(path, ".onnx"), model)
