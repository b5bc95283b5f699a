"""The learned rules that --rule names: each is a tuple of parts, in the order in which they act on a step."""

from __future__ import annotations

from metapp.learning.rules.network import StepNetwork
from metapp.learning.rules.parts import AdamDirections, Average, Basis, Curvature, LossParameters, Rates
from metapp.learning.rules.rule import LearnedRule
from metapp.learning.rules.solve import Solve

# The paper's rule: one rate for each weight, equal at every step, of any sign
META_SGD = LearnedRule("meta-sgd", (Rates("signed"),))
META_SGD_LOSS = LearnedRule("meta-sgd-loss", (*META_SGD.parts, LossParameters()))

# Adam with rates and betas for each step, and loss parameters
META_ADAM = LearnedRule("meta-adam", (Rates("stepwise"), AdamDirections(), LossParameters()))

# Steps that learned matrices multiply from both sides
META_CURVATURE = LearnedRule("meta-curvature", (*META_ADAM.parts, Curvature()))

# Adam with few hyperparameters, for recipes that begin at General's encoder and train it through the steps
META_ENCODER = LearnedRule("meta-encoder", (Rates("paced"), AdamDirections(learns_eps=True), LossParameters()))

# A convolutional network adds to the steps of parameters on a grid
META_LGD = LearnedRule("meta-lgd", (*META_ENCODER.parts, StepNetwork()))

# Tail averaging, for random samples, which scatter the parameters
META_AVERAGE = LearnedRule("meta-average", (*META_ENCODER.parts, Average()))

# Steps in the eigenbasis of the training tasks' gradients, without and with tail averaging
META_AXES = LearnedRule("meta-axes", (*META_ENCODER.parts, Basis()))
META_BASIS = LearnedRule("meta-basis", (*META_AVERAGE.parts, Basis()))

# Ridge regression in the last layer, on learned features
RIDGE = LearnedRule("ridge", (Solve(), LossParameters()))
