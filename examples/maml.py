"""MAML with learned rates (Meta-SGD) in plain PyTorch: learn weights from which 5 gradient steps fit any sinusoid."""

import sys

import torch

torch.manual_seed(0)
torch.set_num_threads(1)  # tensors of 25 tasks and 40 units: more threads cost more than they save
torch.set_default_dtype(torch.float64)  # as in maml_with_metapp.py
STEPS, OUTER_STEPS = 5, int(sys.argv[1]) if sys.argv[1:] else 500
AMPLITUDES, PHASES = 0.1 + 4.9 * torch.rand(1100, 1), torch.pi * torch.rand(1100, 1)  # of 1,100 tasks
# what is learned: theta_0, all weights and biases of a network as one vector, and alpha, a rate for each of them
phi = torch.stack([0.2 * torch.randn(1761), torch.full((1761,), 0.01)])


def draw(tasks):  # for each step and for the loss after the steps, 10 points of each task
    x = 10 * torch.rand(STEPS + 1, len(tasks), 10) - 5
    return x, AMPLITUDES[tasks] * torch.sin(x + PHASES[tasks])


def loss(theta, x, y):  # algorithm 2: how far a network with two hidden layers is from a task
    w1, b1, w2, b2, w3, b3 = theta.split([40, 40, 1600, 40, 40, 1])
    hidden = torch.tanh(torch.tanh(torch.outer(x, w1) + b1) @ w2.view(40, 40) + b2)
    return (hidden @ w3 + b3 - y).square().mean()


def learn(theta, alpha, x, y):  # algorithm 1, the inner loop
    for i in range(STEPS):
        theta = theta - alpha * torch.func.grad(loss)(theta, x[i], y[i])
    return theta


def meta_loss(phi, x, y):  # algorithm 3: the loss after learning, on points that no step saw, as the mean over tasks
    return torch.vmap(lambda x, y: loss(learn(*phi, x, y), x[STEPS], y[STEPS]), in_dims=1)(x, y).mean()


adam = torch.optim.Adam([phi], lr=0.001)
unseen = draw(torch.arange(1000, 1100))
for step in range(OUTER_STEPS + 1):  # the outer loop
    if step % 50 == 0:  # without rates nothing is learned: the first loss is that of theta_0
        before, after = (meta_loss(phi * torch.tensor([[1.0], [rate]]), *unseen) for rate in (0.0, 1.0))
        print(f"outer step {step:4}, loss on unseen tasks {before:.5f}, after {STEPS} steps {after:.5f}", flush=True)
    phi.grad = torch.func.grad(meta_loss)(phi, *draw(torch.randperm(1000)[:25]))
    adam.step()
