"""Fit a BRDF in ten solves, evaluate the network, and save it: fit_brdf.py MATERIAL.binary OUT.safetensors

To make a MERL file to try it on: metapp data synth brdf --count 1 --as merl --out materials
"""

import sys

import torch

import metapp

material, out = sys.argv[1:]
fit = metapp.fit("brdf", material)
print(f"error x100 {fit.error:.3f} after {fit.seconds:.3f} s")

# half and difference angles in radians: theta_h, theta_d, phi_d
angles = torch.tensor([[0.0, 0.1, 1.5], [0.3, 0.1, 1.5], [0.8, 0.1, 1.5]])
reflectance = fit.app.reflectance(fit.parameters, angles)
for (theta_h, *_), rgb in zip(angles.tolist(), reflectance.tolist(), strict=True):
    print(f"theta_h {theta_h:.1f} rad: " + ", ".join(f"{value:.4f}" for value in rgb) + " 1/sr")

fit.save(out)
print(f"saved {out}: {sum(value.numel() for value in fit.parameters.values())} weights")
