"""Feature statistics: closed forms, gradients, the fixed random filters, and VGG against a loop written by hand."""

import hashlib
import itertools
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import Generator, Tensor
from torch.nn.functional import conv2d, max_pool2d

from metapp.appearance import features
from metapp.appearance.features import (
    IMAGENET_DEVIATION,
    IMAGENET_MEAN,
    RANDOM_FILTER_COUNT,
    VGG_BLOCKS,
    amplitude_spectrum,
    describe_features,
    detail_statistics,
    feature_conditions,
    gram,
    load_features,
    moments,
    statistics_distance,
    tap_channels,
)

DOUBLE = torch.zeros((), dtype=torch.float64)
ANSWER = 0.1988  # of the random filters to a grey picture, their mean
TAPS = ("relu1_2", "relu2_1", "relu4_3", "relu5_1")


@pytest.fixture
def rand(rng: Generator) -> Callable[..., Tensor]:
    return lambda *shape: torch.rand(*shape, generator=rng, dtype=torch.float64)


# Statistics


def test_gram_matrices_in_closed_form(rand: Callable[..., Tensor]) -> None:
    maps = rand(2, 3, 4, 5)
    vgg_by_hand = sum(maps[:, :, None, y, x] * maps[:, None, :, y, x] for y in range(4) for x in range(5)) / 20
    torch.testing.assert_close(gram(maps), vgg_by_hand)


@pytest.mark.parametrize("memory_format", [torch.contiguous_format, torch.channels_last])
def test_gram_matrices_are_twice_differentiable(
    memory_format: torch.memory_format, rand: Callable[..., Tensor]
) -> None:
    maps = rand(2, 3, 4, 5).contiguous(memory_format=memory_format).requires_grad_()
    weights = rand(2, 3, 3)  # not symmetric
    assert torch.autograd.gradcheck(lambda features: gram(features) * weights, (maps,))
    assert torch.autograd.gradgradcheck(lambda features: gram(features) * weights, (maps,))


def test_statistics_distances_are_relative_and_weigh_taps_alike(rand: Callable[..., Tensor]) -> None:
    target = [rand(2, 3, 3), rand(2, 5, 5)]
    assert statistics_distance(target, target).tolist() == [0, 0]
    torch.testing.assert_close(statistics_distance([0 * t for t in target], target), torch.ones(2, dtype=torch.float64))
    torch.testing.assert_close(statistics_distance([1.5 * t for t in target], target), torch.full((2,), 0.5).double())
    found = [rand(2, 3, 3), rand(2, 5, 5)]
    plain = statistics_distance(found, target)
    # neither brightness nor contrast of one tap outweighs the other
    torch.testing.assert_close(statistics_distance([100 * found[0], found[1]], [100 * target[0], target[1]]), plain)
    torch.testing.assert_close(
        (statistics_distance(found[:1], target[:1]) + statistics_distance(found[1:], target[1:])) / 2, plain
    )
    black = [torch.zeros(1, 3, 3, dtype=torch.float64)]
    assert statistics_distance(black, black).tolist() == [0]


def test_moments_are_means_and_root_mean_squares(rand: Callable[..., Tensor]) -> None:
    first, second = rand(2, 3, 4, 4), rand(2, 5, 2, 2)
    found = moments([first, second])
    assert found.shape == (2, 2 * (3 + 5))
    torch.testing.assert_close(found[:, :3], first.mean((2, 3)))
    torch.testing.assert_close(found[:, 3:6], (first**2).mean((2, 3)).sqrt())
    torch.testing.assert_close(found[:, 6:], moments([second]))


def sines(rows: int, columns: int, size: int = 32) -> Tensor:
    """A wave of so many periods down and across a picture, [1, 1, size, size]."""
    y, x = torch.meshgrid(*[torch.arange(size, dtype=torch.float64) / size] * 2, indexing="ij")
    return (math.tau * (rows * y + columns * x) + 0.3).sin()[None, None]


@pytest.mark.parametrize(("rows", "columns"), [(0, 6), (6, 0), (4, 9), (-4, 9), (0, 12)])
def test_a_wave_peaks_at_its_frequency(rows: int, columns: int) -> None:
    found = amplitude_spectrum(sines(rows, columns))[0]
    assert found.shape == (32, 17)
    row, column = divmod(int(found.argmax()), 17)
    assert column == columns
    assert row in (rows % 32, -rows % 32) if columns == 0 else row == rows % 32
    far = (torch.arange(17) - columns).abs() > 4
    assert found[:, far].max() < 0.01 * found.max()


def test_amplitudes_are_amplitudes_wherever_waves_are(rand: Callable[..., Tensor]) -> None:
    """Twice the contrast is twice the amplitude; brightness does not count; channels add their power."""
    maps = rand(2, 3, 16, 16)
    found = amplitude_spectrum(maps)
    torch.testing.assert_close(amplitude_spectrum(2 * maps), 2 * found, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(amplitude_spectrum(maps + 5), found)
    power = sum(amplitude_spectrum(maps[:, i : i + 1]) ** 2 for i in range(3))
    torch.testing.assert_close(found**2, power, rtol=1e-6, atol=1e-7)
    assert amplitude_spectrum(torch.ones(1, 2, 8, 8)).max() < 1e-3
    first, other = sines(5, 3), sines(5, 3).roll((7, 11), (-2, -1))
    assert statistics_distance([amplitude_spectrum(first)], [amplitude_spectrum(other)]) < 0.05
    assert statistics_distance([amplitude_spectrum(first)], [amplitude_spectrum(sines(3, 5))]) > 0.8


def test_many_channels_add_their_power_about(rng: Generator) -> None:
    """The sum of 128 unlike channels by random signs has their power, within the scatter of 8 such sums."""
    maps = torch.randn(1, 128, 32, 32, generator=rng, dtype=torch.float64)
    power = sum(amplitude_spectrum(maps[:, i : i + 1]) ** 2 for i in range(128))
    found = amplitude_spectrum(maps) ** 2
    assert float(found.sum() / power.sum()) == pytest.approx(1, abs=0.1)  # type: ignore[union-attr]
    assert float((found / power).log().abs().mean()) < 0.3


@pytest.mark.parametrize("value", [0.0, 0.5])
def test_gradients_are_finite_for_flat_pictures(value: float) -> None:
    """Gradients are finite for a black picture, a uniform one, and one that equals the exemplar."""
    maps = torch.full((1, 2, 8, 8), value, dtype=torch.float64, requires_grad=True)
    for statistic, target in itertools.product((gram, amplitude_spectrum), (0.0, value, 1.0)):
        expected = statistic(torch.full_like(maps, target))
        (slope,) = torch.autograd.grad(statistics_distance([statistic(maps)], [expected]).sum(), maps)
        assert slope.isfinite().all()


# Random filters


def test_random_filters_are_the_same_every_time(rand: Callable[..., Tensor]) -> None:
    image = rand(2, 3, 16, 16).float()
    first = load_features(TAPS, image)(image)
    assert [tuple(response.shape) for response in first] == [
        (2, RANDOM_FILTER_COUNT, size, size) for size in (16, 8, 4, 2)
    ]
    torch.manual_seed(99)
    features._load_extractor.cache_clear()
    again = load_features(TAPS, image)(image)
    assert all(torch.equal(one, other) for one, other in zip(first, again, strict=True))
    # checkpoints were trained with these: another value makes old ones worthless
    found = load_features(("relu1_1",), image)(torch.full((1, 3, 16, 16), 0.5))[0][0, :, 8, 8]
    torch.testing.assert_close(found.mean(), torch.tensor(ANSWER), rtol=1e-3, atol=0)


# VGG


def random_weights() -> dict[str, Tensor]:
    """Random weights of a network's shapes, about as large as keeps the size of what passes through."""
    rng, weights, inputs = Generator().manual_seed(5), {}, 3
    for layer, outputs in enumerate(itertools.chain(*VGG_BLOCKS)):
        scale = math.sqrt(2 / (9 * inputs))
        weights[f"conv{layer}.weight"] = torch.randn(outputs, inputs, 3, 3, generator=rng) * scale
        weights[f"conv{layer}.bias"] = torch.randn(outputs, generator=rng) * 0.1
        inputs = outputs
    return weights


@pytest.fixture(scope="module")
def vgg16(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of made-up weights, of the true shapes."""
    path = tmp_path_factory.mktemp("weights") / "vgg16.safetensors"
    save_file(random_weights(), path)
    return path


def by_hand(weights: dict[str, Tensor], images: Tensor) -> dict[str, Tensor]:
    """All layers of VGG-16, as its paper lists them: 3x3 convolutions, maximum of 2x2 after each block."""
    mean, deviation = (
        torch.tensor(channel_values)[:, None, None] for channel_values in (IMAGENET_MEAN, IMAGENET_DEVIATION)
    )
    x, found, layer = (images - mean) / deviation, {}, 0
    for block, depth in enumerate((2, 2, 3, 3, 3), 1):
        if block > 1:
            x = max_pool2d(x, 2)
        for i in range(1, depth + 1):
            weight, bias = (weights[f"conv{layer}.{part}"].double() for part in ("weight", "bias"))
            x = conv2d(x, weight, bias, padding=1).clamp_min(0)
            found[f"relu{block}_{i}"] = x
            layer += 1
    return found


@pytest.mark.parametrize("taps", [TAPS, ("relu1_1", "relu1_2", "relu2_2", "relu3_3"), ("relu3_1",)])
def test_vgg_has_the_layers_of_its_paper(
    taps: tuple[str, ...], vgg16: Path, cache: Path, rand: Callable[..., Tensor]
) -> None:
    os.link(vgg16, cache / "vgg16.safetensors")
    image = rand(2, 3, 32, 16)
    network = load_features(taps, image)
    maps, expected = network(image), by_hand(random_weights(), image)
    assert len(maps) == len(taps)
    for tap, tap_maps in zip(taps, maps, strict=True):
        torch.testing.assert_close(tap_maps, expected[tap])
    assert tap_channels(taps) == [tap_maps.shape[1] for tap_maps in maps]
    features._load_extractor.cache_clear()  # 60 MB each


def gradient_of(pictures: Tensor) -> tuple[list[Tensor], list[Tensor]]:
    """Gram matrices of pictures that are descended, and the gradients of their mean squares, each alone."""
    image = pictures.clone().requires_grad_()
    maps = load_features(TAPS[:3], image)(image, reduced=True)
    found = [gram(tap_maps) for tap_maps in maps]
    slopes = [torch.autograd.grad(matrix.square().mean(), image, retain_graph=True)[0] for matrix in found]
    return [matrix.detach() for matrix in found], slopes


@pytest.fixture
def whole_vgg_in_bfloat16(vgg16: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Made-up weights, and a CPU that is said to be made for bfloat16: torch computes it on any."""
    os.link(vgg16, cache / "vgg16.safetensors")
    monkeypatch.setattr(features, "has_bfloat16", lambda: True)
    monkeypatch.delenv(features.FLOAT32_VARIABLE)
    yield
    features._load_extractor.cache_clear()


@pytest.mark.long
@pytest.mark.usefixtures("whole_vgg_in_bfloat16")
def test_bfloat16_statistics_and_gradients_are_float32s(rng: Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    pictures = torch.rand(2, 3, 64, 64, generator=rng)
    found, slopes = gradient_of(pictures)
    monkeypatch.setenv(features.FLOAT32_VARIABLE, "1")
    expected, exact = gradient_of(pictures)
    for first, other in zip(found, expected, strict=True):
        assert first.dtype == torch.float32
        assert 0 < (first - other).norm() < 2**-7 * other.norm()  # each of 10 layers rounds by 2^-9
    allowed = [2**-4, 2**-4, 2**-2]  # ReLUs near 0 and maxima of nearly equal ones change, more so in deep layers
    for in_bfloat16, long, much in zip(slopes, exact, allowed, strict=True):
        assert (in_bfloat16 - long).norm() < much * long.norm()


@pytest.mark.usefixtures("whole_vgg_in_bfloat16")
def test_only_descended_pictures_are_in_bfloat16(rng: Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """All other results are equal bit by bit to those of errors, and float64 is never reduced."""
    pictures = torch.rand(1, 3, 32, 32, generator=rng)
    network = load_features(TAPS, pictures)
    long, descended = network(pictures), pictures.clone().requires_grad_()
    with torch.no_grad():
        result = descended * 1

    def reduced() -> list[Tensor]:
        return load_features(TAPS, pictures)(descended, reduced=True)

    assert {tap_maps.dtype for tap_maps in reduced()} == {torch.bfloat16}
    reduced_steps = {"features": describe_features(), "precision": "VGG in bfloat16"}
    assert feature_conditions(torch.device("cpu")) == reduced_steps
    assert feature_conditions(torch.device("cuda")) == feature_conditions() == {"features": describe_features()}
    precise = descended.double()
    assert {tap_maps.dtype for tap_maps in load_features(TAPS, precise)(precise, reduced=True)} == {torch.float64}
    judged = [network(pictures, reduced=True), network(result, reduced=True), network(descended)]
    monkeypatch.setattr(features, "has_bfloat16", lambda: False)
    assert feature_conditions(torch.device("cpu")) == feature_conditions()
    for maps in (*judged, reduced()):
        assert all(torch.equal(one, other) for one, other in zip(maps, long, strict=True))


def test_weights_are_called_imagenet_where_their_source_is_known(cache: Path) -> None:
    digest = hashlib.sha256(torch.ones(3).numpy().tobytes()).hexdigest()
    path = cache / "vgg16.safetensors"
    for time, notes in enumerate((None, {"sha256": 64 * "0"})):
        save_file({"w": torch.ones(3)}, path, notes)
        os.utime(path, (time, time))
        assert describe_features() == f"VGG-16 features (unknown weights {digest[:8]})"
    os.utime(path, (9, 9))
    own_digest = (digest[:8],)  # the very weights, wherever they came from
    assert describe_features(own_digest) == "VGG-16 features (ImageNet)"


def test_the_weights_of_the_shipped_checkpoints_are_known(vgg_weights: Path) -> None:
    assert describe_features() == "VGG-16 features (ImageNet)"
    save_file(load_file(vgg_weights / "vgg16.safetensors"), vgg_weights / "copy.safetensors")
    # the copy has no notes on the source of the weights
    (vgg_weights / "copy.safetensors").replace(vgg_weights / "vgg16.safetensors")
    assert describe_features() == "VGG-16 features (ImageNet)"


@pytest.mark.parametrize(
    "damage", [{"conv1.bias": None}, {"conv1.weight": torch.zeros(2, 2, 5, 5)}, {"conv2.bias": torch.zeros(4)}]
)
def test_weights_of_another_network_are_refused(damage: dict[str, Tensor | None], cache: Path) -> None:
    weights = {
        f"conv{i}.{part}": torch.zeros(shape)
        for i, outputs, inputs in ((0, 64, 3), (1, 64, 64), (2, 128, 64))
        for part, shape in (("weight", (outputs, inputs, 3, 3)), ("bias", (outputs,)))
    }
    save_file(
        {key: value for key, value in (weights | damage).items() if value is not None}, cache / "vgg16.safetensors"
    )
    (layer,) = (key.split(".")[0] for key in damage)
    expected = f"{layer} missing or of another shape, expected VGG-16; fetch it again: metapp data vgg."
    with pytest.raises(ValueError, match=f"^[^\n]*{expected}$"):
        load_features(("relu2_1",), DOUBLE)


@pytest.mark.parametrize("kept", [0, 4, 100, 0.5, 1 - 1e-6])
def test_damaged_weights_are_refused(kept: float, vgg16: Path, cache: Path) -> None:
    whole = vgg16.read_bytes() if kept else b""
    (cache / "vgg16.safetensors").write_bytes(whole[: int(kept if kept >= 1 else kept * len(whole))])
    for read in (lambda: load_features(("relu1_1",), DOUBLE), lambda: describe_features()):
        with pytest.raises(
            ValueError, match=r"^[^\n]*vgg16.safetensors: damaged, expected the weights of VGG-16; fetch"
        ):
            read()


# The finest detail of pictures


COSINES = 15  # of the 18 numbers, the others are of waves of 2 px with equal phase


def waves(kind: str, size: int = 64) -> torch.Tensor:
    """Waves of 2 px, amplitude 1, in pictures [1, 1, size, size]."""
    sign = 1 - 2 * (torch.arange(size, dtype=torch.float64) % 2)
    shown = {"rows": sign[:, None].expand(size, size), "columns": sign.expand(size, size)}
    shown["checkerboard"] = shown["rows"] * shown["columns"]
    return shown[kind][None, None]


@pytest.mark.parametrize(("kind", "place"), [("rows", 0), ("columns", 1), ("checkerboard", 2)])
def test_each_wave_of_two_pixels_changes_one_statistic(kind: str, place: int) -> None:
    """Equal phase everywhere: the window of 8 px sums all of it, the others nothing."""
    found = detail_statistics(waves(kind))[0, 0, COSINES:]
    expected = torch.full((3,), 1e-5, dtype=torch.float64)
    expected[place] = math.sqrt(8)
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=1e-9)


def test_cosine_waves_hold_all_power_but_that_of_means(rng: Generator) -> None:
    """Parseval: 16 times the variance in squares of 4 px, the mean over squares."""
    picture = torch.rand(2, 3, 12, 16, generator=rng, dtype=torch.float64)
    variances = picture.unfold(-2, 4, 3).unfold(-2, 4, 3).var((-1, -2), unbiased=False).mean((-1, -2))
    power = detail_statistics(picture)[..., :COSINES].square().sum(-1)
    torch.testing.assert_close(power, 16 * variances, atol=1e-6, rtol=1e-6)


def test_gradients_agree_with_finite_differences_and_are_finite_for_flat_pictures(rng: Generator) -> None:
    picture = torch.rand(1, 2, 16, 16, generator=rng, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(detail_statistics, picture)
    grey = torch.full((1, 1, 16, 16), 0.5, requires_grad=True)
    detail_statistics(grey).sum().backward()
    assert grey.grad is not None
    assert bool(grey.grad.isfinite().all())
