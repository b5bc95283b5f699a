"""Random rooms for the training of guide priors, as Mitsuba 3 scene dictionaries: each kind is lit in another way.

All have the walls and the camera of `cornell`: Cornell boxes; rooms whose lamp shines upwards above a board; with
several lamps on ceiling and walls; lit through a door from a chamber behind a wall; and with small lamps above glass.
"""

from __future__ import annotations

from data_tools.draws import Rng, stream
from data_tools.synthetic import cornell
from data_tools.synthetic.cornell import Scene, diffuse, rectangle
from data_tools.synthetic.draws import between, pick, whole

KINDS = ("box", "board", "lamps", "door", "glass")
_TINT = (1.1, 1.0, 0.9)
_THICK = 0.001  # between the two sides of a board or wall
_POWER = 4.0  # radiance times area of a single lamp
_BLACK = 0.0


def random_room(kind: str, seed: int) -> Scene:
    """A room drawn at random.

    Args:
        kind: one of KINDS.
        seed: of all draws, >= 0.

    Raises:
        ValueError: another kind, a negative seed.
    """
    if kind not in KINDS or seed < 0:
        raise ValueError(f"room: kind {kind}, seed {seed}, expected one of {', '.join(KINDS)} and a seed of 0 or more.")
    rng = stream(seed)
    if kind == "box":
        return cornell.draw_scene(rng)
    scene: Scene = {"type": "scene", "sensor": cornell.sensor()}
    scene |= cornell.walls(cornell.wall_colour(rng), cornell.wall_colour(rng))
    return scene | {"board": _board, "lamps": _lamps, "door": _door, "glass": _glass}[kind](rng)


def _board(rng: Rng) -> Scene:
    """A lamp that shines on the ceiling alone, above a board."""
    right, front = between(rng, 0.12, 0.35), between(rng, 0.12, 0.35)  # half of the sides
    x, z = between(rng, -0.4, 0.4), between(rng, -0.4, 0.4)
    height, wider = between(rng, 0.55, 0.9), between(rng, 1.2, 1.9)
    scene = {"light": _lamp(_level((x, height, z), right, front, down=False), _POWER)}
    for name, below, down in (("board", 0.05, True), ("board, above", 0.05 - _THICK, False)):
        scene[name] = _level((x, height - below, z), right * wider, front * wider, down=down, grey=0.5)
    return scene | _things(rng, whole(rng, 1, 4))


def _lamps(rng: Rng) -> Scene:
    """Two to four lamps of different power on the ceiling and the side walls."""
    scene = {}
    for number in range(whole(rng, 2, 4)):
        half = between(rng, 0.05, 0.2)
        where, power = pick(rng, ("ceiling", "left", "right")), between(rng, 0.3, 3)
        across, along = between(rng, -0.7, 0.7), between(rng, -0.7, 0.7)
        if where == "ceiling":
            lamp = _level((across, 0.985, along), half, half, down=True)
        else:
            side = -1 if where == "left" else 1
            lamp = rectangle((side * 0.985, across, along), (0, 0, side * half), (0, half, 0), diffuse([_BLACK] * 3))
        scene[f"light-{number}"] = _lamp(lamp, power)
    return scene | _things(rng, whole(rng, 1, 5))


def _door(rng: Rng) -> Scene:
    """A wall with an opening, behind which the lamp is, in a chamber that the camera cannot look into."""
    side = pick(rng, (-1, 1))
    x, half = side * between(rng, 0.3, 0.6), between(rng, 0.08, 0.3)
    z, top = between(rng, -0.6, 0.6), between(rng, -0.2, 0.6)
    scene = {}
    for number, (low, high, back, front) in enumerate(
        ((-1.0, 1.0, -1.0, z - half), (-1.0, 1.0, z + half, 1.0), (top, 1.0, z - half, z + half))
    ):
        y, middle, up, along = (low + high) / 2, (back + front) / 2, (high - low) / 2, (front - back) / 2
        for facing in (1, -1):
            place = (x + (_THICK if facing < 0 else 0), y, middle)
            scene[f"wall-{number}, {facing}"] = rectangle(place, (0, 0, facing * along), (0, up, 0), diffuse([0.7] * 3))
    deep, centre = (1 - abs(x)) / 2, side * (1 + abs(x)) / 2
    for name, at, up, grey in (("front", 0.999, -1.0, 0.7), ("front, outside", 1.0, 1.0, 0.3)):
        scene[name] = rectangle((centre, 0, at), (deep, 0, 0), (0, up, 0), diffuse([grey] * 3))
    half = min(0.12, deep - 0.03)
    scene["light"] = _lamp(_level((centre, 0.98, between(rng, -0.5, 0.5)), half, half, down=True), 2 * _POWER)
    balls = [ball for ball in cornell.balls(rng, 6) if abs(ball.centre[0] - x) > ball.radius + 0.02]
    return scene | {f"sphere-{i}": cornell.sphere(ball, cornell.material(rng)) for i, ball in enumerate(balls)}


def _glass(rng: Rng) -> Scene:
    """A small lamp, one to three balls of glass and another ball."""
    half = between(rng, 0.05, 0.12)
    place = (between(rng, -0.6, 0.6), 0.98, between(rng, -0.6, 0.6))
    scene = {"light": _lamp(_level(place, half, half, down=True), _POWER)}
    last = whole(rng, 1, 3)
    for number, ball in enumerate(cornell.balls(rng, last + 1)):
        glass = {"type": "dielectric", "int_ior": between(rng, 1.35, 1.7), "ext_ior": 1.0}
        scene[f"sphere-{number}"] = cornell.sphere(ball, glass if number < last else cornell.material(rng))
    return scene


def _things(rng: Rng, count: int) -> Scene:
    return {
        f"sphere-{i}": cornell.sphere(ball, cornell.material(rng)) for i, ball in enumerate(cornell.balls(rng, count))
    }


def _level(
    centre: tuple[float, float, float], right: float, front: float, *, down: bool, grey: float = _BLACK
) -> Scene:
    """A level rectangle of these half sides that faces up or down."""
    return rectangle(centre, (right, 0, 0), (0, 0, front if down else -front), diffuse([grey] * 3))


def _lamp(shape: Scene, power: float) -> Scene:
    """A rectangle that shines, of this radiance times its area."""
    columns = list(zip(*shape["to_world"], strict=True))
    area = 4 * sum(value**2 for value in columns[0]) ** 0.5 * sum(value**2 for value in columns[1]) ** 0.5
    return {**shape, "emitter": {"type": "area", "radiance": cornell.rgb([power / area * tint for tint in _TINT])}}
