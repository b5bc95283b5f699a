"""Time and memory of learning, and of differentiating through it, against plain loops; `make bench` runs it.

What is measured: the BRDF network (675 weights), 8 tasks, 10 inner steps of 512 samples, one thread; the rule is
Meta-SGD where nothing else is said, or the default rule, meta-curvature. One fit is one task.

- Training: one outer step, the value of `after_learning` and its second-order gradient in phi = {theta_0, alpha}.
- Adapting: 10 steps from theta_0, without a meta-gradient; (a) keeps no graph either.

Against what: (a) the plain way, written here: task after task, `linear` on [samples, features], an unrolled graph with
`create_graph=True`; (b) learn2learn's MetaSGD and TorchOpt's differentiable SGD (one fixed rate: its gradient is in
theta_0 alone), with equal network and batches, where they can be imported; (c) JAX, `vmap` over tasks on
[features, samples], `scan` over the steps, jitted. All of them see equal samples, drawn beforehand. Loss and gradient
of (a) and of metapp are compared first, in the same run. (b) and (c) are extras: `pip install metapp[bench]`.

The machine's limit is measured by a loop of multiply-adds in C. The network's layers need 1764 of these for a sample of
a gradient, 3969 for a sample of a product. The kernel alone is timed for this CPU, and as CPUs with AVX2 and without
AVX run it.

How: all contestants take turns, round after round, and the median over the rounds counts. Seconds are the process's
CPU seconds, which equal the clock's where nothing else runs. Compiling happens before the first round and is not
counted; its seconds are printed.

Memory: the peak of live tensor storage during one eager outer step of a convolutional U-Net, 4 tasks of 128 x 128
pixels. A TorchDispatchMode sees every tensor that an operator returns, and forgets it when its storage is freed. It
counts tensors, whatever the allocator does; scratch memory inside an operator is not seen.
"""

from __future__ import annotations

import ctypes
import json
import platform
import statistics
import tempfile
import time
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, conv2d, interpolate, linear
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from typing_extensions import override

from benchmarks.bench_growth import ProblemSize, draw_batch
from metapp.apps.brdf.app import Brdf
from metapp.extensions.native import nbrdf
from metapp.extensions.native.compiler import load_library
from metapp.extensions.native.step_choice import choose_steps, make_compiled_steps
from metapp.learned_rules import rule_of
from metapp.learning.adjoint import DrawnBatch, Loss, StepMaker, torch_steps
from metapp.learning.learn import MetaParameters, after_learning, expand_tasks, learn
from metapp.learning.recipe import Adam
from metapp.learning.rules import META_EPS, sgd
from metapp.learning.task import Batch, Params

LEARNING_APP = Brdf()

LEARNING_SIZE, LEARNING_RATE = ProblemSize(steps=10, tasks=8, samples=512), 1e-2
INNER_STEPS, BATCH_TASKS, TASK_SAMPLES = LEARNING_SIZE
LEARNING_ROUNDS = 25  # rounds in which all contestants take turns; the median counts
DEFAULT_RULE = "meta-curvature"


def one_task(batch: Batch, task: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return the inputs [N, 6], cosines [N, 1] and targets [N, 3] of one task of a batch."""
    where = batch["where"][task].T.contiguous()
    return where[:, :6].contiguous(), where[:, 6:].contiguous(), batch["target"][task].T.contiguous()


PlainBatch = tuple[Tensor, Tensor, Tensor]


def plain_loss(weights: list[Tensor], batch: PlainBatch) -> Tensor:
    """Compute the application's loss with plain torch layers, as most programs would write it."""
    inputs, cosine, target = batch
    x = torch.relu(linear(inputs, weights[0], weights[1]))
    x = torch.relu(linear(x, weights[2], weights[3]))
    reflectance = torch.expm1(linear(x, weights[4], weights[5]))
    return (torch.log1p(reflectance * cosine) - target).abs().mean()


def plain_adapt(weights: list[Tensor], rates: list[Tensor], batches: list[PlainBatch], graph: bool) -> list[Tensor]:
    """Run Meta-SGD's inner loop for one task, as an unrolled graph where `graph`, and return the weights."""
    for batch in batches:
        if not graph:
            weights = [weight.detach().requires_grad_() for weight in weights]
        grads = torch.autograd.grad(plain_loss(weights, batch), weights, create_graph=graph)
        weights = [weight - rate * grad for weight, rate, grad in zip(weights, rates, grads, strict=True)]
    return weights


class TorchNetwork(torch.nn.Module):
    """The BRDF network as a module, which the libraries want."""

    def __init__(self, weights: list[Tensor]) -> None:
        super().__init__()
        for i, weight in enumerate(weights):
            self.register_parameter(f"p{i}", torch.nn.Parameter(weight.clone()))

    @override
    def forward(self, batch: PlainBatch) -> Tensor:
        return plain_loss(list(self.parameters()), batch)


def plain_weights(theta: Params) -> list[Tensor]:
    """Return a network's parameters as plain torch layers take them: biases without their second axis."""
    return [value.squeeze(-1) if key.startswith("b") else value for key, value in theta.items()]


def learn2learn_step(theta: Params, inner: list[list[PlainBatch]], last: list[PlainBatch]) -> list[Callable[[], Any]]:
    """Make one second-order outer step of learn2learn's MetaSGD."""
    from learn2learn.algorithms import MetaSGD

    meta = MetaSGD(TorchNetwork(plain_weights(theta)), lr=LEARNING_RATE)

    def step() -> tuple[Tensor, list[Tensor]]:
        total = torch.zeros(())
        for batches, final in zip(inner, last, strict=True):
            learner = meta.clone()
            for batch in batches:
                learner.adapt(learner(batch))
            total = total + learner(final) / BATCH_TASKS
        return total, list(torch.autograd.grad(total, list(meta.parameters())))

    return [step]


def torchopt_step(theta: Params, inner: list[list[PlainBatch]], last: list[PlainBatch]) -> list[Callable[[], Any]]:
    """Make one second-order outer step of TorchOpt's differentiable SGD."""
    import torchopt

    net = TorchNetwork(plain_weights(theta))
    optimiser = torchopt.MetaSGD(net, lr=LEARNING_RATE)
    start_net, start_state = torchopt.extract_state_dict(net), torchopt.extract_state_dict(optimiser)
    leaves = list(net.parameters())

    def step() -> tuple[Tensor, list[Tensor]]:
        total = torch.zeros(())
        for batches, final in zip(inner, last, strict=True):
            for batch in batches:
                optimiser.step(net(batch))
            total = total + net(final) / BATCH_TASKS
            torchopt.recover_state_dict(net, start_net)
            torchopt.recover_state_dict(optimiser, start_state)
        return total, list(torch.autograd.grad(total, leaves))

    return [step]


def jax_steps(theta: Params, inner: list[list[PlainBatch]], last: list[PlainBatch]) -> list[Callable[[], Any]]:
    """Make JAX's second-order outer step and its adapting."""
    import jax
    import jax.numpy as jnp

    def stack(pick: Callable[[PlainBatch], Tensor]) -> Any:
        return jnp.asarray(torch.stack([torch.stack([pick(b) for b in batches]) for batches in inner]).numpy())

    columns: list[Callable[[PlainBatch], Tensor]]
    columns = [lambda b: b[0].T.contiguous(), lambda b: b[1].T.contiguous(), lambda b: b[2].T.contiguous()]
    batches = tuple(stack(pick) for pick in columns)
    final = tuple(jnp.asarray(torch.stack([pick(b) for b in last]).numpy()) for pick in columns)
    weights = [jnp.asarray(value.numpy()) for value in theta.values()]
    rates = [jnp.full_like(value, LEARNING_RATE) for value in weights]

    def loss(weights: Any, batch: Any) -> Any:
        x, cosine, target = batch
        x = jax.nn.relu(weights[0] @ x + weights[1])
        x = jax.nn.relu(weights[2] @ x + weights[3])
        return jnp.abs(jnp.log1p(jnp.expm1(weights[4] @ x + weights[5]) * cosine) - target).mean()

    def adapt_task(weights: Any, rates: Any, batches: Any) -> Any:
        def step(weights: Any, batch: Any) -> Any:
            grads = jax.grad(loss)(weights, batch)
            return [w - r * g for w, r, g in zip(weights, rates, grads, strict=True)], None

        return jax.lax.scan(step, weights, batches)[0]

    def outer(weights: Any, rates: Any, batches: Any, final: Any) -> Any:
        losses = jax.vmap(lambda batches, final: loss(adapt_task(weights, rates, batches), final))(batches, final)
        return losses.mean()

    train = jax.jit(jax.value_and_grad(outer, argnums=(0, 1)))
    adapt = jax.jit(jax.vmap(adapt_task, in_axes=(None, None, 0)))
    return [
        lambda: jax.block_until_ready(train(weights, rates, batches, final)),
        lambda: jax.block_until_ready(adapt(weights, rates, batches)),
    ]


PEAK_SOURCE = """
#include <time.h>
double peak(void) {
  V a[12], x = (V){0} + 0.999f, y = (V){0} + 0.001f;
  for (int i = 0; i < 12; i++) a[i] = (V){0} + (float)i;
  clock_t start = clock();
  long n = 20000000;
  for (long k = 0; k < n; k++)
    for (int i = 0; i < 12; i++) a[i] = a[i] * x + y;
  volatile float kept = 0;
  for (int i = 0; i < 12; i++) kept += a[i][0];
  return n * 12 * 2. * LANES / 1e9 * CLOCKS_PER_SEC / (clock() - start);
}
"""


def measure_peak_gflops(march: str = "native") -> float:
    """Measure a core's multiply-adds by these instructions, in GFLOP/s; NaN without a compiler."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "peak.c"
        source.write_text(Path(nbrdf.__file__).with_name("vectors.h").read_text() + PEAK_SOURCE)
        library = load_library(source, "peak", march=march)
    if library is None:
        return float("nan")
    library.peak.restype = ctypes.c_double
    return float(library.peak())


OPERATIONS_PER_SAMPLE = {"gradient": 2 * 1764, "product": 2 * 3969}  # floating-point operations of the layers


def bench_kernel() -> None:
    """Print the time of the BRDF network's loss in C by instruction set, and its share of the machine's limit."""
    rng = Generator().manual_seed(0)
    theta, batch = LEARNING_APP.init(rng, BATCH_TASKS), draw_batch(LEARNING_SIZE, rng)
    flat = torch.cat([value.flatten(1) for value in theta.values()], 1)
    capability = torch.backends.cpu.get_cpu_capability()
    marches = ["native", *(["x86-64-v3"] if capability in ("AVX2", "AVX512") else []), "x86-64-v2"]
    print(f"\nBRDF network in C, {TASK_SAMPLES} samples of a task, one thread; torch says {capability}")
    print(f"  {'-march':12} {'lanes':>5} {'limit':>13} {'gradient':>24} {'product':>24}")
    for march in marches:
        library = nbrdf.load_nbrdf_library(march)
        if library is None:
            print(f"  {march:12} is not compiled here")
            continue
        with mock.patch.object(nbrdf, "load_nbrdf_library", return_value=library):
            times = median_seconds(
                {
                    "gradient": lambda: nbrdf.loss_gradient(flat, batch, {}),
                    "product": lambda: nbrdf.gradient_product(flat, batch, {}, flat),
                },
                rounds=200,
            )
        peak_gflops, cells = measure_peak_gflops(march), ""
        for name, seconds in times.items():
            rate = OPERATIONS_PER_SAMPLE[name] * BATCH_TASKS * TASK_SAMPLES / seconds / 1e9
            cells += f" {1e6 * seconds / BATCH_TASKS:8.1f} us, {rate / peak_gflops:4.0%} of it"
        print(f"  {march:12} {library.nbrdf_lanes():5} {peak_gflops:5.0f} GFLOP/s {cells}")


def median_seconds(contestants: dict[str, Callable[[], Any]], rounds: int = LEARNING_ROUNDS) -> dict[str, float]:
    """Return the median CPU seconds of each contestant; they take turns."""
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for name, run in contestants.items():
        start = time.perf_counter()
        run()
        if "compiled" in name:
            print(f"  {name}: {time.perf_counter() - start:.1f} s to compile")
        run()
    for _ in range(rounds):
        for name, run in contestants.items():
            start = time.process_time()
            run()
            seconds[name].append(time.process_time() - start)
    return {name: statistics.median(times) for name, times in seconds.items()}


HISTORY_FILE = Path("docs/results/core.jsonl")
figures: dict[str, dict[str, float]] = {}  # milliseconds of contestants, by what they did; for the history


def append_history(entry: dict[str, Any]) -> None:
    """Append a run's figures in milliseconds to the history, with the time and the machine."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    cpu = next((line.split(": ")[1] for line in lines if line.startswith("model name")), platform.processor())
    entry = {"at": time.strftime("%Y-%m-%dT%H:%MZ", time.gmtime()), "cpu": cpu, "torch": torch.__version__, **entry}
    with HISTORY_FILE.open("a") as file:
        file.write(json.dumps(entry) + "\n")


def print_contestants(title: str, seconds: dict[str, float], targets: dict[str, float]) -> None:
    """Print each contestant's milliseconds and how many times as fast as the first contestant it is."""
    print(f"\n{title:44} {'ms':>8} {'times (a)':>10} {'target':>8}")
    first = next(iter(seconds.values()))
    figures[title] = {name: round(1e3 * value, 3) for name, value in seconds.items()}
    for name, value in seconds.items():
        target = f">= {targets[name]:g}" if name in targets else ""
        print(f"  {name:42} {1e3 * value:8.2f} {first / value:10.2f} {target:>8}")


def bench_brdf() -> None:
    """Measure training and adapting with the BRDF network, and print the tables."""
    rng = Generator().manual_seed(0)
    theta = {key: value[0] for key, value in LEARNING_APP.init(rng, 1).items()}
    alpha = {f"rate.{key}": torch.full_like(value, LEARNING_RATE)[None] for key, value in theta.items()}
    batches, last = [draw_batch(LEARNING_SIZE, rng) for _ in range(INNER_STEPS)], draw_batch(LEARNING_SIZE, rng)
    plain_inner = [[one_task(batch, task) for batch in batches] for task in range(BATCH_TASKS)]
    plain_last = [one_task(last, task) for task in range(BATCH_TASKS)]
    batch_supply: list[Iterator[Batch]] = [iter(())]
    loss = Loss(lambda data, rng, done: DrawnBatch((), next(batch_supply[0])), LEARNING_APP.loss)
    first_order_adam = Adam(5e-3, beta2=0.99, eps=META_EPS)
    rules = {
        "sgd": (sgd, alpha),
        "default": (
            rule_of(DEFAULT_RULE).update_rule,
            rule_of(DEFAULT_RULE).initial_alpha(LEARNING_APP, theta, INNER_STEPS, first_order_adam),
        ),
    }

    def plain() -> tuple[Tensor, list[Tensor]]:
        weights = [weight.clone().requires_grad_() for weight in plain_weights(theta)]
        rates = [torch.full_like(weight, LEARNING_RATE, requires_grad=True) for weight in weights]
        total = torch.zeros(())
        for inner, final in zip(plain_inner, plain_last, strict=True):
            total = total + plain_loss(plain_adapt(weights, rates, inner, graph=True), final) / BATCH_TASKS
        return total.detach(), list(torch.autograd.grad(total, [*weights, *rates]))

    def outer_step(make_steps: StepMaker, rule: str = "sgd") -> Callable[[], tuple[Tensor, list[Tensor]]]:
        make, alpha = rules[rule]
        outer_loss = after_learning(loss, make, steps=INNER_STEPS, order=2, make_steps=make_steps)

        def step() -> tuple[Tensor, list[Tensor]]:
            phi = {key: value.clone().requires_grad_() for key, value in MetaParameters(theta, alpha).flatten().items()}
            total = outer_loss.value(phi, (batches, last, None), {}).mean()
            return total.detach(), list(torch.autograd.grad(total, list(phi.values())))

        return step

    def adapt(make_steps: StepMaker, rule: str = "sgd", tasks: int = BATCH_TASKS) -> Callable[[], Params]:
        make, alpha = rules[rule]
        initialisation, rule_steps = expand_tasks(theta, tasks, 0), make(expand_tasks(alpha, tasks, 1))
        task_batches = [{key: value[:tasks] for key, value in batch.items()} for batch in batches]

        def run() -> Params:
            batch_supply[0] = iter(task_batches)
            return learn(initialisation, rule_steps, None, loss, steps=INNER_STEPS, rng=rng, make_steps=make_steps)

        return run

    def plain_one_by_one(graph: bool) -> Callable[[], None]:
        weights = [weight.clone().requires_grad_() for weight in plain_weights(theta)]
        rates = [torch.full_like(weight, LEARNING_RATE) for weight in weights]

        def run() -> None:
            for inner in plain_inner:
                plain_adapt(weights, rates, inner, graph)

        return run

    (value_a, grads_a), (value, grads) = plain(), outer_step(choose_steps)()
    relative_difference = max(
        float((a - b.reshape(a.shape)).norm() / a.norm()) for a, b in zip(grads_a, grads, strict=True)
    )
    peak_gflops = measure_peak_gflops()
    print(
        f"\nBRDF network, {BATCH_TASKS} tasks, {INNER_STEPS} steps of {TASK_SAMPLES} samples; CPU seconds, one thread"
    )
    print(
        f"  loss (a) {float(value_a):.7f}, metapp {float(value):.7f}; "
        f"gradients differ by {relative_difference:.0e} of their norm"
    )
    min_milliseconds = 1e3 * BATCH_TASKS * INNER_STEPS * TASK_SAMPLES * 2 * 1764 / (peak_gflops * 1e9)
    print(f"  limit of the machine: {peak_gflops:.0f} GFLOP/s, adapting not below {min_milliseconds:.2f} ms")
    name, default = "metapp, SGD", f"metapp, {DEFAULT_RULE}"
    contestants: dict[str, Callable[[], Any]] = {
        "(a) plain loop, unrolled": plain,
        "metapp by torch, eager": outer_step(torch_steps),
        "metapp by torch, compiled": outer_step(make_compiled_steps),
        f"metapp by torch, eager, {DEFAULT_RULE}": outer_step(torch_steps, "default"),
        name: outer_step(choose_steps),
        default: outer_step(choose_steps, "default"),
    }
    adapting: dict[str, Callable[[], Any]] = {}
    libraries: dict[str, Callable[..., Any]] = {
        "(b) learn2learn MetaSGD": learn2learn_step,
        "(b) TorchOpt MetaSGD, one rate": torchopt_step,
        "(c) JAX, compiled": jax_steps,
    }
    for title, library in libraries.items():
        try:
            library_runs = library(theta, plain_inner, plain_last)
        except Exception as error:  # an import may fail in many ways
            print(f"  {title}: not installed ({type(error).__name__})")
            continue
        contestants[title], *adapting_runs = library_runs
        if adapting_runs:
            adapting[title] = adapting_runs[0]
        print(f"  {title}: loss {float(contestants[title]()[0]):.7f}")
    print_contestants("second-order training step", median_seconds(contestants), {name: 11, default: 8})
    contestants = {
        "(a) plain loop, one by one": plain_one_by_one(False),
        "the same, with the graph that training needs": plain_one_by_one(True),
        "metapp by torch, eager": adapt(torch_steps),
        "metapp by torch, compiled": adapt(make_compiled_steps),
        f"metapp by torch, eager, {DEFAULT_RULE}": adapt(torch_steps, "default"),
        name: adapt(choose_steps),
        default: adapt(choose_steps, "default"),
        f"one fit alone, {DEFAULT_RULE}": adapt(choose_steps, "default", tasks=1),
        **adapting,
    }
    print_contestants("adapting, no meta-gradient", median_seconds(contestants), {name: 11, default: 8})
    append_history({"gflops": round(peak_gflops, 1), "ms": figures})


# Memory of an outer step


class LiveBytes(TorchDispatchMode):
    """A counter of the bytes of storages that operators made and that are still in use."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.live = self.peak = 0
        self.seen: dict[int, Any] = {}

    @override
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        for tensor in tree_leaves(result):
            if isinstance(tensor, Tensor):
                self._count(tensor.untyped_storage())
        return result

    def _count(self, storage: torch.UntypedStorage) -> None:
        key, size = storage._cdata, storage.nbytes()
        if key in self.seen:
            return

        def forget(_: Any) -> None:
            self.live -= size
            del self.seen[key]

        self.seen[key] = weakref.ref(storage, forget)
        self.live += size
        self.peak = max(self.peak, self.live)


UNET_CHANNELS = (16, 32, 64, 128)  # by level


def init_unet(rng: Generator) -> Params:
    """Draw the weights of one U-Net with 3 channels in and out and two convolutions a level."""
    theta = {}

    def add(name: str, inputs: int, outputs: int) -> None:
        theta[f"{name}.w"] = torch.randn(outputs, inputs, 3, 3, generator=rng) * (2 / (9 * inputs)) ** 0.5
        theta[f"{name}.b"] = torch.zeros(outputs)

    for level, (inputs, outputs) in enumerate(zip((3, *UNET_CHANNELS), UNET_CHANNELS, strict=False)):
        add(f"down{level}", inputs, outputs)
        add(f"deep{level}", outputs, outputs)
    for level in reversed(range(len(UNET_CHANNELS) - 1)):
        add(f"up{level}", UNET_CHANNELS[level + 1] + UNET_CHANNELS[level], UNET_CHANNELS[level])
    add("out", UNET_CHANNELS[0], 3)
    return theta


def apply_unet(theta: Params, x: Tensor) -> Tensor:
    """Apply one U-Net to pictures [N, 3, H, W]."""

    def layer(name: str, x: Tensor) -> Tensor:
        return torch.nn.functional.silu(conv2d(x, theta[f"{name}.w"], theta[f"{name}.b"], padding=1))

    levels = []
    for level in range(len(UNET_CHANNELS)):
        x = layer(f"deep{level}", layer(f"down{level}", x if level == 0 else avg_pool2d(x, 2)))
        levels.append(x)
    for level in reversed(range(len(UNET_CHANNELS) - 1)):
        x = layer(f"up{level}", torch.cat([interpolate(x, scale_factor=2.0), levels[level]], 1))
    return conv2d(x, theta["out.w"], theta["out.b"], padding=1)


def bench_memory(tasks: int = 4, steps: int = 3) -> None:
    """Print the peak memory of an outer step of first and of second order."""
    rng = Generator().manual_seed(0)
    theta = init_unet(rng)
    alpha = {f"rate.{key}": torch.full_like(value, 1e-2)[None] for key, value in theta.items()}
    apply = torch.func.vmap(apply_unet)

    def value(theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        return (apply(theta, batch["photo"]) - batch["target"]).square().mean((1, 2, 3, 4))

    photos = torch.rand(2, tasks, 1, 3, 128, 128, generator=rng)
    batch = {"photo": photos[0], "target": photos[1]}
    loss = Loss(lambda data, rng, done: DrawnBatch((), batch), value)
    weights = sum(tensor.numel() for tensor in theta.values())
    print(f"\nU-Net of {weights:,} weights, {tasks} tasks of 128 x 128 pixels, {steps} steps: peak of live tensors")
    peaks = []
    for order in (1, 2):
        outer_loss = after_learning(loss, sgd, steps=steps, order=order)
        phi = {key: tensor.clone().requires_grad_() for key, tensor in MetaParameters(theta, alpha).flatten().items()}
        with LiveBytes() as counter:
            total = outer_loss.value(phi, ([batch] * steps, batch, None), {}).mean()
            torch.autograd.grad(total, list(phi.values()))
        peaks.append(counter.peak)
        print(f"  order {order}: {counter.peak / 2**20:.1f} MiB, {counter.peak / peaks[0]:.2f} times the first")
    print("  target of second order: <= 1.5 times")


def main() -> None:
    """Print all tables."""
    torch.set_num_threads(1)
    bench_memory()
    bench_kernel()
    bench_brdf()


if __name__ == "__main__":
    main()
