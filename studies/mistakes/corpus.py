"""The mistakes: a crowd's file with one mistake each, and what must happen to it."""

import dataclasses
import gzip
import json
from typing import Any, Literal

import numpy as np

from studies.mistakes.crowd import CROWD, Crowd, make_crowd, table, text

RNG = np.random.default_rng(1)
SIZE = len(CROWD.id)
OTHER = make_crowd(seed=3)


@dataclasses.dataclass(frozen=True)
class Mistake:
    """A file, and how it is read."""

    name: str
    outcome: Literal["refused", "warned", "read"]
    """Refused; warned of, in the report too; or read, with the windows of the crowd."""
    says: str
    """Pattern of what is said."""
    content: str | bytes
    options: dict[str, Any]
    """Fields of `ReadOptions`."""


def refused(name: str, says: str, content: str | bytes, **options: Any) -> Mistake:
    """A mistake that must be refused."""
    return Mistake(name, "refused", says, content, options)


def warned(name: str, says: str, content: str | bytes, **options: Any) -> Mistake:
    """A mistake that must be warned of."""
    return Mistake(name, "warned", says, content, options)


def read(name: str, content: str | bytes, **options: Any) -> Mistake:
    """No mistake, or one that can be mended."""
    return Mistake(name, "read", "", content, options)


def two_runs(column: str, crowd: Crowd = CROWD, other: Crowd = OTHER) -> str:
    """Two runs on one clock, with the same ids, told apart by a column."""
    pairs = zip(vars(crowd).values(), vars(other).values())
    columns = (np.concatenate(pair) for pair in pairs)
    run = ["a"] * len(crowd.id) + ["b"] * len(other.id)
    return table(Crowd(*columns), **{column: run})


def own_clocks() -> np.ndarray:
    """Seconds since each person came."""
    return np.concatenate(
        [CROWD.t[CROWD.id == id] - CROWD.t[CROWD.id == id][0] for id in IDS]
    )


def frozen(share: float) -> Crowd:
    """Each point is, by chance, the one before."""
    x, y = CROWD.x.copy(), CROWD.y.copy()
    for at in np.flatnonzero(RNG.random(SIZE) < share):
        if at and CROWD.id[at] == CROWD.id[at - 1]:
            x[at], y[at] = x[at - 1], y[at - 1]
    return CROWD.but(x=x, y=y)


def where(chosen: np.ndarray, x: float, y: float) -> Crowd:
    """Some positions are another place."""
    return CROWD.but(x=np.where(chosen, x, CROWD.x), y=np.where(chosen, y, CROWD.y))


def spelt(*prefixes: str) -> list[str]:
    """Ids with one prefix after another."""
    return [f"{prefixes[at % len(prefixes)]}{id}" for at, id in enumerate(CROWD.id)]


def changed(old: str, new: str, part: str = "", count: int = 1) -> str:
    """A file with other characters."""
    return (part or text()).replace(old, new, count)


IDS = np.unique(CROWD.id)
FEW = RNG.random(SIZE) < 0.05
TENTH = RNG.random(SIZE) >= 0.1
STILL = CROWD.but(x=0 * CROWD.x + CROWD.id, y=0 * CROWD.y)
FIRST = np.searchsorted(CROWD.id, CROWD.id)
TIMES = np.where(np.diff(CROWD.id, append=0) == 0, 1, 11)
WAITED = np.concatenate([np.arange(n) for n in TIMES])
HELD = CROWD.rows(np.repeat(np.arange(SIZE), TIMES))
HELD = HELD.but(step=HELD.step + WAITED)
FAST = make_crowd(rate=25)
CENTIMETRES = table(CROWD.scaled(0.01))
TRACKER = make_crowd(rate=10)
ROBOT = np.where(CROWD.id == 5, "robot", "person")
DETECTIONS = CROWD.rows(np.lexsort((RNG.random(SIZE), CROWD.step)))
BY_FRAME = DETECTIONS.but(
    id=np.concatenate(
        [np.arange(n) for n in np.unique(DETECTIONS.step, return_counts=True)[1]]
    )
)
FRAMES = {"frame": 10 * CROWD.step}
LINES = [
    dict(zip("tixy", map(float, row)))
    for row in zip(CROWD.t, CROWD.id, CROWD.x, CROWD.y)
]
NDJSON = "\n".join(json.dumps({**row, "id": int(row.pop("i"))}) for row in LINES)
SPREAD = float(np.std([CROWD.x, CROWD.y]))

MISTAKES = [
    refused("t counts steps", "whole numbers", table(t=CROWD.step)),
    refused("t counts video frames", "whole numbers", table(t=10 * CROWD.step)),
    refused("t is milliseconds", "whole numbers", table(t=400 * CROWD.step)),
    refused(
        "t counts steps, said seconds", "clock", table(t=CROWD.step), time_unit="s"
    ),
    refused("t is milliseconds with fractions", "clock", table(t=1000.5 * CROWD.t)),
    refused("t is minutes", "clock", table(t=CROWD.t / 60)),
    refused("t is hours", "clock", table(t=CROWD.t / 3600)),
    refused(
        "t is nanoseconds since 1970", "time_unit", table(t=CROWD.t * 1e9 + 1.7e18)
    ),
    read("t is called t_ms", table(t=None, t_ms=400 * CROWD.step)),
    refused("t rounded to whole seconds", "whole numbers", table(t=np.floor(CROWD.t))),
    refused(
        "t with decimal commas",
        "columns",
        table(t=[str(t).replace(".", ",") for t in CROWD.t]),
    ),
    warned("t at twice its pace", "too fast", table(t=CROWD.t / 2)),
    refused("t at half its pace", "too slow", table(t=CROWD.t * 2)),
    *(
        refused(
            f"every {n}th frame of a video", f"frames are {n} apart", text(stride=n)
        )
        for n in (2, 3, 4, 5, 8, 9, 15, 20, 25)
    ),
    refused("every frame of a video at 25 fps", "too slow", text(FAST, 1)),
    refused("every frame of a tracker at 10 Hz", "too slow", text(TRACKER, 1)),
    refused("--fps 10 of a video at 25", "too slow", text(), fps=10.0),
    warned("--fps 60 of a video at 25", "too fast", text(), fps=60.0),
    refused("--fps beside times", "is a time", table(), fps=25.0),
    read("frame and time agree", table(**FRAMES)),
    refused(
        "frame and time, of another rate",
        "too slow",
        table(t=CROWD.step * 1.001, **FRAMES),
    ),
    refused(
        "frame goes on where time begins again",
        "disagree",
        table(t=np.where(CROWD.step > 90, CROWD.t - 36.2, CROWD.t), **FRAMES),
    ),
    refused("frame backward beside time", "disagree", table(frame=-CROWD.step)),
    refused(
        "frame of a row off by ten steps",
        "disagree",
        table(frame=10 * CROWD.step + 100 * (CROWD.id == 9)),
    ),
    refused(
        "everybody's clock begins at 0", "begin at one moment", table(t=own_clocks())
    ),
    warned(
        "rows in another order",
        "runs backward",
        table(CROWD.rows(RNG.permutation(SIZE))),
    ),
    read("a stamp moved by 1 ms", table(t=CROWD.t + 0.001 * (np.arange(SIZE) == 99))),
    *(
        read(f"two runs, column {name}", two_runs(name))
        for name in (
            "scene",
            "run",
            "camera",
            "recording",
            "video",
            "Sequence",
            "recordingId",
            "clip",
        )
    ),
    warned(
        "a person goes on in another camera",
        "goes on in another",
        table(camera=np.where(CROWD.x > 8, "b", "a")),
    ),
    refused(
        "two runs and no column",
        "repeats",
        changed("run", "note", part=two_runs("run")),
        columns=("note=note",),
    ),
    warned("label robot", "left out", table(label=ROBOT)),
    warned(
        "type car", "left out", table(type=np.where(CROWD.id % 7, "Pedestrian", "Car"))
    ),
    warned("Object Class robot", "left out", table(**{"Object Class": ROBOT})),
    warned(
        "robot in the second of two columns",
        "left out",
        table(label=["person"] * SIZE, agent_type=ROBOT),
    ),
    warned(
        "label robot, named as an extra",
        "left out",
        table(kind=ROBOT),
        columns=("group=kind",),
    ),
    warned(
        "tracks held where they end, lost 1",
        "lost True are left out",
        table(HELD, lost=WAITED > 0),
    ),
    warned("a column that somewhere says robot", "left out", table(role=ROBOT)),
    refused("class in numbers", "keep", table(**{"class": CROWD.id % 2})),
    refused("agent_type robot alone", "keep", table(agent_type=["robot"] * SIZE)),
    refused("--keep names no kind", "keep", table(label=ROBOT), keep=("cyclist",)),
    refused("--keep without kinds", "keep", table(), keep=("person",)),
    read("label ped throughout", table(label=["ped"] * SIZE)),
    read("every kind kept", table(label=ROBOT), keep=("person", "Robot")),
    refused("coordinates in 0..1", "metres", text(CROWD.scaled(16, 6))),
    refused("z-scores", "metres", text(CROWD.scaled(SPREAD, 6))),
    refused("a map at a tenth", "metres", text(CROWD.scaled(10))),
    refused("a map at half", "metres", text(CROWD.scaled(2))),
    warned("a map at twice", "too fast", text(CROWD.scaled(0.5))),
    refused("degrees of longitude", "metres", table(CROWD.scaled(111000, 9))),
    refused("kilometres", "metres", text(CROWD.scaled(1000, 6))),
    refused("feet", "too fast", text(CROWD.scaled(0.3048))),
    refused("decimetres", "unit", text(CROWD.scaled(0.1))),
    refused("centimetres", "unit", text(CROWD.scaled(0.01))),
    refused("millimetres", "unit", text(CROWD.scaled(0.001, 0))),
    refused("pixels with fractions", "pixels", text(CROWD.scaled(0.032))),
    refused(
        "whole pixels, frames too fast by ten",
        "no 8 consecutive steps",
        text(CROWD.scaled(0.1, 0)),
        fps=2.5,
    ),
    refused(
        "a tenth, and a clock too fast by ten",
        "no 8 consecutive steps",
        text(CROWD.scaled(10)),
        fps=250.0,
    ),
    refused("--unit cm of metres", "metres", text(), unit="cm"),
    refused("--unit px", "0.032", text(), unit="px"),
    read("x is called x [cm]", changed("x,y", "x [cm],y [cm]", part=CENTIMETRES)),
    refused(
        "y is called y [mm]",
        "which is right",
        changed("x,y", "x [cm],y [mm]", part=CENTIMETRES),
    ),
    read("pixels of 3.2 cm, said", text(CROWD.scaled(0.032, 9)), unit="0.032"),
    read(
        "metres in map coordinates", text(CROWD.but(x=CROWD.x + 5e5, y=CROWD.y + 5e6))
    ),
    refused("ids are places in a list", "", text(BY_FRAME)),
    refused("one id for everybody", "repeats", text(CROWD.but(id=0 * CROWD.id))),
    warned(
        "two people exchange ids",
        "is a person two",
        text(where((CROWD.id == 20) & (CROWD.step > 75), -9, 40)),
    ),
    refused(
        "ped before frame",
        "say columns=.'id=1', 'frame=2', 'x=3', 'y=4'",
        text(CROWD.but(step=CROWD.id, id=CROWD.step), 1),
    ),
    refused("ids 1 and 01", "one number", changed("\t1\t", "\t01\t")),
    refused("ids P1 and p1", "one number or word", table(id=spelt("P", "p"))),
    refused("ids P1 and P01", "one number or word", table(id=spelt("P", "P0"))),
    warned("an id missing", "1 rows with no id", changed(",7,", ",,", part=table())),
    refused("an id with a fraction", "not a whole", changed("\t7\t", "\t7.5\t")),
    refused(
        "everybody twice, under other ids",
        "twice",
        text() + text(CROWD.but(id=CROWD.id + 500)),
    ),
    refused(
        "everybody twice, by trackers 13 ms apart",
        "everybody there twice",
        table()
        + table(CROWD.but(id=CROWD.id + 500), t=CROWD.t + 0.013).split("\n", 1)[1],
    ),
    refused("tracks held where they end", "positions held", text(HELD)),
    refused(
        "positions from where each began",
        "begin at one place",
        text(CROWD.but(x=CROWD.x - CROWD.x[FIRST], y=CROWD.y - CROWD.y[FIRST])),
    ),
    warned(
        "y is a height", "of a line", text(CROWD.but(y=1.7 + 0.1 * np.sin(CROWD.step)))
    ),
    refused("a fifth of positions frozen", "held", text(frozen(0.2))),
    warned("a twentieth of positions frozen", "held", text(frozen(0.05))),
    refused("nobody moves", "too slow", text(STILL)),
    warned("missing positions are 0, 0", "which people share", text(where(FEW, 0, 0))),
    warned(
        "a missing position is -1, -1",
        "is a person two",
        text(where(np.arange(SIZE) == 510, -1, -1)),
    ),
    warned(
        "missing positions are -3000",
        "which people share",
        text(where(FEW, -3000, -3000)),
    ),
    warned(
        "noise of half a metre",
        "",
        text(CROWD.but(x=CROWD.x + RNG.normal(0, 0.5, SIZE))),
    ),
    refused("positions in whole metres", "", text(CROWD.scaled(1, 0))),
    refused(
        "moves instead of positions",
        "",
        text(CROWD.but(x=np.diff(CROWD.x, prepend=0), y=np.diff(CROWD.y, prepend=0))),
    ),
    refused(
        "x twice",
        "must be 4 columns",
        table(),
        columns=("time=t", "id=id", "x=x", "y=x"),
    ),
    refused("a position not known", "not a number", changed("\n10\t1\t", "\n10\t1\t?")),
    warned(
        "a position nan",
        "without a position",
        table(x=np.where(CROWD.step == 9, np.nan, CROWD.x)),
    ),
    read("a tenth of the rows missing", text(CROWD.rows(TENTH))),
    read(
        "a tenth missing, a stamp moved",
        table(
            CROWD.rows(TENTH), t=CROWD.t[TENTH] + 0.001 * (np.arange(TENTH.sum()) == 99)
        ),
    ),
    read("a step missing for everybody", text(CROWD.rows(CROWD.step != 80))),
    refused("a row cut short", "columns, not 4", text()[:-9].rsplit("\t", 1)[0]),
    warned("a row repeated", "stand twice", text() + text().split("\n")[40]),
    read("decimal commas", text().replace(".", ",")),
    read("semicolons", text(mark=";")),
    read("a byte-order mark, Windows lines", "\ufeff" + table().replace("\n", "\r\n")),
    read("UTF-16", text().encode("utf-16")),
    refused("a head without rows", "no rows", "t,id,x,y\n"),
    refused(
        "two columns x",
        "column is x",
        changed("label", "x", part=table(label=CROWD.id)),
    ),
    refused("no ids", "which column is id", table(id=None)),
    refused(
        "velocities without names",
        "columns",
        text(mark=" ").replace("\n", " 1.3 0.0\n"),
    ),
    refused(
        "TrajNet++ of two rates",
        "differ in fps",
        "".join(
            f'{{"scene": {{"fps": {n}}}}}\n{{"track": {{"f": 1, "p": {n}}}}}\n'
            for n in (2, 3)
        ),
    ),
    read("objects a line", NDJSON),
    read("compressed with gzip", gzip.compress(text().encode())),
]
