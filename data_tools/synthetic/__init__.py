"""The embedded data sets and the procedural models that they are drawn from.

Each of `brdf`, `texture`, `svbrdf_stationary`, `svbrdf_nonstationary`, `illumination` and `transport` draws the set of
one application, by random draws of `random_values`. For BRDFs read `brdf_models` and `brdf_anisotropic_models`, the
reflection models, with `interfaces`, Fresnel's equations; `brdf_draws`, their random numbers; and `brdf_anisotropic`,
the anisotropic materials. Periodic patterns are in `patterns`, materials in `stationary` and `nonstationary`,
environment maps in `environments`, and Cornell boxes in `cornell`, of which `transport_task` makes tasks.
`domes` photographs real materials under many lamps, for training. `examples` has small files to try commands on.
"""
