"""Fit a measured BRDF and write it as an ONNX model: `reflectance` [n, 3] of unit vectors `wi` and `wo` [n, 3].

pip install onnx onnxscript
python examples/brdf_to_onnx.py gold.binary gold.onnx
"""

import sys

import torch
from torch import Tensor

import metapp
from metapp.appearance.geometry import directions_to_four_angles

source, file = sys.argv[1:3]
asset = metapp.fit("brdf", source).asset


class Reflectance(torch.nn.Module):
    """The reflectance of the fit as a module to trace."""

    def forward(self, wi: Tensor, wo: Tensor) -> Tensor:
        """Return reflectance [n, 3] of unit vectors [n, 3]; 0 below the horizon."""
        above = torch.minimum(wi[:, 2:], wo[:, 2:]) > 0
        return asset.evaluate(directions_to_four_angles(wi, wo)) * above


examples = tuple(torch.nn.functional.normalize(torch.rand(2, 16, 3) + 0.1, dim=2))
names = {
    "input_names": ["wi", "wo"],
    "output_names": ["reflectance"],
    "dynamic_shapes": {"wi": {0: "n"}, "wo": {0: "n"}},
}
torch.onnx.export(Reflectance(), examples, file, dynamo=True, external_data=False, **names)
print(f"{file}: the reflectance of {source} in 1/sr, linear RGB, 0 below the horizon")
