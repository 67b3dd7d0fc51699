"""GeoJSON of people: points with a time each, or lines with times of their points.

Source: RFC 7946. Positions are longitudes and latitudes; of files that name another
`crs`, as before that standard, they are metres of a map, and where they can be no
degrees of people. Times of a line's points stand in a property that is as long as the
line (also in `coordinateProperties`), or are the fourth number of each point.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from neurosym_jax.data.tables import role_of
from neurosym_jax.data.tidy import axes_of
from neurosym_jax.errors import InputError

__all__ = ["rows_of_features"]

GLOBE = ("4326", "CRS84", "4979", "4258", "4269")
"""Ends of names of coordinate systems of longitude and latitude: WGS 84, ETRS89, NAD83."""
NOWHERE = (np.nan, np.nan)
"""The point of a feature without one, which RFC 7946 calls unlocated."""
CLOCKS = ("coordTimes", "datetimes")
LINES = ("LineString", "MultiPoint", "MovingPoint")


def rows_of_features(
    content: Mapping[str, Any],
) -> tuple[list[dict[str, Any]], list[str]]:
    """A row for each point of a collection of features, and notes on how they were read.

    Raises:
        InputError: for features without points, and lines without times.
    """
    rows = []
    for number, feature in enumerate(content["features"]):
        rows += _rows(number, feature)
    points = np.array([(*row.pop("point"), *NOWHERE)[:2] for row in rows], float)
    if not np.isfinite(points).any():
        raise InputError("has no points")
    axes, notes = ("x", "y"), []
    # A system that is a link says nothing here, as if there were none.
    system = (content.get("crs") or {}).get("properties", {}).get("name")
    if system is None or str(system).endswith(GLOBE):
        axes = axes_of(*points.T)
        if axes == ("x", "y"):
            notes.append("metres, for people are not that far apart in degrees")
    for row, point in zip(rows, points.tolist()):
        row.update(zip(axes, point))
    return rows, notes


def _rows(number: int, feature: Mapping[str, Any]) -> Iterator[dict]:
    """A row for each point of a feature: its `point`, and the feature's properties."""
    geometry = feature.get("geometry") or feature.get("temporalGeometry")
    properties = dict(feature.get("properties") or {})
    if not geometry:
        geometry = {"type": "Point", "coordinates": NOWHERE}
    properties |= properties.pop("coordinateProperties", {})
    if "datetimes" in geometry:
        properties["datetimes"] = geometry["datetimes"]
    has_id = "id" in set(map(role_of, properties))
    if geometry["type"] == "Point":
        if not has_id and "id" in feature:
            properties["id"] = feature["id"]
        yield {**properties, "point": geometry["coordinates"]}
        return
    if geometry["type"] not in LINES:
        raise InputError(
            f"feature {number} is a {geometry['type']}: people are points, or "
            "lines with times"
        )
    points = geometry["coordinates"]
    if not has_id:
        properties["id"] = feature.get("id", number)
    times = _times(points, properties)
    if times is None:
        raise InputError(
            f"feature {number} is a line without times: none of its properties "
            f"({', '.join(properties)}) is a list of {len(points)}"
        )
    for time, point in zip(times, points):
        yield {**properties, "time": time, "point": point}


def _times(points: list[list[float]], properties: dict[str, Any]) -> list[Any] | None:
    """The times of a line's points, taken out of its properties; None where there are none."""
    lists = []
    for name, value in properties.items():
        if isinstance(value, list) and len(value) == len(points):
            is_clock = role_of(name.removesuffix("s")) == "time" or name in CLOCKS
            lists.append((not is_clock, name))
    if len(lists) == 1 or (lists and not min(lists)[0]):
        return properties.pop(min(lists)[1])
    if all(len(point) == 4 for point in points):
        return [point[3] for point in points]
    return None
