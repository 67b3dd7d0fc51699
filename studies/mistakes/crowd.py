"""A crowd, and the files that say where its people are."""

import dataclasses
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True)
class Crowd:
    """R rows of people who cross a place of 16 m x 12 m in both directions, 0.4 s apart."""

    step: np.ndarray
    id: np.ndarray
    x: np.ndarray
    y: np.ndarray

    @property
    def t(self) -> np.ndarray:
        """Seconds."""
        return (0.4 * self.step).round(3)

    def but(self, **columns: Any) -> "Crowd":
        """The crowd with other columns."""
        return dataclasses.replace(self, **columns)

    def scaled(self, metres: float, decimals: int = 4) -> "Crowd":
        """The crowd in units of so many metres."""
        return self.but(
            x=(self.x / metres).round(decimals), y=(self.y / metres).round(decimals)
        )

    def rows(self, chosen: np.ndarray) -> "Crowd":
        """A part of the rows, or all in another order."""
        return Crowd(self.step[chosen], self.id[chosen], self.x[chosen], self.y[chosen])


def make_crowd(people: int = 48, seed: int = 0, rate: float = 2.5) -> Crowd:
    """People who come one after another; `rate`: points a second."""
    rng = np.random.default_rng(seed)
    rows = []
    for person in range(people):
        way, pace = rng.choice([-1, 1]), rng.normal(1.3, 0.12)
        begin, lane, drift = (
            int(person * 3 * rate / 2.5),
            rng.uniform(1, 11),
            rng.normal(0, 0.06),
        )
        steps = np.arange(int(15 / pace * rate))
        sway = 0.08 * np.sin(steps / rate + rng.uniform(0, 6))
        along = 8 + way * (pace * steps / rate - 7.5) + 0.05 * np.cos(steps / rate)
        rows.append(
            np.stack(
                [begin + steps, 0 * steps + person + 1, along, lane + sway], axis=1
            )
        )
        rows[-1][:, 3] += drift * steps / rate
    step, id, x, y = np.concatenate(rows).T
    return Crowd(step.astype(int), id.astype(int), x.round(4), y.round(4))


CROWD = make_crowd()


def text(crowd: Crowd = CROWD, stride: int = 10, mark: str = "\t") -> str:
    """Rows `frame ped x y`, frames `stride` apart."""
    rows = zip(crowd.step * stride, crowd.id, crowd.x, crowd.y)
    return "".join(mark.join(map(str, row)) + "\n" for row in rows)


def table(crowd: Crowd = CROWD, mark: str = ",", **columns: Any) -> str:
    """A table `t,id,x,y`, with `columns` beside or instead; None leaves one out."""
    named = {"t": crowd.t, "id": crowd.id, "x": crowd.x, "y": crowd.y, **columns}
    named = {name: values for name, values in named.items() if values is not None}
    lines = [mark.join(map(str, row)) for row in zip(*named.values())]
    return "\n".join([mark.join(named), *lines, ""])
