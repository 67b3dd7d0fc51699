"""The clock of a table: seconds of its times or frames, as far as its witnesses agree."""

import re
from collections.abc import Mapping

import numpy as np

from neurosym_jax.data.reading import ReadOptions, metres_in
from neurosym_jax.data.schema import Schema, role_of
from neurosym_jax.data.table import STEPS, Table
from neurosym_jax.data.tracks import common
from neurosym_jax.data.witnesses import velocity_ratio
from neurosym_jax.errors import InputError, option

__all__ = ["stamps_of", "usual_frames"]

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
DATE = "as 2024-05-01 12:30:00.4 (or use seconds)"
AGREE = 0.15  # share by which witnesses of one rate may differ: velocities are smoothed
RATES = (
    29.97,
    23.976,
    59.94,
    12.5,
)  # frames a second of videos that are no whole numbers


def stamps_of(
    table: Table,
    schema: Schema,
    options: ReadOptions,
    period: float,
    ids: np.ndarray,
    part: np.ndarray,
    position: np.ndarray,
    facts: Mapping[str, str],
) -> tuple[np.ndarray, list[str], list[str]]:
    """[R] seconds, and what to warn of and to note: of the clock that its witnesses agree on.

    Args:
        table: the rows.
        schema: its columns.
        options: what the user says.
        period: seconds of the most common step of frames that nobody knows more about.
        ids: [R] people.
        part: [R] recording of each row.
        position: [R, 2] in the file's unit.
        facts: see `facts_of`.

    Raises: InputError: for witnesses that contradict each other, or a clock that none
        decides.
    """
    place = schema.places[schema.clock]
    warnings, notes = list[str](), list[str]()
    unit = facts.get("unit")
    if unit and options.unit_of(table.path.stem) is None:
        notes.append(f"coordinates in {unit} ({facts['unit_by']})")
    metres = metres_in(options.unit_of(table.path.stem) or unit or "m")
    if schema.clock == "time":
        stamp = _seconds(table, place, options, schema.units.get("time"), notes)
        if "time" not in schema.declared:
            _refuse_other_frames(table, place, stamp, part)
        rate, fps = 1.0, {"the clock": 1.0}
    elif options.time_unit:
        raise InputError(
            f"{table.path}: {option('time_unit')} is of no use: it counts frames"
        )
    else:
        stamp = table.whole_numbers(place)
        stated_rate = options.fps_of(table.path.stem)
        fps = {option("fps"): stated_rate} if stated_rate else {}
        if options.eth_stride and table.path.stem.startswith("biwi_eth"):
            fps = {option("eth_stride"): options.eth_stride / period}
        stated = set(fps)
        if "fps" in facts:
            fps[facts["fps_by"]] = float(facts["fps"])
    ratio = velocity_ratio(table, schema, ids, stamp, position)
    if ratio is not None:
        columns = (
            f"{table.names[schema.places['vx']]}, {table.names[schema.places['vy']]}"
        )
        # Velocities are in the unit of the coordinates, or in metres.
        scale = 1 / metres if not options.homography else 1.0
        rates = (ratio, ratio * scale)
        reference = next(iter(fps.values()), None)
        if reference is None:
            ratio = next((rate for rate in rates if 0.9 < rate < 130), ratio)
        else:
            ratio = min(rates, key=lambda rate: abs(np.log(rate / reference)))
        usual = np.array([round(ratio), *RATES])
        nearest = float(usual[abs(usual - ratio).argmin()])
        ratio = nearest if abs(ratio / (nearest or 1) - 1) < 0.02 else ratio
        fps[f"columns {columns}"] = float(ratio)
    if fps:
        witness, rate = next(iter(fps.items()))
        for other, value in fps.items():
            if abs(np.log(value / rate)) <= np.log1p(AGREE):
                continue
            line = (
                f"{witness} says {rate:g} frames a second, {other} {value:g}"
                if schema.clock == "frame"
                else f"{other} say that people move {value:.3g} times as fast as the clock and "
                "positions do"
            )
            if "clock" not in options.allow:
                raise InputError(
                    f"{table.path}: {line}: which is right? ({option('fps')}, "
                    f"{option('time_unit')}, {option('unit')}, or {option('allow', ('clock',))} "
                    "takes the first)"
                )
            warnings.append(f"allowed clock: {line}")
        if schema.clock == "frame":
            if len(fps) == 1 and ratio is not None:
                witness += (
                    f" alone, which may err by a twentieth: {option('fps')} corrects it"
                )
            if witness not in stated:
                notes.append(f"{rate:g} frames a second ({witness})")
            # In this order 10 frames at 25 a second are 0.4 s exactly.
            stamp = stamp / (rate * period) * period
        if ratio is not None and not any(
            line.startswith("allowed") for line in warnings
        ):
            notes.append(f"{columns} agree with the clock")
    elif schema.clock == "frame":
        if schema.in_picture and np.any(np.diff(np.unique(stamp)) == 1):
            raise InputError(
                f"{table.path}: it has every frame of a video: say how many a second "
                f"({option('fps', 30)})"
            )
        stamp = usual_frames(table, stamp, ids) * period
    return stamp, warnings, notes


def usual_frames(
    table: Table, frame: np.ndarray, ids: np.ndarray, any_step: bool = False
) -> np.ndarray:
    """[R] frames in their most common step of people.

    Raises:
        InputError: where that step is unusual, unless `any_step` will do.
    """
    order = np.lexsort((frame, ids))
    steps = np.diff(frame[order])[
        (np.diff(ids[order]) == 0) & (np.diff(frame[order]) > 0)
    ]
    steps = steps if len(steps) else np.diff(np.unique(frame))
    stride = common(steps) if len(steps) else 1.0
    if not any_step and stride not in STEPS:
        raise InputError(
            f"{table.path}: its frames are {stride:g} apart, at 25 a second {stride / 25:.2f} s: "
            f"say how many make a second ({option('fps', 25)})"
        )
    return frame / stride


def _seconds(
    table: Table, place: int, options: ReadOptions, named: str | None, notes: list[str]
) -> np.ndarray:
    """[R] seconds in a column of times."""
    path, name, unit = table.path, table.names[place], options.time_unit
    if options.fps_of(path.stem) is not None:
        raise InputError(
            f"{path}: {option('fps')} counts frames, and {name!r} is a time"
        )
    if named in _SECONDS:
        if unit and unit != named:
            stated = option("time_unit", unit)
            raise InputError(f"{path}: the name {name!r} says {named}, {stated}")
        if unit is None and named != "s":
            notes.append(f"times in {named} (the name {name!r})")
        unit = named
    texts = table.column(place)
    if re.match(r"\d{4}-\d\d-", texts[0]) and not options.time_unit:
        moments = texts.str.to_datetime(time_unit="us", time_zone="UTC", strict=False)
        wrong = moments.is_null().to_numpy()
        table.refuse(
            wrong, lambda at: f"{texts[at][:40]!r} is not a date and time, {DATE}"
        )
        return moments.dt.timestamp("us").to_numpy() / 1e6
    stamp = table.numbers(place)[:, 0] * _SECONDS[unit or "s"]
    counts = np.unique(stamp)
    if not unit and len(counts) > 10 and (counts == np.rint(counts)).all():
        raise InputError(
            f"{path}: all of {name!r} are whole numbers: do they count frames "
            f"({option('columns', (f'frame={name}',))} {option('fps', 25)}), or is that their unit "
            f"({option('time_unit', 's')} or ms)?"
        )
    return stamp


def _refuse_other_frames(
    table: Table, clock: int, stamp: np.ndarray, part: np.ndarray
) -> None:
    """Refuse a column of frames that counts anything but the times [R] of each recording [R]."""
    places = [at for at, name in enumerate(table.names) if role_of(name) == "frame"]
    frame = (
        table.numbers(*places, missing=True).ravel()
        if len(places) == 1
        else np.zeros(0)
    )
    for number in np.unique(part[: len(frame)]):
        at = (part == number) & np.isfinite(frame)
        first, index = np.unique(frame[at], return_index=True)
        if len(first) < 3:
            continue
        rate, start = np.polyfit(first - first[0], stamp[at][index], 1)
        off = np.max(np.abs(stamp[at] - start - rate * (frame[at] - first[0])))
        if rate <= 0 or off > 0.1 + 2 * rate + 1e-3 * np.ptp(stamp[at]):
            frames, times = table.names[places[0]], table.names[clock]
            raise InputError(
                f"{table.path}: columns {frames!r} and {times!r} disagree: say which is right, "
                f"{option('columns', (f'frame={frames}',))} or time={times}"
            )
