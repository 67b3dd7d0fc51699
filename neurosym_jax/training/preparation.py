"""What a training learns from and is validated on: one preparation for the command and Python.

Recordings are resampled to the steps of the configuration and cut into windows. Where
nothing is said of validation, a part of each recording is kept for it, a window apart
from what is learned.
"""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from neurosym_jax.data.recordings import recordings_in
from neurosym_jax.data.tables import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.tracks import Tracks, on_grid
from neurosym_jax.data.windows import (
    Windows,
    chance_shapes,
    cut_windows,
    seen_before,
    shared_shapes,
)
from neurosym_jax.errors import InputError, option, printable
from neurosym_jax.scene import scene_identity

__all__ = ["describe_parts", "prepare"]

SHARE = 0.2
"""Share of a recording's windows that are kept for validation."""
LEAST = 0.5
"""Least share of a recording's windows that are left to learn from where it is cut in time; of
recordings that are too short for this, every fifth validates as a whole."""
LINES = 20
"""Most recordings that `describe_parts` lists."""


def prepare(
    config: Any,
    recipe: Any,
    training: Any,
    validation: Any = None,
    tested: Any = None,
    *,
    also: Any = (),
    read: ReadOptions = AS_IT_SAYS,
    fold: str | None = None,
    seen: str = "",
) -> tuple[Windows, Windows]:
    """The windows to learn from and to validate on.

    Args:
        config: of the model, whose `obs_len`, `pred_len` and `period` the windows have.
        recipe: whose `min_agents` the scenes to learn from have.
        training: `Windows`, or recordings: `Tracks` on any clock, files, folders,
            dataframes, or several of these.
        validation: the same; None or nothing keeps a part of `training` for it.
        tested: recordings that the model is to be tested on, which it must not learn.
        also: further recordings to learn from, of which no part is kept.
        read: how files are read, and which guards are waived (`seen`).
        fold: K/N validates on the K-th of N parts of `training`: of its recordings,
            where there are as many, or else of the time of each.
        seen: the fingerprint of what the model learned before.

    Raises:
        InputError: for recordings without windows, windows of another length or period,
            and windows to be validated or tested on that are learned from.
    """
    own = validation is None or (isinstance(validation, list) and not validation)
    if fold is not None and not own:
        raise InputError(f"fold {fold}: has no effect where validation is given")
    if own and isinstance(training, Windows):
        raise InputError(
            "validation: windows cannot be divided; give recordings, or validation"
        )
    learned_from: Any = training
    if not isinstance(training, Windows):
        learned_from = _on_grid(training, config.period, read)
    if own:
        learned_from, validation = _divided(
            learned_from, config, recipe.min_agents, fold
        )
    elif not isinstance(validation, Windows):
        validation = _on_grid(validation, config.period, read)
    if len(also):
        learned_from = [*learned_from, *_on_grid(also, config.period, read)]
    learned = _windows(learned_from, config, recipe.min_agents)
    validated = _windows(validation, config, 2, recipe.min_agents)
    uses: dict[str, Windows | None] = {"validated": validated}
    if tested is not None:
        uses["tested"] = _windows_if_any(_on_grid(tested, config.period, read), config)
    for use, windows in reversed(uses.items()):
        if windows is not None and "seen" not in read.allow:
            _refuse_seen(use, windows, learned, seen)
    return learned, validated


def describe_parts(training: Windows, validation: Windows) -> str:
    """A line for each recording: how many of its windows are learned from and validated on."""
    counts: dict[str, list[int]] = {}
    for at, windows in enumerate((training, validation)):
        for name in dict.fromkeys(reading.recording for reading in windows.reading):
            digest = scene_identity(name, 0)[0]
            number = int((windows.identity[:, 0] == digest).sum())
            counts.setdefault(name, [0, 0])[at] = number
    rows = [
        f"  {printable(name)}: {learned} / {validated}"
        for name, (learned, validated) in counts.items()
    ]
    lines = ["windows to learn from / to validate on:", *rows[:LINES]]
    if len(rows) > LINES:
        lines.append(f"  and {len(rows) - LINES} recordings more")
    return "\n".join(lines)


def _on_grid(data: Any, period: float, read: ReadOptions) -> list[Tracks]:
    """The recordings in `data` at steps of `period`; what is on that grid already stays."""
    return [
        tracks if tracks.period == period else on_grid(tracks, period, read.max_gap)
        for tracks in recordings_in(data, read)
    ]


def _windows(
    part: Windows | Sequence[Tracks], config: Any, least: int, fewer: int | None = None
) -> Windows:
    """The windows of recordings with at least `least` people, or else with `fewer`."""
    lengths = config.obs_len, config.pred_len
    if isinstance(part, Windows):
        steps = part.obs_len, part.position.shape[1] - part.obs_len
        if steps != lengths:
            has, needs = (" + ".join(map(str, pair)) for pair in (steps, lengths))
            raise InputError(f"windows of {has} steps do not fit a config of {needs}")
        if abs(part.period - config.period) > 0.01 * config.period:
            raise InputError(
                f"windows have steps of {part.period:g} s and the config of {config.period:g} s: "
                f"config.period={part.period:g} fits"
            )
        return part
    try:
        return cut_windows(part, *lengths, min_agents=least)
    except InputError as error:
        if fewer is not None and fewer < least:
            return cut_windows(part, *lengths, min_agents=fewer)
        if least > 1 and _windows_if_any(part, config, 1):
            hint = "min_agents=1 in the recipe (--set min_agents=1) learns from people alone"
            raise InputError(f"{error}; {hint}") from None
        raise


def _windows_if_any(
    part: Sequence[Tracks], config: Any, least: int = 2
) -> Windows | None:
    try:
        return cut_windows(part, config.obs_len, config.pred_len, min_agents=least)
    except InputError:  # It may be too short for a window.
        return None


@dataclasses.dataclass(frozen=True)
class _Recording:
    """A recording and the moments at which its windows begin."""

    tracks: Tracks
    begin: np.ndarray  # [S] seconds, ascending
    step: float  # seconds
    window: float  # seconds from the first step of a window to its last

    def parted(
        self, first: float, last: float, gap: float
    ) -> tuple[Tracks, Tracks, int]:
        """Its parts outside of `first` to `last` and within, and how many windows are outside.

        `gap` seconds on both sides belong to neither part.
        """
        before = first - gap - self.step / 2
        after = last + gap + self.step / 2
        half = self.step / 2
        stamp = self.tracks.stamp
        outside = self.tracks.take((stamp < before) | (stamp > after))
        within = self.tracks.take((stamp > first - half) & (stamp < last + half))
        ends_before = self.begin + self.window < before
        begins_after = self.begin > after
        left = np.sum(ends_before) + np.sum(begins_after)
        return outside, within, int(left)


def _divided(
    recordings: Sequence[Tracks], config: Any, least: int, fold: str | None
) -> tuple[list[Tracks], list[Tracks]]:
    """Recordings, or parts of them, to learn from and to validate on."""
    used = []
    for tracks in recordings:
        windows = _windows_if_any([tracks], config, least)
        if windows is not None and windows.stamp is not None:
            observed = (config.obs_len - 1) * config.period
            begin = np.sort(windows.stamp - observed)
            length = (config.obs_len + config.pred_len - 1) * config.period
            used.append(_Recording(tracks, begin, config.period, length))
    if not used:
        return [*recordings], []  # Which has no windows, as is said where they are cut.
    parts = _last_parts(used) if fold is None else _fold(used, fold)
    training, validation = zip(*parts)
    return _not_empty(training), _not_empty(validation)


def _not_empty(parts: Iterable[Tracks | None]) -> list[Tracks]:
    return [part for part in parts if part is not None and len(part.id)]


_Parts = list[tuple[Tracks | None, Tracks | None]]
"""Of each recording what is learned from, and what is validated on."""


def _last_parts(recordings: Sequence[_Recording]) -> _Parts:
    """The last windows of each recording are kept; of several short ones, every fifth recording."""
    parts = _Parts()
    short = list[_Recording]()
    for recording in recordings:
        first = recording.begin[_last(len(recording.begin))]
        gap = recording.window + recording.step
        training, validation, left = recording.parted(first, np.inf, gap)
        if left < LEAST * len(recording.begin):
            short.append(recording)
        else:
            parts.append((training, validation))
    if len(short) == 1 and not parts:
        return [_halves(short[0])]
    stride = min(round(1 / SHARE), len(short))
    for number, recording in enumerate(short, 1):
        if len(short) > 1 and number % stride == 0:
            parts.append((None, recording.tracks))
        else:
            parts.append((recording.tracks, None))
    return parts


def _halves(recording: _Recording) -> tuple[Tracks, Tracks]:
    """Two parts of one short recording, without a gap."""
    begin = recording.begin
    length = recording.window + recording.step
    later = begin[begin > begin[0] + length - recording.step / 2]
    if not len(later):
        raise InputError(
            f"{recording.tracks.recording}: its windows last {np.ptp(begin) + length:.1f} s, and "
            f"{2 * length:.1f} s are needed to keep a part for validation; give recordings to "
            "validate on"
        )
    first = max(later[0], begin[_last(len(begin))])
    training, validation, _ = recording.parted(first, np.inf, 0.0)
    return training, validation


def _last(windows: int) -> int:
    """The first of the last windows, which are kept."""
    return math.floor((1 - SHARE) * windows)


def _fold(recordings: Sequence[_Recording], fold: str) -> _Parts:
    """One of N parts is kept: of the recordings where there are N, or else of the time of each."""
    number, total = _fold_numbers(fold)
    parts = _Parts()
    for order, recording in enumerate(recordings):
        if len(recordings) >= total:
            is_kept = order % total == number - 1
            tracks = recording.tracks
            parts.append((None, tracks) if is_kept else (tracks, None))
            continue
        begin = np.array_split(recording.begin, total)[number - 1]
        if not len(begin):
            raise InputError(
                f"fold {fold}: {recording.tracks.recording} has too few windows"
            )
        last = begin[-1] + recording.window
        gap = recording.window + recording.step
        training, validation, _ = recording.parted(begin[0], last, gap)
        parts.append((training, validation))
    return parts


def _fold_numbers(fold: str) -> tuple[int, int]:
    """K and N of K/N."""
    number, _, count = fold.partition("/")
    are_numbers = number.isdecimal() and count.isdecimal()
    if are_numbers and 1 <= int(number) <= int(count) > 1:
        return int(number), int(count)
    raise InputError(f"fold: K/N, such as 1/5 for the first of five, not {fold!r}")


def _refuse_seen(use: str, windows: Windows, training: Windows, seen: str) -> None:
    """Refuse to learn from what the model is tested or validated on, by what is in it."""
    shared, total = shared_shapes(windows, training)
    expected = total * chance_shapes(training)
    before, looked = seen_before(seen, windows)
    recordings = [printable(reading.recording) for reading in windows.reading]
    names = ", ".join(dict.fromkeys(recordings)) or "these windows"
    where = f"windows in {names}, and that is what the model is {use} on"
    waived = f"({option('allow', ('seen',))} waives this)"
    # Of shapes that are alike by chance, not more than four deviations beyond what is
    # expected; one is chance in a recording however short.
    if shared > max(1, 0.01 * total, expected + 4 * math.sqrt(expected)):
        chance = f", {expected:.0f} by chance," if expected >= 1 else ""
        raise InputError(
            f"the training data has {shared}{chance} of the {total} shapes of {where} {waived}"
        )
    if before > max(0.05, chance_shapes(training)) * looked:
        raise InputError(
            f"the initial model learned from {before} of {looked} shapes of {where} {waived}"
        )
