"""The tasks, weights and losses of `maml.py`, with both loops by `learn`; it prints the first and the last losses."""

import sys

import torch

from metapp.learning.adjoint import DrawnBatch, Loss
from metapp.learning.learn import MetaParameters, after_learning, learn, over_tasks
from metapp.learning.recipe import Adam
from metapp.learning.rules import fixed_adam, sgd
from metapp.learning.task import Tasks

torch.manual_seed(0)
torch.set_num_threads(1)  # as in maml.py
torch.set_default_dtype(torch.float64)
rng, STEPS, OUTER_STEPS = torch.default_generator, 5, int(sys.argv[1]) if sys.argv[1:] else 500
sinusoids = {"amplitude": 0.1 + 4.9 * torch.rand(1100, 1), "phase": torch.pi * torch.rand(1100, 1)}
tasks = Tasks(tuple(map(str, range(1100))), sinusoids, torch.arange(1100))
phi = MetaParameters({"theta": 0.2 * torch.randn(1761)}, {"rate": torch.full((1, 1761), 0.01)}).flatten()


def draw(tasks, rng, done):
    """Draw 10 points of each task."""
    x = 10 * torch.rand(len(tasks), 10, generator=rng) - 5
    amplitude, phase = (tasks.data[key][tasks.rows] for key in ("amplitude", "phase"))
    return DrawnBatch(tasks.selected_names, {"x": x, "y": amplitude * torch.sin(x + phase)})


def error(theta, x, y):
    """Return how far a network with two hidden layers is from a task."""
    w1, b1, w2, b2, w3, b3 = theta.split([40, 40, 1600, 40, 40, 1])
    hidden = torch.tanh(torch.tanh(torch.outer(x, w1) + b1) @ w2.view(40, 40) + b2)
    return (hidden @ w3 + b3 - y).square().mean()


def report(step, phi):
    """Print the loss on unseen tasks, at theta_0 and after learning; without rates nothing is learned."""
    alphas = [{"alpha.rate": share * phi["alpha.rate"]} for share in (0.0, 1.0)]
    before, after = (fit_loss.value(phi | alpha, unseen, {}).mean() for alpha in alphas)
    print(f"outer step {step:4}, loss on unseen tasks {before:.5f}, after {STEPS} steps {after:.5f}", flush=True)


loss = Loss(draw, lambda theta, batch, _: torch.vmap(error)(theta["theta"], batch["x"], batch["y"]))
fit_loss = after_learning(loss, sgd, steps=STEPS, order=2)
meta_loss = over_tasks(fit_loss, count=25)
adam = fixed_adam(Adam(0.001), phi, OUTER_STEPS)
unseen = fit_loss.draw(tasks.select(range(1000, 1100)), rng, 1.0).batch

report(0, phi)
phi = learn(phi, adam, tasks.select(range(1000)), meta_loss, steps=OUTER_STEPS, rng=rng)
report(OUTER_STEPS, phi)
