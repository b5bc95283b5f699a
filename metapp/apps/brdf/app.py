"""BRDFs on half and difference vectors (paper section 4.1.2): the NBRDF network, or one of learned features."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch
from torch import Generator, Tensor

from metapp.appearance.colour import to_srgb
from metapp.appearance.geometry import half_difference_incident, spread_angles
from metapp.appearance.sphere import environment_scene, reference_scene, shade_sphere
from metapp.appearance.uniform import collapsed_fit, uniform_input
from metapp.apps.brdf import anisotropic
from metapp.apps.brdf.augmentation import SAMPLES, mixed
from metapp.apps.brdf.energy import INCIDENT_RAD, albedo
from metapp.apps.brdf.nbrdf import KNOTS, NBRDF, sample_weights
from metapp.apps.brdf.network import COUNT, BrdfNetwork, network_of, opponent_axes, put_distinct_first, samples_at
from metapp.learning.app import App
from metapp.learning.draws import uniform
from metapp.learning.pictures import Compared, Visible
from metapp.learning.task import Batch, LeastSquares, Params, Task, Tasks, TensorSpec
from metapp.networks.coded import norm

CONDITION_SAMPLES = 1024  # samples that General's encoder reads
DOTS = 1024  # samples that are drawn in pictures, at most
SIDE_PX, DOT_PX = 96, 3  # of a picture of samples and of a sample
EXCESSIVE_ALBEDO = 1.01  # the share of light that a fit may be said to reflect without a note
MANY_SAMPLES = 4096  # different samples, from which on more of them count no more against penalties
MIRROR_DEGREES = 5  # of the half vector from the normal, up to which a pair of directions shows the highlight
SPARSE_SAMPLES = 1024  # samples of a task, up to which its fit is distilled from directions all over the hemisphere


@dataclass(frozen=True)
class Brdf(App):
    """One measured or modelled material a task; of an anisotropic one a network without phi_h fits the mean.

    Attributes:
        network: evaluates materials; it has an encoder of its own.
        conserve: whether fits are brought to reflect no more than they receive.
    """

    network: BrdfNetwork = NBRDF
    conserve: bool = False
    name = "brdf"
    title = "BRDF"
    measure = "mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)| on held-out directions"
    image_measure = "the sphere under an environment map (a sky, a sun, two windows), sRGB, over the pixels it touches"
    tensors: ClassVar = {
        "angles": TensorSpec(("N", 3), low=0.0, high=2 * math.pi),
        "phi_h": TensorSpec(("N",), low=0.0, high=2 * math.pi, optional=True),
        "reflectance": TensorSpec(("N", 3), low=0.0),
        "render": TensorSpec(("H", "W", 4), optional=True),
        "environment": TensorSpec(("h", "w", 4), optional=True),
    }
    scale = 100.0
    single_threaded = compiles = cheap_fits = True

    @property
    def task_parameters(self) -> tuple[str, ...]:
        return self.network.task_parameters

    @property
    def linear_parameter(self) -> str:
        return self.network.linear_parameter

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Return `where` [N, 7], half and difference vector and cos theta_i; `target` [N, 3], log(1 + f cos theta_i).

        For a network that is linear in a parameter also COUNT, a scalar: see :func:`put_distinct_first`.
        """
        angles = task.data["angles"]
        if self.network.anisotropic:
            phi_h = task.data.get("phi_h", anisotropic.random_azimuths(len(angles)).to(angles))
            angles = torch.cat([angles, phi_h[:, None]], 1)
        where = half_difference_incident(angles)
        data = {"where": where.float(), "target": torch.log1p(task.data["reflectance"] * where[:, 6:]).float()}
        return put_distinct_first(data) if self.linear_parameter else data

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw `where` [T, 7, count] and `target` [T, 3, count] from the first half of the samples.

        Tasks for a network that is linear in a parameter have as many different samples as COUNT [T] says, the first
        ones, and a batch has this number, too.
        """
        half = tasks.data["where"].shape[1] // 2
        if not self.linear_parameter:
            return samples_at(tasks, torch.randint(half, (len(tasks), count), generator=rng, device=rng.device))
        every = torch.full((len(tasks.names),), float(half), device=rng.device)  # of tasks for another network
        seen = tasks.data.get(COUNT, every)[tasks.rows]
        return samples_at(tasks, (uniform(rng, len(tasks), count) * seen[:, None]).long()) | {COUNT: seen}

    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Query samples: from the half that fits do not see, of which augmentation leaves out no angle."""
        half = tasks.data["where"].shape[1] // 2
        return samples_at(tasks, half + torch.randint(half, (len(tasks), count), generator=rng, device=rng.device))

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)|, [T].

        A learned `smoothing` s [T] replaces |d| by sqrt(d^2 + s^2) - s, whose curvature at sign changes autodiff sees;
        learned `weights` [T, 8] are log weights of samples at knots over theta_h. The extension `native` has this loss
        in C and knows it by name: change it in a subclass, or in both places.
        """
        where = batch["where"]
        # without the clamp at 0 a network that is too dark still has a gradient; the clamp only ever helps
        d = torch.log1p(self.network.reflectance(theta, where) * where[:, 6:7]) - batch["target"]
        if not learned:
            return d.abs().mean((1, 2))
        off = norm(d, learned).mean(1)
        return (off * sample_weights(where, learned) if "weights" in learned else off).mean(1)

    def least_squares(self, theta: Params, batch: Batch, learned: Params) -> LeastSquares:
        """Return least squares in log(1 + f) that follow the loss, by weights slope^2 / sqrt(d^2 + s^2) of this step.

        Learned powers, `evidence` [T, 2], say how much less against penalties few samples count, and ones that the fit
        so far misses. Penalties hold for luminance and two axes of colour.
        """
        where, target = batch["where"], batch["target"]
        cos = where[:, 6:7]
        features = self.network.features_of(theta, where)
        residual = torch.log1p(torch.expm1(target) / cos.clamp_min(1e-4)) - torch.bmm(theta["last"], features)
        # the derivative of log(1 + f cos theta_i) in log(1 + f)
        slope = 1 - (1 - cos) * torch.exp(-target)
        d = slope * residual
        s = torch.exp(learned["smoothing"])[:, None]
        weights = slope.square().mean(1) / (d.square().mean(1) + s * s).sqrt()
        losses = d.abs().mean((1, 2))
        few, missed = learned["evidence"].unbind(1)
        share = batch[COUNT].clamp(max=MANY_SAMPLES) / MANY_SAMPLES
        strength = share**few * (1 + losses / s[:, 0]) ** -missed
        axes = opponent_axes(features)
        return LeastSquares("last", features, residual, weights * strength[:, None], losses, axes=axes)

    def loss_parameters(self, steps: int) -> Params:
        """Return initial smoothing, and the powers of evidence of least squares, else log weights of samples."""
        parameters = {"smoothing": torch.full((steps,), math.log(0.05))}
        if self.linear_parameter:
            return parameters | {"evidence": torch.tensor([1.0, 0.0]).repeat(steps, 1)}
        return parameters | {"weights": torch.zeros(steps, KNOTS)}

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return self.sample(tasks, rng, CONDITION_SAMPLES)

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Mixtures of these materials, with samples as the network learns from them."""
        return tasks.variants(self.network.augment(mixed(tasks, rng), rng))

    def finish(self, theta: Params) -> Params:
        """Limited to reflecting no more than all, if that is asked for."""
        return self.network.conserved(theta) if self.conserve else theta

    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        half = tasks.data["where"].shape[1] // 2
        where = tasks.data["where"][tasks.rows, half:].transpose(1, 2)
        return self.errors_of(self.network.reflectance(theta, where).clamp_min(0), tasks)

    def remarks(self, task: Task, theta: Params) -> dict[str, object]:
        """State what a reader of the error must know: samples held out, a highlight not seen, phi_h left out, energy.

        `albedo`, of isotropic fits: the share of light that is reflected, the greatest of the channels', from each of
        the angles of `metapp.apps.brdf.energy.INCIDENT_RAD`.
        """
        notes, half = [], len(task.data["angles"]) // 2
        if torch.equal(task.data["angles"][:half], task.data["angles"][half:]):
            notes.append(f"all {half} samples are fitted, none is held out: the error is of these")
        if unseen := describe_unseen_highlight(task.data["angles"][:half]):
            notes.append(unseen)
        if "phi_h" in task.data and not self.network.anisotropic:
            notes.append("anisotropic, fitted as isotropic: phi_h is left out; take --recipe anisotropic")
        notes += uniform_input(task.data["reflectance"].T, "reflectance in 1/sr")
        remarks: dict[str, object] = {}
        if not self.network.anisotropic:
            here = {key: value.cpu() for key, value in theta.items()}
            shares = albedo(functools.partial(self.reflectance, here)).amax(1)
            remarks["albedo"] = [round(share, 4) for share in shares.tolist()]
            if (most := float(shares.amax())) > EXCESSIVE_ALBEDO:
                angle = math.degrees(INCIDENT_RAD[shares.argmax()])
                times = f"{most:.2f} of" if most < 100 else "more than 100 times"  # the exp of what was never seen
                notes.append(f"reflects {times} the light from {angle:.0f} degrees; --conserve limits it")
        return remarks | ({"note": "; ".join(notes)} if notes else {})

    @torch.no_grad()
    def doubts(self, theta: Params, tasks: Tasks) -> list[list[str]]:
        """A fit that is black or the same everywhere, where the material is not."""
        where, target = (tasks.data[key][tasks.rows].transpose(1, 2) for key in ("where", "target"))
        given = torch.expm1(target) / where[:, 6:7].clamp_min(1e-4)
        pairs = zip(self.network.reflectance(theta, where).clamp_min(0), given, strict=True)
        return [collapsed_fit(fit, material) for fit, material in pairs]

    def errors_of(self, answer: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Of reflectance [T, 3, M] at the held-out samples, linear RGB in 1/sr, >= 0."""
        half = tasks.data["where"].shape[1] // 2
        cos = tasks.data["where"][tasks.rows, half:, 6:7].transpose(1, 2)
        target = tasks.data["target"][tasks.rows, half:].transpose(1, 2)
        return {"error": (torch.log1p(answer * cos) - target).abs().mean((1, 2))}

    def evaluated(self, theta: Params, task: Task) -> Task:
        """The fit's own reflectance at the task's angles, all over the hemisphere if it has few.

        Raises:
            ValueError: the fit is anisotropic.
        """
        self.require_isotropic(task.name, "the NBRDF network")
        angles = task.data["angles"]
        if len(angles) <= SPARSE_SAMPLES:
            angles = spread_angles(SAMPLES)
        return task._replace(data=task.data | {"angles": angles, "reflectance": self.reflectance(theta, angles)})

    def reflectance(self, theta: Params, angles: Tensor) -> Tensor:
        """Reflectance as of `BrdfNetwork.evaluate`."""
        return self.network.evaluate(theta, angles)

    def require_isotropic(self, subject: str | Path, form: str) -> None:
        """Refuse to write a fit in a form that has no phi_h.

        Raises:
            ValueError: the fit is anisotropic.
        """
        if self.network.anisotropic:
            raise ValueError(
                f"{subject}: an anisotropic fit, expected an isotropic one: {form} has no phi_h; export bsdf or "
                "mitsuba, or fit by --recipe full."
            )

    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """The sphere, on black with coverage; of a material known by samples alone these and the fit's values there."""
        scene = reference_scene(azimuths=True) if "phi_h" in task.data else reference_scene()
        evaluate = functools.partial(network_of(theta).evaluate, theta)
        fit = shade_sphere(scene, evaluate)
        if "render" in task.data:
            return {"reference": task.data["render"], "fit": fit}
        angles, reflectance = task.data["angles"][-DOTS:], task.data["reflectance"][-DOTS:]  # those held out
        four = torch.cat([angles, task.data["phi_h"][-DOTS:, None]], 1) if "phi_h" in task.data else angles
        return {"samples": _dots(angles, reflectance), "predicted": _dots(angles, evaluate(four)), "fit": fit}

    def compared(self, theta: Params, task: Task) -> Compared | None:
        """The sphere under the environment map; None if a data set was made before it had such pictures."""
        if "environment" not in task.data:
            return None
        scene = environment_scene(azimuths="phi_h" in task.data)
        fit = shade_sphere(scene, functools.partial(network_of(theta).evaluate, theta))
        return Compared(_on_white(fit), _on_white(task.data["environment"]), scene.mask)

    def visible(self, task: Task) -> Visible:
        """The first half of the samples, three angles and a colour each."""
        angles, reflectance = task.data["angles"], task.data["reflectance"]
        return Visible(len(angles) // 2, angles[0].nbytes + reflectance[0].nbytes, CONDITION_SAMPLES)


def describe_unseen_highlight(angles: Tensor) -> str:
    """Return a line that no sample lies near a mirror direction, or "" if one does.

    Without such a sample the height of the highlight is a guess, which the error on other samples does not show.

    Args:
        angles: theta_h first, [N, 3 or 4] in rad, of the samples that a fit sees.

    >>> describe_unseen_highlight(torch.tensor([[0.3, 0.1, 0.0]])).partition("; ")[0]
    'highlight: no sample within 5 degrees of mirror directions, the nearest at 17'
    >>> describe_unseen_highlight(torch.tensor([[0.01, 0.1, 0.0]]))
    ''
    """
    nearest = math.degrees(float(angles[:, 0].amin()))
    if nearest <= MIRROR_DEGREES:
        return ""
    return (
        f"highlight: no sample within {MIRROR_DEGREES} degrees of mirror directions, the nearest at {nearest:.0f}; its "
        "height is that of training materials"
    )


def _dots(angles: Tensor, reflectance: Tensor) -> Tensor:
    """Draw samples in the half-vector plane: theta_h from left to right, by its root, theta_d from the bottom up.

    Args:
        angles: theta_h, theta_d, phi_d [N, 3] in rad.
        reflectance: linear RGB [N, 3] in 1/sr.

    Returns:
        [SIDE_PX, SIDE_PX, 4], pi f as linear RGB on black, and coverage.
    """
    picture = reflectance.new_zeros(SIDE_PX, SIDE_PX, 4)
    shares = angles[:, :2] / (math.pi / 2)
    last = SIDE_PX - DOT_PX
    x, y = (last * torch.stack([shares[:, 0].sqrt(), 1 - shares[:, 1]])).round().long().clamp(0, last)
    colour = torch.cat([math.pi * reflectance, torch.ones_like(reflectance[:, :1])], 1)
    for row, column in itertools.product(range(DOT_PX), repeat=2):
        picture[y + row, x + column] = colour
    return picture


def _on_white(linear: Tensor) -> Tensor:
    """Linear RGB on black with coverage, [H, W, 4], as sRGB [1, 3, H, W] on white."""
    return torch.from_numpy(to_srgb(linear)).to(linear).permute(2, 0, 1)[None]
