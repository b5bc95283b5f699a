"""The embedded data sets and the procedural models that they are drawn from.

Each of `brdf`, `texture`, `svbrdf_stationary`, `svbrdf_nonstationary`, `illumination` and `transport` draws the set of
one application. The reflection models of BRDFs are in `brdf_models` and `brdf_anisotropic_models`, periodic patterns in
`patterns`, materials in `stationary` and `nonstationary`, environment maps in `environments`, and Cornell boxes in
`cornell`.
"""
