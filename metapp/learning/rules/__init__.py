"""Update rules: plain ones (`descent`), and learned ones, which are made of parts.

A `Part` (`part`) says what hyperparameters it learns and what it does at each point of a step; a `LearnedRule` (`rule`)
passes a step through its parts (`parts`, `network`, `solve`). `metapp.rules` has the parts and rules by name.
"""

from metapp.learning.rules.descent import fixed_adam, half_cosine, like, outer_adam, sgd
from metapp.learning.rules.part import Part
from metapp.learning.rules.parts import META_EPS
from metapp.learning.rules.rule import LearnedRule, compose

__all__ = [
    "META_EPS",
    "LearnedRule",
    "Part",
    "compose",
    "fixed_adam",
    "half_cosine",
    "like",
    "outer_adam",
    "sgd",
]
