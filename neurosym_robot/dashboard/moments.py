"""The stream as lines of JSON for the page: an introduction, then a moment for every frame.

The introduction has `title`, `period` [s], `observed` [s] that a window lasts,
`models`, `weighting` (the model whose symbols and weights are shown, and their name),
`place` (whether one is watched), `map` and `likely`.

A moment has

- `t`: seconds since the first frame; it increases even if the stream's clock is set
back;
- `ids`, `xy`: people seen, ids as text (JavaScript counts to 2**53 only), `xy` flat in
metres;
- `more`: how many others were seen; `robot`: its x, y [m] and heading [rad];
- `now`: `Status.now()` without its score and flows;
- `flows`: what the place taught, if that is new: rows of x, y, way x, way y [m], share and
  people, see `models.place.flows`;
- `step`, once a period if there is a forecast: its `t` and the `ids` [N] of its people;
  `seen` [N][obs_len * 2] metres, and `extrapolated` [N], how many of its last steps
  nobody saw, `since` [N] seconds it was seen; `models`, each with `samples` [N][k][pred_len * 2] whole centimetres from
  the last observed position, their probabilities `weights` [k] and the index `central`
  of the central forecast, and `regions` [N][T] as x, y, two half axes of one standard
  deviation [cm], the first axis' angle, and the radii of the 50 and 90 % regions in
  standard deviations; `codes`, the states of the pairs (0, 1), (0, 2), ... (N-2,
  N-1), or null; `alpha` [N * N] or null; `likely` events as (name, k, l, probability, seconds),
  and `score`. Beside an .onnx file alone, pairs have neither codes nor events.

The last line has the final `score` alone.
"""

import base64
import collections
import io
import itertools
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data.tracks import SNAP
from neurosym_jax.errors import InputError
from neurosym_jax.runtime.foreign import read_yaml
from neurosym_robot.online.pairs import AT_LEAST, likely_events
from neurosym_robot.online.predictor import Forecast, Predictor
from neurosym_robot.online.regions import Regions
from neurosym_robot.online.replay import ReplayEvent
from neurosym_robot.tracking.following import FAR
from neurosym_robot.tracking.names import name_of

MAX_NAMED = 256  # people named in a moment, and people without a forecast named in it
# Seconds on the page between what was before the clock was set back and what comes
# after.
BREAK = 60.0
CELLS = 2**26  # of a map; larger ones are refused
LARGEST = 4096  # pixels along a side; larger maps are shown coarser
UNKNOWN = 48  # opacity of cells of which nothing is known, of 255


class Moments:
    """Turns what follows from frames into lines of JSON for the page."""

    def __init__(
        self,
        predictor: Predictor,
        *,
        title: str = "",
        floor_map: Path | None = None,
        at_least: float = AT_LEAST,
    ):
        """Begin a page with a title, a map as of `read_floor_map`, and events from `at_least`."""
        window, self._period = predictor.window, predictor.window.period
        models = predictor.models
        weighting = likely = None
        self.pairs = None
        """What tells the symbols of pairs, if a model is in JAX."""
        if not predictor.is_light:
            # Only here, so that the page of an .onnx file needs no JAX.
            from neurosym_robot.dashboard.pair_symbols import PairSymbols

            self.pairs = pairs = PairSymbols(models, window.period)
            weighting = pairs.weighting
            words = {"model": pairs.model, "words": pairs.words}
            likely = {"at_least": at_least, **words}
        self._flows: Any = []
        self._at_least, self._wait = at_least, window.period - SNAP
        self._start = self._stamp = self._told = math.nan
        predictor.programs.add(self._step)
        self.introduction = _json(
            {
                "title": title,
                "period": window.period,
                "observed": (window.steps - 1) * window.period,
                "models": list(models),
                "weighting": weighting,
                "place": predictor.place is not None,
                "map": None if floor_map is None else read_floor_map(floor_map),
                "likely": likely,
            }
        )

    def moment(self, event: ReplayEvent, now: Mapping[str, Any]) -> str | None:
        """The line of a frame; None if its stamp is refused. `now` is `Status.now()`."""
        frame, forecast = event.frame, event.forecast
        if not event.accepted:
            return None
        stamp = float(frame.stamp)
        if math.isnan(self._start):
            self._start = stamp
        elif stamp <= self._stamp:  # The clock was set back; time on the page goes on.
            self._start += stamp - self._stamp - BREAK
        self._stamp = stamp
        rows = np.flatnonzero((np.abs(frame.xy) < FAR).all(axis=1))
        near = rows[:MAX_NAMED]
        missing = itertools.islice(now["missing"].items(), MAX_NAMED)
        status = {**now, "missing": {name_of(id): reason for id, reason in missing}}
        score, step = status.pop("score"), None
        flows = status.pop("flows")
        is_new = flows is not self._flows
        self._flows = flows
        is_due = not 0 <= frame.stamp - self._told < self._wait
        if is_due and forecast is not None and len(forecast.ids):
            self._told = forecast.stamp
            step = {**self._step(forecast), "score": score}
        return _json(
            {
                "t": round(self._stamp - self._start, 3),
                "ids": [name_of(id) for id in frame.ids[near].tolist()],
                "xy": np.round(frame.xy[near], 3).ravel().tolist(),
                "more": len(rows) - len(near),
                "robot": None
                if event.robot is None
                else np.round(event.robot, 3).tolist(),
                "now": status,
                "step": step,
                # Without rows, too: those of a dropped memory vanish from the page.
                "flows": flows if is_new else None,
            }
        )

    @staticmethod
    def ending(score: Mapping[str, Any]) -> str:
        """The last line, with the final score."""
        return _json({"score": score})

    def _step(self, forecast: Forecast) -> dict[str, Any]:
        last, people = forecast.observed[:, -1:], len(forecast.ids)
        models = {}
        for name, result in forecast.models.items():
            futures, weights, central = result.weighted
            ways = np.moveaxis(futures - last, 0, 1).reshape(people, len(futures), -1)
            models[name] = {
                "central": central,
                "weights": np.round(weights, 4).tolist(),
                "samples": np.rint(100 * ways).astype(np.int64).tolist(),
                "regions": _ellipses(result.regions, last),
            }
        return {
            "t": round(forecast.stamp - self._start, 3),
            "ids": [name_of(id) for id in forecast.ids.tolist()],
            "seen": np.round(forecast.observed, 3).reshape(people, -1).tolist(),
            "extrapolated": forecast.extrapolated.tolist(),
            "since": np.round(forecast.seen, 3).tolist(),
            "models": models,
            **self._symbols(forecast),
        }

    def _symbols(self, forecast: Forecast) -> dict[str, Any]:
        """Codes, alpha and likely events of pairs; none without a model in JAX."""
        if self.pairs is None:
            return {"codes": None, "alpha": None, "likely": []}
        codes, alpha = self.pairs.newest(forecast.observed)
        if alpha is not None:
            alpha = np.round(alpha, 4).ravel().tolist()
        model = self.pairs.model
        events = likely_events(forecast, model, self._period, self._at_least)
        # The most probable of each pair; then of every kind, so that frequent kinds
        # hide no other.
        pairs = {frozenset((event.k, event.l)): event for event in reversed(events)}
        turns, counts = [], collections.Counter()
        events = [event for event in events if event in pairs.values()]
        for event in events:
            turns.append(counts[event.name])
            counts[event.name] += 1
        likely = [events[n] for n in np.argsort(turns, kind="stable")]
        return {
            "codes": codes[np.triu_indices(len(codes), 1)].tolist(),
            "alpha": alpha,
            "likely": [
                (*event[:3], *np.round(event[3:], 3).tolist()) for event in likely
            ],
        }


def _ellipses(regions: Regions, last: np.ndarray) -> list[Any]:
    """[N][T] ellipses: centre and half axes in centimetres, angle, and radii by level."""
    axes, angle = regions.axes()
    numbers = [
        100 * (regions.mean - last),
        100 * axes,
        angle[..., None],
        np.moveaxis(regions.radius, 0, -1),
    ]
    return np.round(np.concatenate(numbers, axis=-1), 2).tolist()


def _json(value: Any) -> str:
    """One line that can stand in an HTML script, which `<` could end."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def read_floor_map(path: Path) -> dict[str, Any]:
    """A map as ROS's map_server saves it: a `.yaml` file that names an image.

    Returns:
        `image`, a PNG as data URL whose opacity is how occupied a cell is; `width` and
        `height` [m]; and `origin` [x, y, yaw] of the lower left corner in metres and
        radians.

    Raises:
        InputError: naming the file and what is wrong with it.
    """
    import yaml
    from PIL import Image

    try:
        fields = {"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196}
        fields |= read_yaml(path, "a map")
        resolution = float(fields["resolution"])
        x, y, yaw = map(float, fields["origin"])
        if not (resolution > 0 and np.isfinite([resolution, x, y, yaw]).all()):
            raise ValueError("resolution must be positive and the origin finite")
        with Image.open(path.parent / str(fields["image"])) as image:
            width, height = image.size
            if width * height > CELLS:
                raise ValueError(f"{width} x {height} cells are more than {CELLS}")
            grey = image.convert("L")
        level = np.arange(256) / 255
        chance = level if int(fields["negate"]) else 1 - level
        opacity = np.where(chance < float(fields["free_thresh"]), 0, UNKNOWN)
        opacity[chance > float(fields["occupied_thresh"])] = 255
    except (
        OSError,
        ValueError,
        TypeError,
        LookupError,
        yaml.YAMLError,
        Image.DecompressionBombError,
    ) as error:
        reason = f"not a map with image, resolution and origin ({' '.join(str(error).split())})"
        raise InputError(f"{path}: {reason}") from None
    alpha = grey.point(opacity.tolist())
    alpha.thumbnail((LARGEST, LARGEST))
    picture = Image.new("LA", alpha.size)
    picture.putalpha(alpha)
    file = io.BytesIO()
    picture.save(file, "PNG", optimize=True)
    return {
        "image": "data:image/png;base64," + base64.b64encode(file.getvalue()).decode(),
        "width": round(width * resolution, 6),
        "height": round(height * resolution, 6),
        "origin": [x, y, yaw],
    }
