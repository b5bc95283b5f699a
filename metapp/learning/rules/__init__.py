"""Update rules: plain ones (`descent`), and learned ones, which are made of parts.

A `Part` has hyperparameters and acts at points of a step; a `LearnedRule` passes a step through its parts (`rule`). The
parts are in `parts`, `network` and `solve`; `metapp.learned_rules` has the parts and rules by name.
"""

from metapp.learning.rules.descent import append_axes, fixed_adam, half_cosine, outer_adam, sgd
from metapp.learning.rules.parts import META_EPS
from metapp.learning.rules.rule import LearnedRule, Part, compose

__all__ = [
    "META_EPS",
    "LearnedRule",
    "Part",
    "append_axes",
    "compose",
    "fixed_adam",
    "half_cosine",
    "outer_adam",
    "sgd",
]
