"""How sure fits of photographs of light are: their distributions, what is told and drawn of them, calibration."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Generator, Tensor

from data_tools.synthetic.illumination import synthetic_tasks
from metapp.appearance.latlong import directions
from metapp.appearance.photograph import photograph
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.confidence import (
    COLUMNS,
    ROWS,
    STRIPE_RGB,
    SURE_LOG,
    UNSURE_LOG,
    Weibull,
    _area,
    _centred,
    _logs,
    deviations,
    hatched,
)
from metapp.apps.illumination.mirror import photographed
from metapp.learning.app import stack
from metapp.learning.task import Params, Task, Tasks
from metapp.networks.field import LocalField
from metapp.runs.checkpoints import with_checkpoint
from metapp.runs.options import fit_options
from metapp.runs.run import Run
from tests.marked import long

pytestmark = pytest.mark.usefixtures("scene")
SMALL = Illumination(LocalField(16, 32, rows=4, columns=8, code=3, hidden=8, layers=2))


def maps_of(seed: int, count: int = 2) -> Tensor:
    noise = torch.randn(count, 3, ROWS, COLUMNS, generator=Generator().manual_seed(seed))
    return 0.2 + noise.exp()


def even(scale: float, shape: float = 1.0, count: int = 1) -> Weibull:
    return Weibull(torch.full((count, ROWS, COLUMNS), scale), torch.full((count, ROWS, COLUMNS), shape))


def blank(value: int = 0, count: int = 1) -> dict[str, Tensor]:
    """Prepared data of photographs of one value."""
    certain = torch.zeros(count, 2, ROWS, COLUMNS)
    return {"photo": torch.full((count, 3, 64, 64), value, dtype=torch.uint8), "certain": certain}


def off_by(maps: Tensor, target: Tensor) -> Tensor:
    """Absolute differences of log luminance [T, ROWS, COLUMNS] of maps [T, 3, H, W], but for one factor of each map."""
    return _centred(_logs(maps) - _logs(target)).abs()


def covered(spread: Weibull, off: Tensor, share: float) -> Tensor:
    """The part of the sphere [T] that is off by at most the quantile of a share: if calibrated, the share."""
    return ((off <= spread.quantile(share)) * _area(off)).sum((1, 2))


# Distributions


@pytest.mark.parametrize("shape", [0.6, 1.0, 2.5])
def test_draws_are_covered_by_quantiles_of_their_own_distribution(shape: float) -> None:
    drawn = torch.rand(64, ROWS, COLUMNS, generator=Generator().manual_seed(1))
    own = even(0.4, shape, 64)
    off = own.quantile(0.5) / math.log(2) ** (1 / shape) * (-torch.log1p(-drawn)) ** (1 / shape)
    for share in (0.1, 0.5, 0.9):
        assert covered(own, off, share).mean() == pytest.approx(share, abs=0.01)


# What is told and drawn


def test_parts_have_their_own_medians() -> None:
    z = directions(ROWS, COLUMNS)[2]
    spread = Weibull((1 - z)[None] / math.log(2) / 4, torch.ones(1, ROWS, COLUMNS))
    (told,) = deviations(spread, blank())
    means = {"front": 1 / 3, "rim": 1.0, "back": 5 / 3}
    assert told == pytest.approx({name: math.exp(mean / 4) for name, mean in means.items()}, rel=0.01)
    assert deviations(even(0.1), blank(255))[0].keys() == {"front", "rim", "back", "clipped"}
    lost = blank()
    lost["certain"][:, 1, :4] = 1.0
    assert "clipped" in deviations(even(0.1), lost)[0]


def test_the_less_sure_the_wider_the_stripes() -> None:
    gray = torch.full((3, 40, 80), 0.5)
    none, *shares = [
        float((hatched(gray, even(middle / math.log(2))) != 0.5).any(0).float().mean())
        for middle in (SURE_LOG, 0.2, 0.4, UNSURE_LOG, 9.0)
    ]
    assert none == 0
    assert 0 < shares[0] < shares[1] < shares[2] == shares[3] < 0.9
    assert hatched(gray, even(0.1)).shape == (3, 240, 480)
    assert hatched(gray.expand(3, 40, 80).repeat(1, 8, 8), even(0.1)).shape == (3, 320, 640)


def test_stripes_are_where_a_map_is_not_sure() -> None:
    z = directions(ROWS, COLUMNS)[2]
    shown = hatched(torch.full((3, 256, 512), 0.5), Weibull((z < 0)[None] * 2.0 + 1e-3, torch.ones(1, ROWS, COLUMNS)))
    striped = (shown - torch.tensor(STRIPE_RGB)[:, None, None]).abs().amax(0) < 0.2
    assert not striped[:, 160:352].any()  # the middle is the front
    assert striped[:, :96].any()


def test_records_and_pictures_of_photographs_say_it() -> None:
    app = replace(SMALL, protocol="photo")
    light = maps_of(3, 1)[0]
    photo = (photograph(light[None], Generator().manual_seed(1)) * 255).to(torch.uint8)
    alone = Task("alone", {"photos": photo})
    theta = {key: value[0] for key, value in app.init(Generator().manual_seed(0), 1).items()}
    told = app.remarks(alone, theta)["deviation"]
    assert {"front", "rim", "back"} <= told.keys()
    assert min(told.values()) > 1
    picture = app.pictures(theta, alone)["confidence"]
    assert (picture.kind, picture.pixels.shape) == ("srgb", (256, 512, 3))
    assert 0 <= picture.pixels.min() <= picture.pixels.max() <= 1
    known = Task("known", {"photos": photo, "map": light})
    reference = replace(SMALL, protocol="reference")
    assert reference.remarks(known, theta) == {}
    assert "confidence" not in reference.pictures(theta, known)


# Calibration


def fitted(paradigm: str, recipe: str, tasks: Callable[[Illumination], Tasks]) -> tuple[Illumination, Params, Tasks]:
    """Fits by what ships."""
    found = with_checkpoint(Run.of(fit_options("illumination", paradigm, observe="photo", recipe=recipe, quiet=True)))
    assert isinstance(found.app, Illumination)
    made = tasks(found.app)
    theta = found.paradigm.fit(found.phi, made, Generator().manual_seed(0))
    return found.app, theta, made


def drawn(app: Illumination, count: int) -> Tasks:
    return stack(app, list(synthetic_tasks("test", count, 9, app.network.height)))


@pytest.mark.parametrize(
    ("paradigm", "recipe", "count"), [("general", "quick", 24), long("meta", "quick", 48), long("meta", "full", 8)]
)
def test_intervals_hold_what_they_say(paradigm: str, recipe: str, count: int) -> None:
    """On unseen drawn maps photographed as spheres; of few maps at full size only about."""
    app, theta, tasks = fitted(paradigm, recipe, lambda app: drawn(app, count))
    with torch.no_grad():
        spread = app.spread(theta, tasks.data)
        off = off_by(app.answer(theta, tasks.data), tasks.data["map"])
    loose = 2 if count < 24 else 1
    assert covered(spread, off, 0.5).mean() == pytest.approx(0.5, abs=0.1 * loose)
    assert covered(spread, off, 0.9).mean() == pytest.approx(0.9, abs=0.05 * loose)
    # texels that are told to be worse are
    middle = spread.quantile(0.5)
    worst = middle >= middle.flatten(1).quantile(0.75, 1)[:, None, None]
    assert off[worst].mean() > 1.5 * off[~worst].mean()


@pytest.mark.long
@torch.no_grad()
def test_a_mirror_is_sure_of_what_it_shows() -> None:
    def mirrors(app: Illumination) -> Tasks:
        tasks = drawn(app, 16)
        photos, shown = photographed(tasks.data["map"], Generator().manual_seed(0), 64)
        return replace(tasks, data=tasks.data | {"photo": (photos * 255).round().to(torch.uint8)} | shown)

    app, theta, tasks = fitted("general", "quick", mirrors)
    told, hidden = (
        deviations(app.spread(theta, tasks.data | some), tasks.data)
        for some in ({}, {"certain": torch.zeros_like(tasks.data["certain"])})
    )
    assert sum(each["front"] for each in told) < sum(each["front"] for each in hidden)
    lost = [each["clipped"] - each["front"] for each in told if "clipped" in each]
    assert sum(lost) > 0
