"""Whether a recording's clock and unit can be true, by how people move in it.

Speeds are taken over steps of about 0.4 s, so that noise of a fast tracker is not
walking.
"""

from collections.abc import Iterator

import numpy as np
import polars as pl

from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.data.tracks import GAP, PERIOD, Tracks
from neurosym_jax.errors import option

__all__ = [
    "APART",
    "DOUBTED",
    "REFUSED",
    "apart_of",
    "judge",
    "pace_of",
    "roughness",
    "steps_of",
]

REFUSED, DOUBTED = (0.9, 4.5), (1.05, 2.5)
"""Outside these paces, m/s, a recording is refused or doubted. Those of ETH/UCY and THÖR are 1.22
to 2.06, SGAN's eth 3.23 (`python -m studies.bands`)."""
APART = (0.2, 0.35)
"""Below these distances to the nearest person, metres, of a quarter of the points, a recording is
refused and doubted, whatever its clock says. Those of ETH/UCY and THÖR are 0.46 to 2.23."""
FEW, ENOUGH = 10, 100  # steps that say anything of a recording, and that may refuse one
MANY = 20  # fewest people of whom a share is judged


def steps_of(tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and m/s of every step of every person, in the order of the tracks."""
    same = np.diff(tracks.id) == 0
    step = np.diff(tracks.stamp)[same]
    return step, np.linalg.norm(np.diff(tracks.position, axis=0)[same], axis=1) / step


def pace_of(tracks: Tracks) -> tuple[int, float]:
    """Number of steps, and the speed that one in twenty exceeds; NaN where it says nothing."""
    step, same = np.diff(tracks.stamp), np.diff(tracks.id) == 0
    longest = GAP * max(float(np.median(step[same])) if same.any() else 0.0, PERIOD)
    clock = np.append(0.0, np.cumsum(np.where(same, step, 2 * longest)))
    # Strides to the same person's row about 0.4 s later, or of short tracks to the
    # next.
    after = np.searchsorted(clock, clock + PERIOD - 1e-3)
    starts = np.flatnonzero(after < len(clock))
    starts = starts[clock[after[starts]] - clock[starts] <= longest]
    if len(starts) < FEW:
        starts = np.flatnonzero(same)
        after = np.arange(len(clock)) + 1
    if len(starts) < FEW:
        return len(starts), np.nan
    after = after[starts]
    time = tracks.stamp[after] - tracks.stamp[starts]
    length = np.linalg.norm(tracks.position[after] - tracks.position[starts], axis=1)
    pace = float(np.quantile(length / time, 0.95))
    # In a moment anybody may stand.
    return len(starts), pace if pace > 1 or np.median(time) > PERIOD / 2 else np.nan


def apart_of(tracks: Tracks) -> float:
    """Metres to the nearest person that a quarter of the points are within, at 200 moments or so.

    NaN where few people are there at one moment.
    """
    from scipy.spatial import KDTree  # It takes a third of a second to import.

    moment, position = _moments(tracks)
    moments, moment = np.unique(moment, return_inverse=True)
    is_sampled = moment % max(1, len(moments) // 200) == 0
    # Moments are further apart than any two people; of people at one place the tree
    # would be slow.
    points = np.unique(np.column_stack([position, 1e10 * moment])[is_sampled], axis=0)
    near = KDTree(points).query(points, 2, distance_upper_bound=1e9)[0][:, 1]
    near = near[np.isfinite(near)]
    return float(np.quantile(near, 0.25)) if len(near) >= ENOUGH else np.nan


def _moments(tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of moments, of 0.1 s or the usual step, and each person's first position in one:
    the points of two trackers, or of each person, may have their own stamps."""
    moment = np.rint(
        tracks.stamp / min(0.1, np.median(np.append(steps_of(tracks)[0], 0.1)))
    )
    new = np.append(True, (np.diff(moment) != 0) | (np.diff(tracks.id) != 0))
    return moment[new], tracks.position[new]


def roughness(time: np.ndarray, ids: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """[C] typical second difference of each of the `columns` [R, C] along tracks, in spreads.

    It is infinite where the reading repeats a person at one moment, or has few tracks
    of three rows; uneven steps in time add to it.
    """
    order = np.lexsort((time, ids))
    step, same = np.diff(time[order]), np.diff(ids[order]) == 0
    triple = same[1:] & same[:-1]
    if (same & (step == 0)).any() or triple.sum() < 0.3 * len(time):
        return np.full(columns.shape[1], np.inf)
    bend = np.median(np.abs(np.diff(columns[order], 2, axis=0))[triple], axis=0)
    spread = np.ptp(np.quantile(columns, (0.05, 0.95), axis=0), axis=0)
    uneven = np.mean(step[1:][triple] != step[:-1][triple])
    return bend / np.maximum(spread, 1e-12) + 0.05 * uneven


def _every_period(tracks: Tracks) -> Tracks:
    """The tracks with points of a person about 0.4 s apart: between two frames of a video, whole
    pixels stay and leap although nothing is held."""
    same = np.diff(tracks.id) == 0
    step = np.diff(tracks.stamp)
    usual = np.median(step[same]) if same.any() else PERIOD
    stride = int(max(1, np.rint(PERIOD / max(usual, 1e-3))))
    if stride == 1:
        return tracks
    first = np.flatnonzero(np.append(True, ~same))
    place = np.arange(len(tracks.id)) - np.repeat(
        first, np.diff(np.append(first, len(tracks.id)))
    )
    return tracks.take(place % stride == 0)


def _is_crowded(position: np.ndarray) -> bool:
    """Whether any of the people who begin together [N, 2] stand within 0.2 m of another: people on
    one clock do not, those who came one after another through one door do."""
    from scipy.spatial import KDTree

    return (
        len(position) > 1
        and float(KDTree(position).query(position, 2)[0][:, 1].min()) < 0.2
    )


def judge(tracks: Tracks, options: ReadOptions) -> Iterator[tuple[str, bool, str]]:
    """Yield the name of a guard, whether it refuses a recording or only doubts it, and why."""
    steps, pace = pace_of(tracks)
    enough = steps >= ENOUGH
    notes = tracks.reading.notes if tracks.reading else ()
    agreed = next((note for note in notes if note.endswith("agree with the clock")), "")
    if pace < DOUBTED[0] or pace > DOUBTED[1]:
        guard, unit = (
            ("slow", "more than metres") if pace < 2 else ("fast", "cm, mm or pixels")
        )
        yield (
            guard,
            enough
            and not REFUSED[0] <= pace <= REFUSED[1]
            and not (agreed and guard == "slow"),
            f"one step in twenty is faster than {pace:.2f} m/s, of walking people 1.2 to 2.1: is "
            f"the clock too {guard} ({option('fps')}, {option('time_unit')}; SGAN's eth needs "
            f"{option('eth_stride', 6)}), or are coordinates {unit} ({option('unit')})?"
            + f" {agreed}"
            * bool(agreed),
        )
    thin = _every_period(tracks)
    length = np.linalg.norm(np.diff(thin.position, axis=0), axis=1)
    length[np.diff(thin.id) != 0] = np.nan
    usual = np.median(length[length > 0]) if np.any(length > 0) else np.inf
    stay, leap, after = length[:-2], length[1:-1], length[2:]
    leaps = (stay == 0) & (leap > np.maximum(1.6 * after, 0.5 * usual))
    held = np.sum(leaps) / len(thin.id)
    if steps >= FEW and held > 0.01:
        yield (
            "held",
            enough and held > 0.1,
            f"{held:.1%} of the points repeat the one before and are followed by a leap: are "
            "positions held until the next is there?",
        )
    are_whole = np.all(tracks.position == np.rint(tracks.position))
    unscaled = options.unit is None and options.homography is None
    if are_whole and unscaled and len(tracks.id) > 20 and np.ptp(tracks.position) > 20:
        units = f"{option('unit', 'm')}, cm, mm, .."
        line = f"all coordinates are whole numbers, as pixels are: say {units}"
        yield "pixels", enough, line
    ids, first, count = np.unique(thin.id, return_index=True, return_counts=True)
    last = first + count - 1
    padded = np.pad(length, 3, constant_values=np.nan)
    stays = [
        padded[at[:, None] + np.arange(3)].sum(axis=1) == 0 for at in (first + 3, last)
    ]
    went = np.linalg.norm(thin.position[last] - thin.position[first], axis=1) > 1
    start_share = np.unique(thin.position[first], axis=0, return_counts=True)[
        1
    ].max() / len(ids)
    together = thin.stamp[first] == thin.stamp.min()
    together &= len(np.unique(thin.stamp[last])) > len(ids) / 4
    crowded = together.any() and _is_crowded(thin.position[first[together]])
    for guard, share, doubted, refused, line in (
        (
            "ends",
            went & (stays[0] | stays[1]),
            0.2,
            0.5,
            "walk but stay at an end: are positions held?",
        ),
        (
            "origins",
            start_share,
            0.5,
            0.5,
            "begin at one place: has each an own origin?",
        ),
        ("together", together, 0.9, 0.9, "begin at one moment: has each an own clock?"),
    ):
        if len(ids) >= MANY and np.mean(share) > doubted:
            refuse = (
                enough and np.mean(share) > refused and (guard != "together" or crowded)
            )
            yield guard, refuse, f"{np.mean(share):.0%} of the people {line}"
    length = np.linalg.norm(np.diff(tracks.position, axis=0), axis=1)
    length[np.diff(tracks.id) != 0] = np.nan
    across = np.sqrt(
        np.abs(np.linalg.eigvalsh(np.cov(tracks.position.T, bias=True))[0])
    )
    if enough and len(ids) > 1 and across < 0.2:
        yield (
            "line",
            False,
            f"all are within {across:.2f} m of a line: is x or y a height, or both alike?",
        )
    moment, position = _moments(tracks)
    twins = pl.DataFrame([moment, *position.T]).is_duplicated()
    if twins.any():
        yield (
            "twins",
            enough and twins.sum() > 0.1 * len(twins),
            f"{twins.sum()} points are another person's, too: is everybody there twice?",
        )
    spacing = apart_of(tracks)
    if spacing < APART[1]:
        yield (
            "near",
            enough and spacing < APART[0],
            f"a quarter of the people are within {spacing:.2f} m of another, usually 0.5 m or "
            f"more: are coordinates more than metres ({option('unit')}), or is everybody there "
            "twice?",
        )
    step = np.where(np.isnan(length), np.nan, np.diff(tracks.stamp))
    count = np.isfinite(step).sum()
    fast = (
        np.flatnonzero((length > 10 * step) & (step <= GAP * np.nanmedian(step)))
        if count
        else []
    )
    if count >= FEW and 0 < len(fast) < count / 2:
        first = (
            f"the first by person {tracks.id[fast[0]]} at {tracks.stamp[fast[0]]:.2f} s"
        )
        yield (
            "leaps",
            False,
            f"{len(fast)} steps are faster than 10 m/s, {first}: is a person two?",
        )
