"""Embedded default data: two people in a 5 m x 8.2 m room for two minutes, simulated from a seed.

The scenarios are those of the NeuroSyM robot experiment: in `all-forward` people walk
side by side to the room's end and back, in `cross-path` they cross each other's way. A
10 Hz tracker sees them. Results on them do not rank methods for real people. The
tracker's faults are options: noise, drop-outs, and ids that change.
"""

import dataclasses
import functools
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax.configuration import (
    Checked,
    Count,
    NotNegative,
    Positive,
    Seed,
    Share,
    refuse,
)
from neurosym_jax.data.tracks import Tracks, make_tracks
from neurosym_jax.runtime.process import COMPILED_QUICKLY
from neurosym_jax.simulation.social_force import ABREAST, Plan, walk

__all__ = ["ROOM", "Scenario", "TrackerFaults", "simulate", "simulate_labelled"]

Scenario = Literal["all-forward", "cross-path"]

ROOM = (5.0, 8.2)  # metres along x and y; one corner is the origin
SWAP_DISTANCE = 0.8  # m within which a tracker can confuse two people


@dataclasses.dataclass(frozen=True)
class TrackerFaults(Checked):
    """Faults of a tracker; the default is a good tracker with a little noise."""

    noise: NotNegative = 0.02  # standard deviation in metres of each coordinate
    dropout: Share = 0.0  # probability per frame that the tracker loses a person
    # mean length of a loss, geometrically distributed
    dropout_seconds: NotNegative = 1.0
    id_switch: Share = 0.0  # probability that a lost person comes back under a new id
    # probability per frame that two people within 0.8 m exchange their ids
    id_swap: Share = 0.0


def simulate(
    scenario: Scenario, seed: int = 0, duration: float = 120.0, **options: Any
) -> Tracks:
    """Tracks of a simulated walk, see `simulate_labelled`."""
    return simulate_labelled(scenario, seed, duration, **options)[0]


def simulate_labelled(
    scenario: Scenario,
    seed: int = 0,
    duration: float = 120.0,
    people: int = 2,
    faults: TrackerFaults | None = None,
    rate: float = 10.0,
) -> tuple[Tracks, np.ndarray]:
    """Tracks of a simulated walk as a tracker reports them, and the true id of each row [R] int64.

    With more than two people, `all-forward` has several pairs (the last person of an
    odd number walks alone) and in `cross-path` all cross the middle of the room. Frames
    are `n / rate`, from 0 to `duration` seconds. The same arguments give the same bits
    on the same machine; another `duration`, `people` or `rate` gives another walk.
    """
    refuse(Scenario, {"scenario": scenario})
    refuse(Seed, {"seed": seed})
    refuse(Count, {"people": people})
    refuse(Positive, {"rate": rate, "duration": duration})
    frames = int(duration * rate + 1e-6) + 1
    walk_key = _key(seed, 0)
    walked = _walk_frames(walk_key, scenario, people, frames, float(rate))
    path = np.asarray(walked, np.float64)
    stamp = np.arange(frames) / rate
    faults = faults or TrackerFaults()
    lost, label = _identities(path, faults, rate, seed)
    noise_key = _key(seed, 2)
    noise = jax.random.normal(noise_key, path.shape, jnp.float32)
    noisy = path + faults.noise * np.asarray(noise, np.float64)

    frame, person = np.nonzero(~lost)
    ids = label[frame, person]
    name = f"synthetic/{scenario}/{seed}"
    tracks = make_tracks(name, stamp[frame], ids, noisy[frame, person])
    order = np.lexsort((stamp[frame], ids))
    return tracks, person[order].astype(np.int64)


def _key(seed: int, purpose: int) -> jax.Array:
    """A key for each purpose of a seed; a Threefry key is two free words, so no split is needed."""
    words = jnp.array([purpose, seed], jnp.uint32)
    return jax.random.wrap_key_data(words, impl="threefry2x32")


def _all_forward(chance: jax.Array) -> Plan:
    """Pairs abreast between the room's ends; a third and fourth pair start a rank behind."""
    width, length = ROOM
    legs, people, _ = chance.shape
    number = np.arange(people)
    pair = number // 2
    shared = chance[:, 2 * pair]

    lanes = min((people + 1) // 2, 2)
    lane = (pair % lanes + 0.5) / lanes - 0.5
    side = (number % 2 - 0.5) * ABREAST
    middle = lane * 4.0 + width / 2 + side
    shift = _between(shared[..., 0], -0.5, 0.5)
    x = middle[None] + shift / lanes

    margin = _between(shared[..., 1], 0.9, 1.5)
    rank = (pair // lanes).astype(np.float32)
    margin = margin.at[0].add(np.float32(1.8) * rank)
    leg = np.arange(legs)[:, None]
    is_far = leg % 2 == 1
    y = jnp.where(is_far, length - margin, margin)

    goal = jnp.stack([x, y], -1)
    goal = goal + _between(chance[..., 4:6], -0.08, 0.08)
    shared_pause = _between(shared[..., 2], 0.1, 1.0)
    own_pause = _between(chance[..., 3], 0.0, 0.2)
    return Plan(goal, shared_pause + own_pause, _pace(chance))


def _cross_path(chance: jax.Array) -> Plan:
    """Each person between two opposite places at the room's edge, so that all ways meet inside."""
    legs, people, _ = chance.shape
    number = np.arange(people)
    angle = np.pi * (number + 0.5) / people
    way = np.stack([np.cos(angle), np.sin(angle)], -1)
    longest = np.abs(way).max(axis=-1, keepdims=True)
    way /= longest
    # Neighbours in angle start from opposite ends, so that two people meet instead of
    # merging.
    turn = np.arange(legs)[:, None] + number
    end = np.where(turn % 2 == 0, -1.0, 1.0)
    middle = np.array(ROOM) / 2
    reach = middle - [1.0, 1.1]
    station = middle + end[..., None] * way * reach
    goal = station + _between(chance[..., 4:6], -0.4, 0.4)
    pause = _between(chance[..., 3], 0.1, 1.2)
    return Plan(goal, pause, _pace(chance))


_PLANS = {"all-forward": _all_forward, "cross-path": _cross_path}


def _pace(chance: jax.Array) -> jax.Array:
    """[L, P] a person's speed, a little lower on some legs."""
    usual = _between(chance[:1, :, 6], 1.2, 1.35)
    share = _between(chance[..., 7], 0.92, 1.0)
    return usual * share


def _between(chance: jax.Array, low: float, high: float) -> jax.Array:
    return low + (high - low) * chance


@functools.partial(
    jax.jit,
    static_argnames=("scenario", "people", "frames", "rate"),
    compiler_options=COMPILED_QUICKLY,
)
def _walk_frames(
    key: jax.Array, scenario: str, people: int, frames: int, rate: float
) -> jax.Array:
    """Positions [frames, people, 2] in metres; `key` is consumed."""
    substeps = int(np.ceil(1 / (rate * 0.05) - 1e-9))
    # No leg takes less than two seconds: the shortest way across is 3 m.
    legs = int(frames / rate / 2) + 3
    # One draw for everything, because each takes a third of a second to compile.
    # float32 by name, so that a seed is the same walk under x64. Kicks of unit variance
    # need not be normal: the wobble is the sum of many.
    steps = frames * substeps + 1
    plans = legs * people * 8
    count = plans + steps * 2 * people
    chance = jax.random.uniform(key, (count,), jnp.float32)
    kicks = chance[plans:].reshape(steps, 2, people)
    kicks = float(np.sqrt(12)) * (kicks - 0.5)
    plan_chance = chance[:plans].reshape(legs, people, 8)
    plan = _PLANS[scenario](plan_chance)
    plan = Plan(*(values.astype(jnp.float32) for values in plan))
    abreast = scenario == "all-forward"
    positions = walk(plan, kicks, 1 / (rate * substeps), ROOM, abreast)
    return positions[::substeps]


def _identities(
    path: np.ndarray, faults: TrackerFaults, rate: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """[F, P] bool: who is lost; and [F, P] int64: the tracker's ids."""
    frames, people, _ = path.shape
    person = np.arange(people)
    if faults.dropout == faults.id_swap == 0:
        lost = np.zeros((frames, people), bool)
        return lost, np.tile(person, (frames, 1))
    shape = (frames, people, 3 + people)
    key = _key(seed, 1)
    chance = np.asarray(jax.random.uniform(key, shape, jnp.float32), np.float64)

    lost = _losses(chance[..., 0], chance[..., 1], faults, rate)
    switches = chance[..., 2] < faults.id_switch
    renamed = _comes_back(lost) & switches
    count = np.cumsum(renamed).reshape(renamed.shape)
    label = np.where(renamed, people - 1 + count, person)
    label = np.maximum.accumulate(label, axis=0)

    offset = path[:, :, None] - path[:, None]
    is_near = np.linalg.norm(offset, axis=-1) < SWAP_DISTANCE
    are_seen = ~lost[:, :, None] & ~lost[:, None]
    is_swapped = chance[..., 3:] < faults.id_swap
    swaps = np.triu(is_near & are_seen & is_swapped, 1)
    for at, first, second in np.argwhere(swaps):
        swapped = [second, first]
        label[at:, [first, second]] = label[at:, swapped]
    return lost, label


def _losses(
    start: np.ndarray, length: np.ndarray, faults: TrackerFaults, rate: float
) -> np.ndarray:
    """[F, P] bool: who is lost, given chances [F, P] of a loss to start, and of its length."""
    frame = np.arange(len(start))
    frame = frame[:, None]
    # Geometric length by inversion: P(more than n frames) = (1 - 1 / mean) ** n.
    mean = max(faults.dropout_seconds * rate, 1.0)
    tail = np.log1p(-1 / mean) if mean > 1 else -np.inf
    frames = 1 + np.floor(np.log1p(-length) / tail)
    end = np.where(start < faults.dropout, frame + frames, 0.0)
    return np.maximum.accumulate(end, axis=0) > frame


def _comes_back(lost: np.ndarray) -> np.ndarray:
    """[F, P] bool: who is seen again, given who is `lost [F, P]`; nobody comes back at first."""
    was_seen = np.logical_or.accumulate(~lost, axis=0)
    is_back = np.zeros_like(lost)
    was_lost = lost[:-1] & was_seen[:-1]
    is_back[1:] = was_lost & ~lost[1:]
    return is_back
