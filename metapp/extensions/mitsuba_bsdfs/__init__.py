"""Fits as BSDFs of Mitsuba 3, differentiable in their parameters.

Read `python_bsdf`, the base of BSDFs that are written in Python; `neural_brdf`, a fitted network, with `mixture`, the
lobes that it is sampled by; then `neural_svbrdf`, the maps of a fitted material.
"""
