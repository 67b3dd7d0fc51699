"""What a recording's people say of its clock and unit; the corpus is `studies.mistakes`."""

import dataclasses

import numpy as np
import pytest

from neurosym_jax.data import ReadOptions, make_tracks, on_grid, read_any, windows_from
from neurosym_jax.data.evidence import judge, pace_of
from neurosym_jax.data.recordings import recordings_in
from neurosym_jax.data.tracks import describe_readings
from neurosym_jax.errors import InputError, InputWarning


def walk(pace=1.3, people=4, steps=40, period=0.4, spacing=0.7):
    """People side by side."""
    frame, person = np.divmod(np.arange(steps * people), people)
    place = np.stack([frame * period * pace, spacing * person], axis=1)
    return make_tracks("walk", frame * period, person, place)


def write(path, tracks):
    rows = zip(tracks.stamp, tracks.id, *tracks.position.T)
    path.write_text("t,id,x,y\n" + "\n".join(",".join(map(str, row)) for row in rows))


def test_pace():
    assert pace_of(walk()) == (156, pytest.approx(1.3))
    fast = walk(steps=320, period=0.05)
    noise = np.random.default_rng(0).normal(0, 0.02, (1280, 2))
    noisy = dataclasses.replace(fast, position=fast.position + noise)
    assert pace_of(noisy)[1] == pytest.approx(1.4, abs=0.1), "noise is not walking"


def strides(*changes, people=4, steps=39, usual=0.44, period=0.4):
    """People who walk along x; at `at`, (person, step) or a slice, a stride is as long as said."""
    length = np.full((people, steps), usual)
    for at, value in changes:
        length[at] = value
    x = np.pad(length.cumsum(axis=1), ((0, 0), (1, 0)))
    person, step = np.divmod(np.arange(x.size), steps + 1)
    return make_tracks(
        "strides", period * step, person, np.stack([x.ravel(), 0.7 * person], axis=1)
    )


def held(count, leap=0.88, after=0.44):
    """A person stays for a step and then leaps, so often."""
    places = [divmod(3 * n, 36) for n in range(count)]
    changes = [((who, slice(at, at + 3)), [0, leap, after]) for who, at in places]
    return strides(*changes)


def together(people=20, ends=6, late=0):
    """People begin at one moment but for some, and leave at so many."""
    tracks, last = strides(people=people), 39 - np.arange(people) % ends
    return tracks.take(
        (tracks.stamp <= 0.4 * last[tracks.id] + 0.1)
        & ((tracks.id >= late) | (tracks.stamp > 0))
    )


def side_by_side(metres):
    """All begin together, and two of them so near."""
    tracks = together()
    position = tracks.position.copy()
    position[tracks.id == 1, 1] = metres
    return dataclasses.replace(tracks, position=position)


def twins(count):
    tracks = strides()
    position = tracks.position.copy()
    position[40 : 40 + count, 1] = 0
    return dataclasses.replace(tracks, position=position)


def stayed(count, where):
    """So many of 20 people stay for three steps where their tracks begin or end."""
    return strides(((slice(count), where), 0), people=20)


def turned(step):
    """As many as are doubted stay at first, then walk back until a step, and then on."""
    return strides(
        ((slice(5), slice(3)), 0), ((slice(5), slice(3, step)), -0.44), people=20
    )  # 0.88 m in all with 20, 1.76 m with 19


def from_own_origin(count):
    """So many of 20 people, who come one after another, begin at 0, 0."""
    tracks = strides(people=20)
    start = [1.0, 0.7] * tracks.id[:, None] * (tracks.id < count)[:, None]
    position = tracks.position + [[1.0, 0.0]] * tracks.id[:, None] - start
    return dataclasses.replace(
        tracks, stamp=tracks.stamp + 0.4 * tracks.id, position=position
    )


FINE, DOUBT, NO = [], [False], [True]


@pytest.mark.parametrize(
    ("tracks", "refused"),
    [
        *[
            (walk(0.89), NO),
            (walk(0.91), DOUBT),
            (walk(1.04), DOUBT),
            (walk(1.06), FINE),
        ],
        *[
            (walk(2.49), FINE),
            (walk(2.51), DOUBT),
            (walk(4.49), DOUBT),
            (walk(4.51), NO),
        ],
        # People side by side, however near, and one alone.
        *[(walk(spacing=0.15, people=9), FINE), (walk(people=1, steps=200), FINE)],
        # Few steps are no reason to refuse.
        *[(walk(9, steps=26), NO), (walk(9, steps=25), DOUBT)],
        # 160 points: one in a hundred and one in ten; a leap is 1.6 strides, or half a
        # usual one.
        *[(held(1), FINE), (held(2), DOUBT), (held(16), DOUBT), (held(17), NO)],
        *[(held(2, 0.70), FINE), (held(2, 0.71), DOUBT)],
        *[(held(2, 0.21, 0), FINE), (held(2, 0.23, 0), DOUBT)],
        # Who begin at one moment are refused only if two of them stand at one place, as
        # no crowd.
        *[(together(), DOUBT), (together(19), FINE), (together(ends=5), FINE)],
        *[(together(late=1), DOUBT), (together(late=2), FINE)],
        *[(side_by_side(0.21), DOUBT), (side_by_side(0.19), NO)],
        *[
            (stayed(4, slice(3)), FINE),
            (stayed(5, slice(3)), DOUBT),
            (stayed(5, slice(2)), FINE),
        ],
        *[(stayed(10, slice(-3, None)), DOUBT), (stayed(11, slice(-3, None)), NO)],
        *[(turned(19), DOUBT), (turned(20), FINE)],
        *[(from_own_origin(10), FINE), (from_own_origin(11), NO)],
        *[(twins(0), FINE), (twins(1), DOUBT), (twins(8), DOUBT), (twins(9), NO)],
        *[(strides(((0, 9), 3.9)), FINE), (strides(((0, 9), 4.1)), DOUBT)],
    ],
)
def test_each_bound_holds(tracks, refused):
    assert [refused for _, refused, _ in judge(tracks)] == refused


def test_a_guard_is_waived_by_its_name(tmp_path):
    path = tmp_path / "a.csv"
    write(path, walk(0.3))
    with pytest.raises(InputError, match=r"faster than 0\.30 m/s.* allow=\('slow',\)"):
        read_any(path)
    with pytest.warns(InputWarning, match=r"faster than 0\.30 m/s"):
        (tracks,) = read_any(path, ReadOptions(allow=("slow",)))
    assert tracks.reading
    assert tracks.reading.warnings[0].startswith("allowed slow: one step in twenty")
    with pytest.raises(InputError, match=r"allow=\('slow',\)"):
        read_any(path, ReadOptions(allow=("fast", "held")))
    with pytest.raises(
        InputError, match=r"allow is one of slow, fast, .*, not 'brisk'"
    ):
        ReadOptions(allow=("brisk",))


@pytest.mark.filterwarnings("ignore::neurosym_jax.errors.InputWarning")
def test_known_recordings_are_accepted(shared):
    """All of them, of which only eth's clock is doubted."""
    eth_ucy, thor = shared / "data/eth_ucy", shared / "data/thor"
    recordings = recordings_in([*sorted(eth_ucy.glob("*/*.txt")), thor])
    assert len(recordings) == 30
    warned = {
        tracks.recording: tracks.reading.warnings
        for tracks in recordings
        if tracks.reading
    }
    doubted = {name: lines for name, lines in warned.items() if lines}
    assert doubted.keys() == {"biwi_eth", "biwi_eth_train", "biwi_eth_val"}
    assert "needs eth_stride=6" in doubted["biwi_eth"][0]
    (tracks,) = read_any(eth_ucy / "all/biwi_eth.txt", ReadOptions(eth_stride=6))
    assert tracks.reading
    assert not tracks.reading.warnings


def test_gaps_are_filled_alike_on_the_grid_and_off_it(tmp_path):
    complete = walk(people=3, steps=60)
    is_present = np.random.default_rng(0).random(180) >= 0.1
    counts = []
    for moved, max_gap in ((0.0, 1.0), (0.001, 1.0), (0.001, 0.5)):
        stamp = complete.stamp + moved * (np.arange(180) == 90)
        write(
            tmp_path / "a.csv",
            dataclasses.replace(complete, stamp=stamp).take(is_present),
        )
        read = ReadOptions(max_gap=max_gap)
        windows = windows_from(tmp_path / "a.csv", 8, 8, min_agents=1, read=read)
        counts.append((windows.scenes, windows.agents))
        (reading,) = windows.reading
        if max_gap == 1.0:
            assert 5 < reading.filled <= (~is_present).sum() + 1
            assert f"{reading.filled} points filled in gaps" in describe_readings(
                windows.reading
            )
    assert reading.filled == 0
    assert counts[0] == counts[1]
    assert counts[2][1] < counts[1][1] / 2
    part = complete.take(complete.stamp.round(3) != 4.0)
    assert [len(on_grid(part, max_gap=longest).id) for longest in (1.0, 0.7)] == [
        180,
        177,
    ]
