"""The learned rules and their parts, as extensions offer them."""

from metapp.door import Part, Rule

_PARTS = "metapp.learning.rules.parts"

OFFERS = (
    # parts, in the order in which they act on a step
    Part("sgd", f"{_PARTS}:SignedRates"),
    Part("rates", f"{_PARTS}:Rates"),
    Part("shared", f"{_PARTS}:SharedRates"),
    Part("solve", "metapp.learning.rules.solve:Solve"),
    Part("betas", f"{_PARTS}:Betas"),
    Part("loss", f"{_PARTS}:LossParameters"),
    Part("pace", f"{_PARTS}:Paces"),
    Part("eps", f"{_PARTS}:Eps"),
    Part("curvature", f"{_PARTS}:Curvature"),
    Part("network", "metapp.learning.rules.network:Network"),
    Part("average", f"{_PARTS}:Average"),
    Part("basis", f"{_PARTS}:Basis"),
    # names for compositions
    Rule("adam", "rates+betas", short=True),
    Rule("tied", "shared+pace", short=True),
    # the paper's rule: one rate per weight, the same at every step, any sign
    Rule("meta-sgd", "sgd"),
    # Adam with rates and betas per step, loss parameters, and steps multiplied by learned matrices from both sides
    Rule("meta-curvature", "adam+loss+curvature"),
    # Adam with one rate per weight for all steps, times one per parameter tensor and step, and a learned eps, for
    # recipes that start from General's encoder and train it through the steps
    Rule("meta-encoder", "tied+betas+loss+eps"),
    # the same, and a convolutional network that adds to the steps of parameters on a grid
    Rule("meta-lgd", "meta-encoder+network"),
    # meta-encoder in the eigenbasis of the training tasks' gradients
    Rule("meta-axes", "meta-encoder+basis"),
    # the same with tail averaging, where samples are random, which lets the parameters scatter
    Rule("meta-basis", "meta-axes+average"),
    # ridge regression in the last layer, on learned features
    Rule("ridge", "solve+loss"),
)
