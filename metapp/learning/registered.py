"""The learned rules and their parts, by name."""

from metapp.registry import Entry, Registry

_PARTS = "metapp.learning.rules.parts"


def register(registry: Registry) -> None:
    """Add the rules and the parts that ship."""
    # parts, in the order in which they act on a step
    registry.parts["sgd"] = Entry(f"{_PARTS}:SignedRates")
    registry.parts["rates"] = Entry(f"{_PARTS}:Rates")
    registry.parts["shared"] = Entry(f"{_PARTS}:SharedRates")
    registry.parts["solve"] = Entry("metapp.learning.rules.solve:Solve")
    registry.parts["betas"] = Entry(f"{_PARTS}:Betas")
    registry.parts["loss"] = Entry(f"{_PARTS}:LossParameters")
    registry.parts["pace"] = Entry(f"{_PARTS}:Paces")
    registry.parts["eps"] = Entry(f"{_PARTS}:Eps")
    registry.parts["curvature"] = Entry(f"{_PARTS}:Curvature")
    registry.parts["network"] = Entry("metapp.learning.rules.network:Network")
    registry.parts["average"] = Entry(f"{_PARTS}:Average")
    registry.parts["basis"] = Entry(f"{_PARTS}:Basis")
    # names for compositions
    registry.compositions["adam"] = "rates+betas"
    registry.compositions["tied"] = "shared+pace"
    # the paper's rule: one rate per weight, the same at every step, any sign
    registry.rules["meta-sgd"] = "sgd"
    # Adam with rates and betas per step, loss parameters, and steps multiplied by learned matrices from both sides
    registry.rules["meta-curvature"] = "adam+loss+curvature"
    # Adam with one rate per weight for all steps, times one per parameter tensor and step, and a learned eps, for
    # recipes that start from General's encoder and train it through the steps
    registry.rules["meta-encoder"] = "tied+betas+loss+eps"
    # the same, and a convolutional network that adds to the steps of parameters on a grid
    registry.rules["meta-lgd"] = "meta-encoder+network"
    # meta-encoder in the eigenbasis of the training tasks' gradients
    registry.rules["meta-axes"] = "meta-encoder+basis"
    # the same with tail averaging, where samples are random, which lets the parameters scatter
    registry.rules["meta-basis"] = "meta-axes+average"
    # ridge regression in the last layer, on learned features
    registry.rules["ridge"] = "solve+loss"
