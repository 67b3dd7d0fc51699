"""What a forecast is worth to a robot among people who react to it: `python -m studies.driving`.

`python -m studies.driving run OUT.csv [EPISODES]` drives, and goes on where it stopped;
`python -m studies.driving table OUT.csv` prints the tables, and
`python -m studies.driving draw OUT.csv FIGURE.png` draws the curves.

Protocol, written before the run:

- **Hall.** 10 m by 10 m with 12 people, who walk from side to side at 0.9 to 1.5 m/s by
  the social force model of `simulation.social_force`. They react to the robot as to
  another person. An episode is a seed from 0 to 199.
- **Paired.** Starts, goals, paces, wobble and errors of tracking are the same for every
  belief of an episode, until people react to another robot.
- **Robot.** It crosses the hall, 9 m, at up to 1 m/s. Every 0.4 s it takes the best of
  73 velocities. It sees everybody ten times a second, with errors of 5 cm and true ids.
- **Plan.** A velocity costs the way that is left at best, in units of what the robot can
  go in 3.2 m, and `weight` times the probability of coming within `margin` of somebody
  in the next eight steps of 0.4 s; each later step counts 0.85 of the one before.
- **Beliefs.** People stand; they go on at the velocity of the last 0.8 s, exactly, or with
  20 headings off by 10 or 25 degrees (standard deviations; 25 is that of Schöller et al.);
  and of `recommended` the central forecast, the 20 samples with their probabilities, and
  the 20 draws.
- **Sweep.** Every belief has the weights 0.5 to 8 at a margin of 0.7 m. A single forecast
  cannot trade time for risk by a weight above 1, so constant velocity and the central
  forecast have wider margins too, at weight 4.
- **Outcome.** Risk is the share of episodes in which robot and a person come nearer than
  0.7 m, centre to centre; time is seconds to the goal, 40 at most.
- **Test.** A crossing costs its seconds and a price for a pass below 0.7 m, of 5, 20 or 80 s.
  Each belief takes its best weight and margin by the even seeds; costs are compared on the
  odd seeds, in pairs, against constant velocity and against constant velocity with
  headings off by 25 degrees. Intervals are 95 % of a bootstrap over episodes. The draws
  with a price of 20 s are the main comparison; others are beside it.
"""

import copy
import csv
import sys
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.plotting.style import (
    COLUMN,
    PALETTE,
    add_legend,
    dress,
    new_figure,
    save_figure,
)
from neurosym_jax.simulation.social_force import (
    ANTICIPATION,
    BEHIND,
    BODY,
    CONTACT,
    HALF_VIEW,
    RANGE,
    RELAXATION,
    REPULSION,
    TOP_SPEED,
    TOUCH,
)
from neurosym_robot.online.predictor import Predictor, load_models
from neurosym_robot.online.replay import straight
from neurosym_robot.online.window import Window

__all__ = ["BELIEFS", "SETTINGS", "Crowd", "cross", "main", "plan", "read"]

EPISODES = 200
PEOPLE, SIDE = 12, 10.0
START, GOAL = np.array([0.5, 5.0]), np.array([9.5, 5.0])
FRAME, SUBSTEPS = 0.1, 2
BEFORE, LONGEST = 100, 400
"""Frames before the robot starts, and at most after it."""
NOISE = 0.05
"""Metres: standard deviation of a tracked position."""
PERIOD, EVERY, STEPS = 0.4, 4, 8
NEAR = 0.7
"""Metres between two centres below which a pass is a risk."""
FADE = 0.85
ANGLES = np.linspace(0, 2 * np.pi, 24, endpoint=False)
WAYS = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
VELOCITIES = np.concatenate([np.zeros((1, 2)), WAYS / 3, 2 * WAYS / 3, WAYS])
WOBBLE, WOBBLE_TIME = 0.15, 1.5
"""Radians by which headings are off, and seconds for which they are."""
PRICES = (5.0, 20.0, 80.0)
"""Seconds that a pass below `NEAR` costs."""
LATEST = 16.0
"""Seconds up to which curves are drawn."""

Belief = tuple[np.ndarray, np.ndarray]
"""Futures [k, N, STEPS, 2] of everybody and their probabilities [k]."""


class Setting(NamedTuple):
    """A point of a belief's curve."""

    belief: str
    weight: float
    margin: float


class Outcome(NamedTuple):
    """An episode."""

    least: float  # metres between robot and a person
    seconds: float
    way: float  # metres that the robot went


class Crowd:
    """People who walk from side to side, and react to each other and to a robot."""

    def __init__(self, seed: int):
        """Anywhere in the hall, on their way."""
        rng = np.random.default_rng([seed, 3])
        self.position = rng.uniform(1, SIDE - 1, (PEOPLE, 2))
        self.velocity = np.zeros((PEOPLE, 2))
        self._pace = rng.uniform(0.9, 1.5, PEOPLE)
        self._goals = np.array([_goals(rng) for _ in range(PEOPLE)])
        self._leg = np.zeros(PEOPLE, int)
        self._kicks = rng.normal(size=(BEFORE + LONGEST + EVERY, PEOPLE))
        self._wobble = self._kicks[0]
        self._frame = 0
        self.noise = NOISE * rng.normal(size=(*self._kicks.shape, 2))
        """[F, P, 2] metres, errors of tracking."""

    def step(self, robot: np.ndarray, velocity: np.ndarray) -> None:
        """Go on for a `FRAME`, while the robot moves on at its velocity."""
        keep = np.exp(-FRAME / WOBBLE_TIME)
        kick = np.sqrt(1 - keep**2) * self._kicks[self._frame]
        self._wobble = keep * self._wobble + kick
        self._frame += 1
        for n in range(SUBSTEPS):
            place = robot + velocity * FRAME * n / SUBSTEPS
            self._move(place, velocity, FRAME / SUBSTEPS)

    def _move(self, robot: np.ndarray, robot_velocity: np.ndarray, dt: float) -> None:
        people = np.arange(PEOPLE)
        way = self._goals[people, self._leg] - self.position
        arrived = np.hypot(*way.T) < 0.5
        self._leg = (self._leg + arrived) % self._goals.shape[1]
        heading = np.arctan2(way[:, 1], way[:, 0]) + WOBBLE * self._wobble
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        force = (self._pace[:, None] * ahead - self.velocity) / RELAXATION
        others = np.vstack([self.position, robot])
        velocities = np.vstack([self.velocity, robot_velocity])
        force += repulsion(self.position, self.velocity, ahead, others, velocities)
        self.velocity = self.velocity + dt * force
        speed = np.hypot(*self.velocity.T)
        self.velocity /= np.maximum(speed / (TOP_SPEED * self._pace), 1)[:, None]
        self.position = np.clip(self.position + dt * self.velocity, 0.25, SIDE - 0.25)


def _goals(rng: np.random.Generator) -> np.ndarray:
    """[40, 2] places near the sides, each on another side than the one before."""
    sides = [rng.integers(4)]
    for _ in range(39):
        sides.append((sides[-1] + rng.integers(1, 4)) % 4)
    along = rng.uniform(1, SIDE - 1, 40)
    places = np.array([[1.0, 0], [SIDE - 1, 0], [0, 1.0], [0, SIDE - 1]])[sides]
    places[np.arange(40), (np.array(sides) < 2).astype(int)] = along
    return places


def repulsion(
    position: np.ndarray,
    velocity: np.ndarray,
    ahead: np.ndarray,
    others: np.ndarray,
    velocities: np.ndarray,
) -> np.ndarray:
    """[P, 2] acceleration of people by `others` [P + 1, 2], the first P of whom they are.

    The gradient of the potential of `simulation.social_force`, written out.
    """
    offset = position[:, None] - others
    stride = (velocities - velocity[:, None]) * ANTICIPATION
    distance = np.linalg.norm(offset, axis=-1) + 1e-4
    later = np.linalg.norm(offset - stride, axis=-1) + 1e-4
    major = distance + later
    square = major**2 - (stride**2).sum(axis=-1)
    minor = 0.5 * np.sqrt(np.maximum(square, 1e-4))
    gradient = offset / distance[..., None] + (offset - stride) / later[..., None]
    size = REPULSION / RANGE * np.exp((BODY - minor) / RANGE) * major / (4 * minor)
    seen = -(offset * ahead[:, None]).sum(axis=-1) >= distance * np.cos(HALF_VIEW)
    size *= np.where(seen, 1.0, BEHIND)
    size += CONTACT * np.maximum(TOUCH - distance, 0) / 2
    people = np.arange(len(position))
    size[people, people] = 0
    return (size[..., None] * gradient).sum(axis=1)


def plan(robot: np.ndarray, belief: Belief, weight: float, margin: float) -> np.ndarray:
    """[2] the best velocity of the robot."""
    futures, probability = belief
    ahead = PERIOD * np.arange(1, STEPS + 1)[:, None]
    places = robot + VELOCITIES[:, None] * ahead
    left = np.linalg.norm(places - GOAL, axis=-1).min(axis=1)
    offset = places[:, None, None] - futures  # [V, k, N, STEPS, 2]
    near = (np.square(offset).sum(axis=-1) < margin**2).any(axis=2)
    risk = (near * FADE ** np.arange(STEPS)).max(axis=2) @ probability
    return VELOCITIES[np.argmin(left / (PERIOD * STEPS) + weight * risk)]


def _now(window: Window) -> np.ndarray:
    """[P, 2, 2] where everybody was 0.4 s ago, at the mean velocity of the last 0.8 s, and is."""
    people = np.arange(PEOPLE)
    times = window.stamp - np.array([2 * PERIOD, 0.0])
    before, now = window.resampled(people, times).swapaxes(0, 1)
    return np.stack([(before + now) / 2, now], axis=1)


def standing(predictor: Predictor) -> Belief:
    """People stay where they are."""
    now = _now(predictor.window)[:, 1:]
    return np.repeat(now, STEPS, axis=1)[None], np.ones(1)


def constant_velocity(predictor: Predictor) -> Belief:
    """People go straight on."""
    return straight(_now(predictor.window), STEPS)[None], np.ones(1)


def with_headings(degrees: float) -> Callable[[Predictor], Belief]:
    """Straight on, with 20 headings that are off; the same ones in all frames."""
    turns = np.radians(degrees) * np.random.default_rng(0).normal(size=(20, PEOPLE))
    cos, sin = np.cos(turns), np.sin(turns)
    turn = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)

    def believe(predictor: Predictor) -> Belief:
        now = _now(predictor.window)
        way = straight(now, STEPS) - now[:, 1:]
        futures = now[:, 1:] + np.einsum("knij,ntj->knti", turn, way)
        return futures, np.full(20, 1 / 20)

    return believe


def central(predictor: Predictor) -> Belief:
    """The most probable sample of `recommended`."""
    (result,) = predictor.forecast().models.values()
    return result.samples[result.central, None, :, :STEPS], np.ones(1)


def samples(predictor: Predictor) -> Belief:
    """The samples of `recommended`, which cover what may happen, and their probabilities."""
    (result,) = predictor.forecast().models.values()
    return result.samples[:, :, :STEPS], result.weights


def draws(predictor: Predictor) -> Belief:
    """The equally probable draws of `recommended`."""
    (result,) = predictor.forecast().models.values()
    return result.draws[:, :, :STEPS], np.full(20, 1 / 20)


BELIEFS: Mapping[str, Callable[[Predictor], Belief]] = {
    "people stand": standing,
    "constant velocity": constant_velocity,
    "constant velocity, headings ± 10°": with_headings(10),
    "constant velocity, headings ± 25°": with_headings(25),
    "central forecast": central,
    "samples with probabilities": samples,
    "20 draws": draws,
}
SINGLE = ("constant velocity", "central forecast")
PEERS = ("constant velocity", "constant velocity, headings ± 25°")
WEIGHTS = (0.5, 1.0, 2.0, 4.0, 8.0)
MARGINS = (0.85, 1.0, 1.2, 1.5)
SETTINGS = [Setting(name, weight, NEAR) for name in BELIEFS for weight in WEIGHTS]
SETTINGS += [Setting(name, 4.0, margin) for name in SINGLE for margin in MARGINS]


def begin(seed: int, window: Window) -> Crowd:
    """The crowd when the robot starts, which `window` has watched."""
    crowd = Crowd(seed)
    for frame in range(BEFORE):
        window.push(
            frame * FRAME, np.arange(PEOPLE), crowd.position + crowd.noise[frame]
        )
        crowd.step(START, np.zeros(2))
    return crowd


def cross(crowd: Crowd, predictor: Predictor, setting: Setting) -> Outcome:
    """Drive the robot through a crowd that goes on from `begin`."""
    believe = BELIEFS[setting.belief]
    robot, velocity = START.copy(), np.zeros(2)
    least, way, frame = np.inf, 0.0, 0
    while frame < LONGEST and np.linalg.norm(robot - GOAL) >= 0.5:
        number = BEFORE + frame
        seen = crowd.position + crowd.noise[number]
        predictor.window.push(number * FRAME, np.arange(PEOPLE), seen)
        if frame % EVERY == 0:
            belief = believe(predictor)
            velocity = plan(robot, belief, setting.weight, setting.margin)
        crowd.step(robot, velocity)
        robot = robot + FRAME * velocity
        way += FRAME * float(np.linalg.norm(velocity))
        apart = np.linalg.norm(crowd.position - robot, axis=-1).min()
        least, frame = min(least, float(apart)), frame + 1
    return Outcome(least, frame * FRAME, way)


def run(file: Path, episodes: int) -> None:
    """Drive the episodes that `file` lacks, and add them."""
    done = read(file) if file.exists() else {}
    options = {"hold": 1.0, "max_people": 16, "compile": "needed"}
    predictor = Predictor(load_models([Path("recommended")]), **options)
    fresh = copy.deepcopy(predictor.window)
    for seed in range(episodes):
        missing = [s for s in SETTINGS if seed not in done.get(s, {})]
        if not missing:
            continue
        window = copy.deepcopy(fresh)
        crowd = begin(seed, window)
        rows = []
        for setting in missing:
            predictor.window = copy.deepcopy(window)
            outcome = cross(copy.deepcopy(crowd), predictor, setting)
            rows.append([seed, *setting, *(f"{value:.3f}" for value in outcome)])
        is_new = not file.exists()
        with file.open("a", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            if is_new:
                writer.writerow(["seed", *Setting._fields, *Outcome._fields])
            writer.writerows(rows)


def read(file: Path) -> dict[Setting, dict[int, Outcome]]:
    """Outcomes by setting and seed."""
    outcomes: dict[Setting, dict[int, Outcome]] = defaultdict(dict)
    with file.open(newline="") as stream:
        for row in csv.DictReader(stream):
            numbers = [float(row[name]) for name in Outcome._fields]
            setting = Setting(row["belief"], float(row["weight"]), float(row["margin"]))
            outcomes[setting][int(row["seed"])] = Outcome(*numbers)
    return outcomes


def table_of(outcomes: Mapping[int, Outcome]) -> np.ndarray:
    """[E, 2] of the episodes in order: 1 for a pass below `NEAR`, and seconds."""
    rows = [outcomes[seed] for seed in sorted(outcomes)]
    return np.array([[row.least < NEAR, row.seconds] for row in rows], float)


def interval(values: np.ndarray) -> np.ndarray:
    """[2, ...] ends of the 95 % interval of the mean of `values` [E, ...]."""
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(values), size=(2000, len(values)))
    return np.percentile(values[chosen].mean(axis=1), (2.5, 97.5), axis=0)


def chosen_costs(
    tables: Mapping[Setting, np.ndarray], price: float
) -> dict[str, tuple[Setting, np.ndarray]]:
    """Each belief's best setting by the even seeds, and its costs [E / 2] on the odd ones."""
    chosen = {}
    for belief in BELIEFS:
        settings = [setting for setting in tables if setting.belief == belief]
        costs = {s: tables[s] @ [price, 1.0] for s in settings}
        best = min(settings, key=lambda setting: costs[setting][::2].mean())
        chosen[belief] = best, costs[best][1::2]
    return chosen


def curves(tables: Mapping[Setting, np.ndarray]) -> str:
    """Risk and time of every setting, as a table in Markdown."""
    lines = ["| belief | weight | margin, m | passes below 0.7 m, % | time, s |"]
    lines.append("|---|---:|---:|---:|---:|")
    for setting, table in tables.items():
        cells = []
        values = table * [100, 1]
        for mean, (low, high), digits in zip(
            values.mean(axis=0), interval(values).T, (0, 1)
        ):
            cells.append(f"{mean:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})")
        head = f"| {setting.belief} | {setting.weight:g} | {setting.margin:g} "
        lines.append(f"{head}| {' | '.join(cells)} |")
    return "\n".join(lines)


def comparison(tables: Mapping[Setting, np.ndarray], price: float) -> str:
    """What a crossing costs with each belief, and less than with two peers, in Markdown."""
    chosen = chosen_costs(tables, price)
    lines = [
        f"| price {price:g} s | weight, margin | cost, s | against constant velocity "
        "| against ± 25° |",
        "|---|---|---:|---:|---:|",
    ]
    for belief, (setting, cost) in chosen.items():
        cells = [f"{belief} | {setting.weight:g}, {setting.margin:g} m"]
        cells.append(f"{cost.mean():.1f}")
        for peer in PEERS:
            gap = cost - chosen[peer][1]
            low, high = interval(gap)
            cells.append(f"{gap.mean():+.1f} ({low:+.1f} to {high:+.1f})")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def draw(tables: Mapping[Setting, np.ndarray], file: Path) -> None:
    """Risk against time up to `LATEST`, with intervals.

    A line for each belief, over its weights, and dashed for single forecasts, over
    their margins.
    """
    figure, ((axes,),) = new_figure(1.15 * COLUMN, 3.2)
    for belief, colour in zip(BELIEFS, PALETTE[::-1]):
        own = [setting for setting in tables if setting.belief == belief]
        look = {"color": colour, "markersize": 4, "elinewidth": 0.4}
        weights = [setting for setting in own if setting.margin == NEAR]
        _draw_curve(axes, tables, weights, fmt="o-", label=belief, **look)
        if belief in SINGLE:
            margins = sorted(s for s in own if s.weight == 4)
            label = f"{belief}, margins to {MARGINS[-1]:g} m"
            _draw_curve(axes, tables, margins, fmt="s--", label=label, **look)
    axes.set_ylim(bottom=0)
    axes.set_xlim(right=LATEST)
    title = "Risk and time to cross a hall, by what the robot believes"
    dress(axes, "time [s]", "passes below 0.7 m [%]", title)
    save_figure(add_legend(figure, axes), file)


def _draw_curve(
    axes: Any,
    tables: Mapping[Setting, np.ndarray],
    settings: Sequence[Setting],
    **looks: Any,
) -> None:
    values = np.array([tables[setting] * [100, 1] for setting in settings])
    middle = values.mean(axis=1)  # [S, 2]
    ends = np.stack([interval(value) for value in values], axis=1)
    errors = np.abs(ends - middle)
    risk, seconds = middle.T
    axes.errorbar(seconds, risk, errors[..., 0], errors[..., 1], **looks)


def main() -> None:
    """See the module."""
    action, name, *rest = sys.argv[1:]
    file = Path(name)
    if action == "run":
        run(file, int(rest[0]) if rest else EPISODES)
        return
    tables = {setting: table_of(rows) for setting, rows in read(file).items()}
    if action == "draw":
        draw(tables, Path(rest[0]))
        return
    print(f"{len(next(iter(tables.values())))} episodes\n\n{curves(tables)}")
    for price in PRICES:
        print(f"\n{comparison(tables, price)}")


if __name__ == "__main__":
    main()
