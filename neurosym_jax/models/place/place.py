"""A place that is watched: what people did there, and how much of it forecasts take."""

import dataclasses
import functools
import json
import math
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.configuration import Count, refuse
from neurosym_jax.data.tracks import SNAP, Tracks, on_grid
from neurosym_jax.data.windows import bucket_of
from neurosym_jax.errors import InputError
from neurosym_jax.models.forecast import Model
from neurosym_jax.models.forecaster import Forecaster
from neurosym_jax.models.place import memory as memories
from neurosym_jax.models.place.change import Change
from neurosym_jax.models.place.flows import Flows, flows_of
from neurosym_jax.models.place.memory import COMPONENTS, KERNELS, Kernel, Memory, Recall
from neurosym_jax.models.place.mixture import (
    Remembered,
    distances_apart,
    errors,
    remembered,
)
from neurosym_jax.models.place.shares import (
    PACES,
    Commitment,
    Scored,
    new_ledger,
    pace_of,
)
from neurosym_jax.models.place.stream import Followed, Step, Steps
from neurosym_jax.models.tracking_errors import was_repaired
from neurosym_jax.runtime.files import new_file
from neurosym_jax.runtime.foreign import read_arrays, reading
from neurosym_jax.scene import Scene, make_scene, pad_scene

__all__ = ["Place", "load_place", "steps_of", "write_place"]

VERSION = 3
"""Of the file that `Place.save` writes."""
LEDGER = "shares", "people", "error", "distances"
"""Arrays of the ledger that a file has."""
BEFORE = 2 * memories.STRIDE + 1
"""Steps up to a moment from which its features are taken."""


class _Awaited(NamedTuple):
    """Forecasts of N people at one step, whose truth has not come yet."""

    step: int
    people: list[int]
    offsets: Any
    """[P, N', T, 2] the network's points, from the last positions."""
    expected: np.ndarray
    """[N', T, 2] their means."""
    recall: Recall
    distances: np.ndarray
    """[N, 1 + K, 1 + K] see `distances_apart`."""
    commitment: Commitment


class Place:
    """A memory of one place, which learns while it watches.

    What earlier people did from a similar position with a similar velocity is added to
    a model's forecasts (`predict_distribution`), with a share of the probability that
    earlier energy scores at this place choose. Nothing is trained, and nothing is used
    before it is over. However people move, the sum of the energy scores of all
    forecasts exceeds that of the model alone by at most `limit` metres; see
    `models.place.shares`.

    Positions are in one frame, such as `map`: another frame is another place.
    """

    def __init__(
        self,
        model: Model,
        *,
        frame: str = "",
        moments: int = 100_000,
        half_life: float = math.inf,
    ):
        """A place where nobody was seen yet.

        Args:
            model: of any family.
            frame: name of the frame of the positions; empty where it has none.
            moments: most moments that are remembered. 100,000 take 25 MB.
            half_life: seconds of watching after which what people did, and what that
                brought, counts for half. By default it counts for ever; recordings of
                minutes do not tell what is better.

        Raises:
            InputError: for numbers that are not positive.
        """
        refuse(Count, {"moments": moments})
        self.model, self.frame = model, frame
        self.half_life = _checked_half_life(half_life)
        self.drops = 0
        """Times that the memory was dropped, because forecasts were worse with it."""
        self.scored = Scored(0, 0.0, 0.0)
        """Sums over all forecasts whose truth has come."""
        self.change = Change()
        """By how much scores changed with the memory, with an interval."""
        self.seconds = 0.0
        """Time that the place was watched."""
        self._params = jax.device_put(model.params)
        self._memory = memories.empty_memory(moments, model.config.pred_len)
        self._ledger = new_ledger(list(COMPONENTS.values()))
        self._shares = np.eye(1 + len(COMPONENTS))[[0] * PACES]
        self._origin: np.ndarray | None = None
        self._now, self._people = 0.0, 0
        self.begin()

    @property
    def shares(self) -> dict[str, float]:
        """Probability of each part of a forecast, `network` and the `COMPONENTS` by name.

        That of a component holds for a person for whom it recalls enough people. People
        who walk have other shares than those who stand; this is the mean.
        """
        names = "network", *COMPONENTS
        return dict(zip(names, self._mean_shares().tolist()))

    @property
    def limit(self) -> float:
        """By how much energy scores may exceed those of the model, summed, metres."""
        return self._ledger.limit

    @property
    def moments(self) -> int:
        """Number of moments that are remembered."""
        return int((self._memory.person >= 0).sum())

    def __repr__(self) -> str:
        """What was watched, and what it brought."""
        people, network, used = self.scored
        lines = [
            f"Place {self.frame}".rstrip(),
            f"  watched: {self.seconds / 60:.1f} minutes, {self.moments:,} moments",
            f"  memory's share: {1 - self._mean_shares()[0]:.2f}",
        ]
        if people:
            change = f"{100 * (used / max(network, 1e-9) - 1):+.1f} %"
            lines.append(
                f"  energy score of a person: {used / people:.3f} m, "
                f"without the memory {network / people:.3f} m ({change})"
            )
        return "\n".join(lines)

    def watch(self, positions: ArrayLike, ids: ArrayLike, time: float) -> None:
        """Take in a frame: everybody seen at a time.

        Frames may come at any rate; positions at the model's steps are interpolated
        between them.

        Args:
            positions: [N, 2] metres.
            ids: [N] whole numbers, the same for a person in all frames.
            time: seconds, later than that of the frame before.

        Raises:
            InputError: for wrong shapes, positions that are not finite, an id that is
                there twice, or a time that is not later.
        """
        position, number = _checked_frame(positions, ids, time)
        last = self._steps.last
        if last is not None and time <= last.time:
            raise InputError(
                f"time: {time:g} s is not after the frame before, {last.time:g} s"
            )
        for step in self._steps.push(float(time), number, position):
            self.watch_step(step)

    def watch_tracks(self, recording: Any) -> None:
        """Watch a whole recording: a file, a table or `Tracks`, see `evaluate`.

        Raises:
            InputError: for what is no recording.
        """
        from neurosym_jax.data.recordings import recordings_in

        for tracks in recordings_in(recording):
            self.begin()
            for step in steps_of(tracks, self.model.config.period):
                self.watch_step(step)
        self.begin()

    def forget(self, older_than: float) -> None:
        """Forget what was seen so many seconds before the last frame, or earlier.

        Raises:
            InputError: for a negative number.
        """
        if not older_than >= 0:
            raise InputError(f"older_than must not be negative, not {older_than}")
        self._memory = memories.forget(self._memory, np.float32(self._now - older_than))

    def recalled(self, observed: np.ndarray, scene: Scene, slots: int) -> Remembered:
        """The memory's part of a forecast, for `Forecaster.distribution`.

        Args:
            observed: [N, obs_len, 2] metres in the frame of the place.
            scene: the same people, relative to its origin.
            slots: to which the scene is padded.
        """
        last = np.zeros((slots, 2), np.float32)
        last[: len(observed)] = np.asarray(scene.observed)[: len(observed), -1]
        shares = np.zeros((slots, self._shares.shape[1]), np.float32)
        shares[: len(observed)] = self._shares[self._pace(observed)]
        alike = self._alike(np.asarray(observed, np.float64), slots)
        return _recalled(KERNELS, self._memory, *alike, shares, last)

    def flows(self) -> Flows:
        """Where people go from here, and how many do."""
        return flows_of(self._memory, self._origin)

    def save(self, file: Path | str) -> None:
        """Write what was learned to a file, `.npz`.

        People who are in view are not in it.
        """
        write_place(file, self.contents())

    def contents(self) -> dict[str, np.ndarray]:
        """Arrays of a file, as they are now, for `write_place`."""
        ledger = self._ledger
        facts = {
            "version": VERSION,
            "model": _fingerprint(self.model),
            "frame": self.frame,
            "kernels": [dataclasses.asdict(kernel) for kernel in KERNELS],
            "scored": self.scored._asdict(),
            "seconds": self.seconds,
            "now": self._now,
            "people": self._people,
            "gain": ledger.gain,
            "most": ledger.most,
            "lost": ledger.lost,
            "drops": self.drops,
            "change": dataclasses.asdict(self.change),
        }
        arrays = {
            "facts": np.array(json.dumps(facts)),
            "shares": self._shares,
            "origin": np.zeros(0) if self._origin is None else self._origin,
        }
        for name in LEDGER:
            arrays[f"ledger_{name}"] = getattr(ledger, name)
        for name, field in self._memory._asdict().items():
            # A copy: the memory is used up by what is remembered next.
            arrays[f"memory_{name}"] = np.array(field)
        return arrays

    def begin(self) -> None:
        """Begin another stream of frames: what was awaited will not come."""
        config = self.model.config
        for awaited in getattr(self, "_awaited", ()):
            self._ledger = self._ledger.release(awaited.commitment)
        self._steps = Steps(config.period)
        before = max(BEFORE, config.obs_len)
        self._followed = Followed(before + config.pred_len, self._people)
        self._awaited: deque[_Awaited] = deque()
        self._offset = np.nan

    def rehearse(self, people: int) -> Remembered:
        """Compile what is computed for so many people, by a place of its own.

        Returns:
            What is recalled of them there: nothing.
        """
        config = self.model.config
        other = Place(self.model, moments=len(self._memory.person))
        position = np.zeros((people, 2))
        for number in range(config.obs_len + config.pred_len):
            time = number * config.period
            other.watch_step(Step(number, time, np.arange(people), position))
        observed = np.zeros((people, config.obs_len, 2))
        return other.recalled(observed, make_scene(observed), int(bucket_of(people)))

    def watch_step(self, step: Step) -> None:
        """Take in a step of the model's period, see `steps_of`: learn, and forecast."""
        period = self.model.config.period
        if np.isnan(self._offset):
            # A stream may have a clock of its own; ours goes on.
            self._offset = self._now + period - step.time
        before = self._now
        self._now = step.time + self._offset
        self.seconds += period
        self._ledger = self._ledger.fade(2 ** ((before - self._now) / self.half_life))
        if self._origin is None and len(step.position):
            self._origin = step.position.mean(axis=0)
        self._followed.push(step)
        self._people = self._followed.next
        expected = self._score(step.number)
        self._remember(step.number, expected)
        self._expect(step.number)

    def _score(self, number: int) -> dict[int, np.ndarray]:
        """Learn from the forecasts whose last step was `number`.

        Returns:
            By person [T, 2], the mean of the network's points as offsets.
        """
        steps = self.model.config.pred_len
        expected: dict[int, np.ndarray] = {}
        while self._awaited and self._awaited[0].step <= number - steps:
            awaited = self._awaited.popleft()
            self._ledger = self._ledger.release(awaited.commitment)
            if awaited.step == number - steps:
                expected = dict(zip(awaited.people, awaited.expected))
                self._learn(awaited, number)
        return expected

    def _learn(self, awaited: _Awaited, number: int) -> None:
        """Score forecasts by the tracks of those who are still in view."""
        steps = self.model.config.pred_len
        tracks = self._followed.tracks(number, steps + 1)
        future = np.zeros((awaited.offsets.shape[1], steps, 2), np.float32)
        seen = np.zeros(len(awaited.people), bool)
        for row, person in enumerate(awaited.people):
            if person in tracks:
                future[row] = tracks[person][1:] - tracks[person][0]
                seen[row] = True
        if not seen.any():
            return
        error = errors(awaited.offsets, awaited.recall, future)
        error = np.asarray(error, np.float64)[: len(seen)][seen]
        self._ledger, scored = self._ledger.learn(
            awaited.commitment,
            error,
            awaited.distances[seen],
            awaited.commitment.pace[seen],
        )
        self.scored = Scored(*np.add(self.scored, scored).tolist())
        self.change = self.change.add(self._now, scored.network, scored.used)
        if self._ledger.lost > self.limit:
            self._drop()

    def _drop(self) -> None:
        """Forget everybody: the memory lost as much as all forecasts of a horizon may.

        A camera that was moved and another map frame come to that. A place that stays as
        it is may, too, where people come one at a time and go anywhere: one of them can
        lose as much. It then learns anew, and still brings something.
        """
        self.drops += 1
        self.forget(0.0)
        self._ledger = dataclasses.replace(self._ledger, lost=0.0)

    def _remember(self, number: int, expected: Mapping[int, np.ndarray]) -> None:
        """Remember the moments whose way on ends with step `number`, and what was `expected`."""
        config = self.model.config
        length = BEFORE + config.pred_len
        tracks = self._followed.tracks(number, length)
        people, group = _consistent(tracks, config.period)
        if not len(people):
            return
        size = int(bucket_of(len(people)))
        feature = np.zeros((size, memories.FEATURES), np.float32)
        onward = np.zeros((size, config.pred_len, 2), np.float32)
        error = np.full_like(onward, np.inf)
        numbers = np.full(size, -1, np.int32)
        rows = slice(len(people))
        past = group[:, :BEFORE] - self._origin
        future = group[:, BEFORE:] - self._origin
        feature[rows] = memories.features(past, config.period)
        onward[rows] = future - past[:, -1:]
        for row, person in enumerate(people.tolist()):
            if person in expected:
                error[row] = onward[row] - expected[person]
        numbers[rows] = people % 2**31
        time = np.full(size, self._now, np.float32)
        self._memory = memories.remember(
            KERNELS, self._memory, feature, onward, error, numbers, time
        )

    def _expect(self, number: int) -> None:
        """Forecast everybody with a whole window, to be scored once the truth has come."""
        config = self.model.config
        tracks = self._followed.tracks(number, config.obs_len)
        if not tracks:
            return
        observed = np.array(list(tracks.values()))
        slots = int(bucket_of(len(tracks)))
        scene = pad_scene(make_scene(observed, frame=number), slots)
        scene = self.model.forecaster.prepared(scene.bare())
        offsets, expected = _offsets(self.model.forecaster, self._params, scene)
        recall = self._recall(observed, slots)
        distances = distances_apart(offsets, recall)
        distances = np.asarray(distances, np.float64)[: len(tracks)]
        filled = np.asarray(recall.weight, np.float64)[: len(tracks)].sum(axis=2)
        self._ledger, commitment = self._ledger.commit(
            distances, filled, self._pace(observed)
        )
        self._shares = commitment.shares
        self._awaited.append(
            _Awaited(
                step=number,
                people=list(tracks),
                offsets=offsets,
                expected=np.asarray(expected),
                recall=recall,
                distances=distances,
                commitment=commitment,
            )
        )

    def _pace(self, observed: np.ndarray) -> np.ndarray:
        """[N] see `pace_of`, after `observed [N, S, 2]`."""
        moment = memories.features(observed, self.model.config.period)
        return pace_of(moment[:, 2:4])

    def _mean_shares(self) -> np.ndarray:
        """[1 + K] mean of the shares over the people who were scored."""
        people = self._ledger.people
        weight = people if people.any() else np.ones(PACES)
        return weight @ self._shares / weight.sum()

    def _recall(self, observed: np.ndarray, slots: int) -> Recall:
        """What people did from moments like the last of `observed [N, S, 2]`, padded."""
        return memories.recall(KERNELS, self._memory, *self._alike(observed, slots))

    def _alike(
        self, observed: np.ndarray, slots: int
    ) -> tuple[np.ndarray, np.float32, np.float32]:
        """Arguments of `memories.recall` after the memory, for `observed [N, S, 2]`, padded."""
        origin = observed[0, -1] if self._origin is None else self._origin
        feature = np.full((slots, memories.FEATURES), np.inf, np.float32)
        past = observed[:, -BEFORE:] - origin
        feature[: len(observed)] = memories.features(past, self.model.config.period)
        return feature, np.float32(self._now), np.float32(self.half_life)


def _consistent(
    tracks: Mapping[int, np.ndarray], period: float
) -> tuple[np.ndarray, np.ndarray]:
    """People [n] and tracks [n, S, 2], of equal length, without tracking errors.

    A track that jumps is of two people. Speed is no error, see `tracking_errors`: a
    runner's way on is remembered.
    """
    people, group = np.array(list(tracks)), np.array(list(tracks.values()))
    if not len(people):
        return people, group
    whole = ~was_repaired(group, period)
    return people[whole], group[whole]


@functools.partial(jax.jit, static_argnums=0)
def _recalled(
    kernels: tuple[Kernel, ...],
    memory: Memory,
    moment: jax.Array,
    now: jax.Array,
    half_life: jax.Array,
    shares: jax.Array,
    last: jax.Array,
) -> Remembered:
    """`memories.recall` and `remembered` as one program: a frame waits for it."""
    recall = memories.recall(kernels, memory, moment, now, half_life)
    return remembered(recall, shares, last)


@functools.partial(jax.jit, static_argnums=0)
def _offsets(
    forecaster: Forecaster, params: Any, scene: Scene
) -> tuple[jax.Array, jax.Array]:
    """[P, N, T, 2] the network's points, from the last positions, and their means [N, T, 2]."""
    points = forecaster.points(params, scene, jax.random.key(0))
    offsets = points - jnp.asarray(scene.observed)[None, :, -1:]
    return offsets, offsets.mean(axis=0)


def write_place(file: Path | str, contents: Mapping[str, Any]) -> None:
    """Write a file with the `Place.contents`.

    The file that was there stays until this one is whole.

    Raises:
        InputError: if it cannot be written.
    """
    with new_file(Path(file)) as beside, beside.open("wb") as stream:
        np.savez_compressed(stream, **contents)


def load_place(file: Path | str, model: Model, *, half_life: float = math.inf) -> Place:
    """The place that `Place.save` wrote, for the same model.

    Raises:
        InputError: for a file that is not one of a place, or of another model.
    """
    _checked_half_life(half_life)
    with reading(file, "a file of a place"):
        arrays = read_arrays(file, "a file of a place")
        facts = json.loads(str(arrays["facts"]))
        if facts["version"] != VERSION:
            raise InputError(
                f"has version {facts['version']} of the file, not {VERSION}: "
                "begin another file"
            )
        if facts["model"] != _fingerprint(model):
            raise InputError(
                f"was learned with another model: {facts['model']}, "
                f"not {_fingerprint(model)}"
            )
        kernels = [dataclasses.asdict(kernel) for kernel in KERNELS]
        if facts["kernels"] != kernels:
            raise InputError("was learned with other kernels: begin another file")
        place = _restored(model, facts, arrays)
    place.half_life = half_life
    return place


def _restored(model: Model, facts: Any, arrays: dict[str, np.ndarray]) -> Place:
    """The place with these facts and arrays, whose shapes must be those of a new one."""
    moments = len(arrays["memory_person"])
    place = Place(model, frame=str(facts["frame"]), moments=moments)
    expected = {"shares": place._shares}
    for name in LEDGER:
        expected[f"ledger_{name}"] = getattr(place._ledger, name)
    for name, field in place._memory._asdict().items():
        expected[f"memory_{name}"] = field
    for name, field in expected.items():
        array = arrays[name]
        if (array.shape, array.dtype) != (field.shape, field.dtype):
            raise InputError(
                f"{name} must be {list(field.shape)} {field.dtype}, "
                f"not {list(array.shape)} {array.dtype}"
            )
    origin = arrays["origin"].astype(np.float64)
    if origin.shape not in ((0,), (2,)):
        raise InputError(f"origin must have two numbers or none, not {len(origin)}")

    fields = {name: jnp.array(arrays[f"memory_{name}"]) for name in Memory._fields}
    place._memory = Memory(**fields)
    place._ledger = dataclasses.replace(
        place._ledger,
        **{name: arrays[f"ledger_{name}"] for name in LEDGER},
        gain=float(facts["gain"]),
        most=float(facts["most"]),
        # Files of an earlier release know neither losses nor drops nor changes.
        lost=float(facts.get("lost", 0.0)),
    )
    place.drops = int(facts.get("drops", 0))
    place.change = Change(**facts.get("change", {}))
    place._shares = arrays["shares"]
    place._origin = origin if len(origin) else None
    place._now, place._people = float(facts["now"]), int(facts["people"])
    place.scored, place.seconds = Scored(**facts["scored"]), float(facts["seconds"])
    place.begin()
    return place


def steps_of(tracks: Tracks, period: float) -> list[Step]:
    """The steps of a recording, each as it was known by then.

    A position that was interpolated between an observation before the step and one
    after it was not known: it is what earlier observations foresaw.
    """
    tracks = on_grid(tracks, period)
    position = tracks.position
    if tracks.known is not None and tracks.foreseen is not None:
        late = tracks.known > tracks.stamp + 2 * SNAP
        position = np.where(late[:, None], tracks.foreseen, position)
    place = tracks.step
    if place is None:
        place = np.rint((tracks.stamp - tracks.stamp.min()) / period).astype(np.int64)
    order = np.argsort(place, kind="stable")
    numbers, first = np.unique(place[order], return_index=True)
    steps = []
    for number, rows in zip(numbers.tolist(), np.split(order, first[1:])):
        steps.append(
            Step(number, float(tracks.stamp[rows[0]]), tracks.id[rows], position[rows])
        )
    return steps


def _checked_half_life(half_life: float) -> float:
    if not half_life > 0:
        raise InputError(f"half_life must be positive, not {half_life}")
    return half_life


def _checked_frame(
    positions: ArrayLike, ids: ArrayLike, time: float
) -> tuple[np.ndarray, np.ndarray]:
    if not np.isfinite(time):
        raise InputError(f"time: {time} is not a number of seconds")
    position = np.asarray(positions, np.float64)
    number = np.asarray(ids)
    if number.size == 0 and position.size == 0:
        return np.zeros((0, 2)), np.zeros(0, np.int64)
    if position.ndim != 2 or position.shape[1] != 2:
        raise InputError(f"positions must be [N, 2], not {list(position.shape)}")
    if number.shape != (len(position),) or number.dtype.kind not in "iu":
        raise InputError("ids must be whole numbers, one for each position")
    if len(np.unique(number)) != len(number):
        raise InputError("ids: one is there twice in a frame")
    if not np.isfinite(position).all():
        raise InputError("positions: one is not finite")
    return position, number.astype(np.int64)


def _fingerprint(model: Model) -> str:
    """What a place must share with the one that wrote its file, in words."""
    return f"{model.family} {model.dataset or ''}: {model.config}"
