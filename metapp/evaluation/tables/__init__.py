"""The tables of `metapp evaluate`: functions from a :class:`metapp.evaluation.evaluation_run.EvaluationRun` to a table.

Read `results` first, the paper's main table; `ablation`, `convergence`, `image` and `storage` each answer one further
question of the paper. The registry (:mod:`metapp.contents`) names these functions.
"""
