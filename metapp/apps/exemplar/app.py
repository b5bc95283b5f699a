"""Applications that generate, from noise, a picture with the visual statistics of an exemplar photograph."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, interpolate, leaky_relu

from metapp.appearance.features import channels_of, detail, feature_conditions, load_features, moments, softness
from metapp.learning.app import App
from metapp.learning.draws import normal, uniform
from metapp.learning.recipe import Recipe
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.networks.coded import encoder_of, with_decoder
from metapp.networks.generators import Pyramid, UNet
from metapp.networks.layout import as_input, layouts, quilted_layout

Crop = Callable[[Tensor], Tensor]
HIDDEN_UNITS = 128
SOFTNESS = 0.2  # weight in the loss of how far the finest detail is from the exemplar's
JUDGED_PICTURES = 4


def with_detail(recipe: Recipe, side: int) -> Recipe:
    """A recipe for exemplars of another side in px: that of training, or, with a layout, twice that.

    Raises:
        ValueError: its application has no such choice.
    """
    app, sides = recipe.app, tuple[int, ...]()
    assert isinstance(app, ExemplarApp)
    if app.has_layout:
        trained = app.width >> app.finer
        sides = (trained, 2 * trained)
    if side not in sides:
        expected = f"one of {', '.join(map(str, sides))}" if sides else "no choice; take another recipe"
        raise ValueError(f"expected {expected}")
    finer = sides.index(side)
    height = (app.height >> app.finer) << finer
    return replace(recipe, app=replace(app, height=height, width=side, finer=finer))


@dataclass(frozen=True)
class ExemplarApp(App):
    """A generator of pictures from noise, fitted to the statistics of one photograph a task.

    General's encoder is a network from a summary of the photograph's features to the generator's code z; the
    generator's other parameters are then the same for all tasks.

    Attributes:
        network: the generator.
        height, width: texels of the exemplar and of generated pictures in training.
        taps: the layers of VGG-16 whose statistics are compared.
        octaves: sizes at which they are, each half of the one before (Snelgrove 2017); each finer one leaves out the
            deepest layer of the one below, so that deep layers see large structures at little cost.
        shares: of its steps up to which a descent sees the coarsest octave alone, the two coarsest, and so on; () if
            it sees all from the beginning. A `Pyramid` makes small pictures, too.
        prior: weight in the loss of the distance of maps from General's, if an application makes several
            that one picture does not tell apart.
        finer: octaves by which exemplars are finer than those of training; layouts, which hold the
            structures that are larger in texels then, stay as they are.
    """

    network: UNet | Pyramid = field()
    height: int = field()
    width: int = field()
    taps: tuple[str, ...] = field()
    octaves: int = 1
    shares: tuple[float, ...] = ()
    prior: float = 0.0
    finer: int = 0
    reduced: ClassVar[bool] = False  # whether fits see features in reduced precision
    described: ClassVar[tuple[str, ...]] = ("gram",)  # what is known of each map of features: gram0, gram1, ...

    @property
    def read_size(self) -> int:
        return self.width if self.finer else 0

    def taps_of(self, octave: int) -> int:
        """The number of layers that are compared at an octave, 0 the finest."""
        return len(self.taps) - (self.octaves - 1 - octave)

    def maps_from(self, octave: int) -> int:
        """The number of maps of features from an octave to the coarsest."""
        return sum(self.taps_of(each) for each in range(octave, self.octaves))

    def parts(self, maps: list[Tensor], octave: int) -> list[Tensor]:
        """The maps that a summary has parts of: if finer octaves are not seen, the finest one stands for them."""
        finest = maps[self.maps_from(octave + 1) :]
        return maps + [each for finer in reversed(range(octave)) for each in finest[: self.taps_of(finer)]]

    @property
    def has_layout(self) -> bool:
        """True if the network reads a layout."""
        return isinstance(self.network, Pyramid) and self.network.layout > 0

    @property
    def layout_size(self) -> tuple[int, int]:
        """Height and width of layouts: twice those of the coarsest pictures in training, if there are finer ones."""
        octave = max(0, self.octaves - 2) + self.finer
        return self.height >> octave, self.width >> octave

    def layout_ratio(self, octave: int) -> float:
        """The ratio of the sides of an octave's pictures to those of their layouts."""
        return (self.height >> octave) / self.layout_size[0]

    def conditions(self, device: torch.device | None = None) -> dict[str, str]:
        return feature_conditions(device if self.reduced else None)

    def features(self, images: Tensor, octave: int, crop: Crop | None = None) -> list[Tensor]:
        """Features [B, C, H', W'] of images [B, 3, H, W] of the size of an octave, those of the coarsest one first.

        Those of a descent are in reduced precision if the application's are, and those of the finest
        octave, which take the longest, of crops of the images by `crop`.
        """
        features, maps = load_features(self.taps, images), []
        for coarser in reversed(range(octave, self.octaves)):
            times = 2 ** (coarser - octave)
            some = avg_pool2d(images, times) if times > 1 else images
            some = crop(some) if crop and coarser == 0 else some
            maps += features(some, self.taps_of(coarser), reduced=self.reduced)
        return maps

    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """All that fitting and encoding need of exemplars of the size of an octave, those of coarser ones first.

        Args:
            exemplars: [B, 3, h, w], sRGB in [0, 1].
            octave: 0 for the whole size.

        Returns:
            The statistics `described` of each map, such as `gram0`, and `summary` [B, S].
        """
        raise NotImplementedError

    def summary(self, maps: list[Tensor], octave: int) -> Tensor:
        """The encoder's input [B, S]: means and root mean squares of features."""
        return moments(self.parts(maps, octave))

    def summary_size(self) -> int:
        """S, the length of the encoder's input."""
        channels = channels_of(self.taps)
        return 2 * sum(sum(channels[: self.taps_of(octave)]) for octave in range(self.octaves))

    def octave(self, data: Mapping[str, Tensor]) -> int:
        """The finest octave that data of tasks describe, 0 for the whole size."""
        counts = [self.maps_from(octave) for octave in range(self.octaves)]
        return counts.index(sum(key.startswith("gram") for key in data))

    def stage(self, tasks: Tasks, done: float) -> Tasks:
        """From coarse to fine: at first statistics of the coarsest octave alone."""
        coarse = sum(done < share for share in self.shares)
        if not coarse:
            return tasks
        finer = range(self.maps_from(coarse), self.maps_from(0))
        left_out = {f"{name}{i}" for name in self.described for i in finer}
        return replace(tasks, data={key: value for key, value in tasks.data.items() if key not in left_out})

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """`image` uint8 [3, S, S], and statistics of the exemplar in it.

        Raises:
            ValueError: the picture is smaller than finer exemplars than those of training.
        """
        image, side = task.data["image"], self.width
        if self.finer and image.shape[-1] < side:
            raise ValueError(f"{task.name}: {image.shape[-1]} px a side, --detail {side} expects {side}; leave it out.")
        exemplar = self.exemplar(image[None].float() / 255)
        return {"image": image} | {key: value[0] for key, value in self.targets(exemplar).items()}

    def targets(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """All that fits compare with, of exemplars [B, 3, h, w]: `describe` and, if networks read layouts, two more.

        `layout` [B, 3, h, w] is a coarse picture that tiles, quilted of the exemplar; `detail` [B, 3, N].
        """
        described = self.describe(exemplars, octave)
        if not self.has_layout:
            return described
        layouts = [quilted_layout(each, self.layout_size) for each in self.evenly_lit(exemplars, described)]
        return described | {"layout": torch.stack(layouts), "detail": detail(exemplars)}

    def evenly_lit(self, pictures: Tensor, described: Batch) -> Tensor:
        """Pictures [B, 3, H, W] under the light of exemplars as if it were the same everywhere; here as they are."""
        return pictures

    def task_parameters(self, tasks: Tasks) -> Params:
        """The layouts, if the network reads one."""
        return {"layout": tasks.data["layout"][tasks.rows]} if self.has_layout else {}

    def made(self, theta: Params, noise: Tensor, octave: int = 0) -> Tensor:
        """The network's output from noise [T, B, outputs, H, W], before any range is imposed; it tiles."""
        network = self.network
        if not isinstance(network, Pyramid):
            return network(theta, noise)
        network = network._replace(finest=octave)
        if not self.has_layout:
            return network(theta, noise)
        return network(theta, noise, as_input(layouts(theta["layout"], noise, self.layout_ratio(octave)), noise))

    def exemplar(self, images: Tensor, octave: int = 0) -> Tensor:
        """The part of square images [B, 3, S, S] that has the recipe's proportions, resampled to an octave's size."""
        rows = round(images.shape[-1] * self.height / self.width)
        top = (images.shape[-2] - rows) // 2
        size = (self.height >> octave, self.width >> octave)
        part = images[..., top : top + rows, :]
        return interpolate(part, size=size, mode="area" if part.shape[-2] >= size[0] else "bilinear")

    def init(self, rng: Generator, count: int) -> Params:
        theta = self.network.init(rng, count)
        if self.has_layout:
            theta["layout"] = torch.zeros(count, 3, *self.layout_size, device=rng.device)
        return theta

    def noise(self, rng: Generator, tasks: int, count: int, octave: int = 0) -> Tensor:
        """Standard normal [tasks, count, C, h, w], as high and wide as the pictures of an octave."""
        size = (self.height >> octave, self.width >> octave)
        return normal(rng, tasks, count, self.network.noise, *size)

    def fixed_noise(self, like: Tensor, count: int, *, seed: int = 0, octave: int = 0) -> Tensor:
        """Noise that is the same for all tasks and no fit draws, [tasks, count, C, h, w].

        Args:
            like: a tensor with one entry a task, on the device that noise is to be on.
            count: of pictures of each task.
            seed: of the draw.
            octave: that pictures are as large as, 0 for the whole size.
        """
        rng = Generator(like.device).manual_seed(seed)
        return self.noise(rng, 1, count, octave=octave).expand(len(like), -1, -1, -1, -1)

    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Any:
        """The pictures or maps [T, B, ...] that `errors_of` judges, from noise [T, B, C, H, W] of an octave's size."""
        raise NotImplementedError

    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """`errors_of` pictures from noise that no fit draws, the same for all."""
        return self.errors_of(self.generate(theta, self.fixed_noise(tasks.rows, JUDGED_PICTURES)), tasks)

    @abstractmethod
    def errors_of(self, answer: Any, tasks: Tasks) -> dict[str, Tensor]:
        """Measure pictures or maps [T, B, ...] that need not come from the network, [T]."""

    def look(self, answer: Any, described: Batch) -> Tensor:
        """The pictures [T, B, 3, H, W] of an answer, as of `errors_of`, under the light of its exemplars."""
        pictures: Tensor = answer
        return pictures

    def softness(self, pictures: Tensor, batch: Batch) -> Tensor:
        """Part of a loss [T]: how far the detail of pictures [T, B, 3, H, W] is from the exemplars'.

        0 of pictures of coarser octaves, and if networks read no layout.
        """
        if not self.has_layout or self.octave(batch):
            return pictures.new_zeros(len(pictures))
        return SOFTNESS * softness(detail(pictures), batch["detail"][:, None]).mean(1)

    def init_encoder(self, rng: Generator) -> Params:
        encoder = encoder_of({}, self.network.init(rng, 1), ("z",))
        sizes = (self.summary_size(), HIDDEN_UNITS, HIDDEN_UNITS, self.network.code)
        for layer in (1, 2, 3):
            inputs, outputs = sizes[layer - 1], sizes[layer]
            noise = normal(rng, outputs, inputs)
            encoder[f"mlp{layer}.w"] = noise * math.sqrt(2 / inputs)
            encoder[f"mlp{layer}.b"] = torch.zeros(outputs, device=rng.device)
        return encoder

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return {"summary": tasks.data["summary"][tasks.rows]} | self.task_parameters(tasks)

    def encode(self, encoder: Params, condition: Batch) -> Params:
        x = torch.log(condition["summary"] + 0.01) / 2  # features are heavy-tailed
        for layer in (1, 2, 3):
            x = x @ encoder[f"mlp{layer}.w"].T + encoder[f"mlp{layer}.b"]
            x = leaky_relu(x, 0.2) if layer < 3 else x
        return with_decoder({"z": x} | {key: condition[key] for key in ("layout",) if key in condition}, encoder)

    def crop(self, image: Tensor, rng: Generator) -> Tensor:
        """A part [3, s, s] of an image [3, S, S] that could have been photographed as well; here all of it."""
        return image

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """These exemplars cropped, flipped, transposed and with their channels permuted, at random."""
        count, octave = len(tasks), self.octave(tasks.data)
        exemplars = []
        for row, flip, turn in zip(tasks.rows, *uniform(rng, 2, count).tolist(), strict=True):
            image = self.crop(tasks.data["image"][row].float() / 255, rng)
            image = image.flip(-1) if flip < 0.5 else image
            exemplars.append(self.exemplar((image.mT if turn < 0.5 else image)[None], octave))
        channels = uniform(rng, count, 3).argsort(1)[..., None, None]
        images = torch.cat(exemplars)
        images = images.gather(1, channels.expand(images.shape))
        return tasks.variants(self.targets(images, octave) | self.carried(tasks, channels[..., 0, 0]))

    def carried(self, tasks: Tasks, channels: Tensor) -> dict[str, Tensor]:
        """Further data of these exemplars, once their channels are those [T, 3] of before."""
        return {}
