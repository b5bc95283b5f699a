"""Faster steps of learning: in C, or by torch and compiled. Results equal those of the loop in torch to rounding.

Read `step_choice`, which chooses the steps for a loss and a rule; `c_steps`, steps in C, with `packing`, their
arguments; `nbrdf`, the loss of the NBRDF network in C; `meta_sgd`, outer steps of Meta-SGD on it; then `compiler`,
which compiles and loads C sources.
"""
