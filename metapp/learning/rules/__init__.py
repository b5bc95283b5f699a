"""Update rules: plain ones with fixed settings, and learned ones, which are composed of parts.

In order of reading: :mod:`descent` has the plain rules. :mod:`rule` says what a `Part` is, and how a `LearnedRule`
passes a step through its parts. :mod:`parts` has most of the parts, :mod:`network` and :mod:`solve` have one large part
each. :mod:`named_rules` composes the rules, which `metapp.learned_rules` finds by their names.
"""

from metapp.learning.rules.descent import append_axes, fixed_adam, half_cosine, outer_adam, sgd
from metapp.learning.rules.parts import META_EPS
from metapp.learning.rules.rule import LearnedRule, Part

__all__ = [
    "META_EPS",
    "LearnedRule",
    "Part",
    "append_axes",
    "fixed_adam",
    "half_cosine",
    "outer_adam",
    "sgd",
]
