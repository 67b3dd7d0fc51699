"""Figures of docs/reliability.md: damage done to models and bags, and what became of it.

    python -m studies.reliability

Some minutes. Every bit of one shipped model's `config.json`, bits of its parameters drawn with a
seed, and bytes of recordings of people in the three kinds of bags are changed, one damage at a
time. Silent is what loads or reads differently, with neither an error nor a warning.
"""

import shutil
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.model_places import shipped_models
from neurosym_jax.simulation.scenarios import simulate
from neurosym_robot.online.frames import frames_of_tracks
from neurosym_robot.ros.bags import BagWriter, read_people
from neurosym_robot.ros.definitions import PEOPLE_TOPICS
from neurosym_robot.ros.messages import make_people

__all__ = ["main"]

FLIPS, MUTATIONS = 1000, 300
COLUMNS = ("refused", "read as before", "other values", "frames lost, said", "frames lost, silent")


def main() -> None:
    """Print the two tables."""
    print("| damage | cases | refused | loaded |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, found in _models(Path(folder)):
            print(f"| {name} | {found.total()} | {found['refused']} | {found['loaded']} |")
    print(f"\n| bag | cases | {' | '.join(COLUMNS)} |\n|{'---|' * (len(COLUMNS) + 2)}")
    for kind in ("bag", "db3", "mcap"):
        with tempfile.TemporaryDirectory() as folder:
            found = _changed_bytes(Path(folder), kind)
        cells = " | ".join(str(found[name]) for name in COLUMNS)
        print(f"| {kind} | {found.total()} | {cells} |")


def _models(folder: Path) -> Iterator[tuple[str, Counter]]:
    """What is damaged, and how often it was refused and loaded."""
    model = folder / "model"
    shutil.copytree(next(path for path in shipped_models() if path.name == "sgan_zara1_8"), model)
    rng = np.random.default_rng(0)
    for name, wanted in (("config.json", None), ("params.safetensors", FLIPS)):
        file = model / name
        bits = 8 * file.stat().st_size
        chosen = range(bits) if wanted is None else rng.choice(bits, wanted, replace=False)
        found: Counter[str] = Counter()
        for bit in map(int, chosen):
            with _changed(file, {bit // 8: 1 << bit % 8}):
                found[_outcome(lambda: load_model(model))] += 1
        what = "each of its bits" if wanted is None else "bits drawn from all"
        yield f"`{name}`, {what}", found


def _outcome(load: Callable[[], object]) -> str:
    try:
        load()
    except InputError:
        return "refused"
    return "loaded"


def _written(path: Path, seconds: float) -> Path:
    """A bag of three people, ten frames a second."""
    with BagWriter(path) as bag:
        for frame in frames_of_tracks(simulate("cross-path", 1, seconds, people=3)):
            frame = frame._replace(stamp=frame.stamp + 1.7e9)
            bag.write(PEOPLE_TOPICS[0], frame.stamp, make_people(bag.new, frame))
    return bag.path


def _content(path: Path) -> list[tuple[float, list, list]]:
    return [(f.stamp, f.ids.tolist(), f.xy.tolist()) for f in read_people(path)]


def _changed_bytes(folder: Path, kind: str) -> Counter:
    """How often a bag of 60 frames was read in which way, with one to three bytes changed."""
    path = _written(folder / f"run.{kind}", 6.0)
    files = [path] if path.is_file() else sorted(path.iterdir())
    wanted, found = _content(path), Counter()
    for seed in range(MUTATIONS):
        rng = np.random.default_rng(seed)
        file = files[0] if seed % 10 == 0 else files[-1]  # metadata.yaml now and then
        size = file.stat().st_size
        damage = {int(rng.integers(size)): int(rng.integers(1, 256)) for _ in range(1 + seed % 3)}
        with _changed(file, damage), warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                got = _content(path)
            except InputError:
                found["refused"] += 1
                continue
        if len(got) != len(wanted):
            found["frames lost, said" if said else "frames lost, silent"] += 1
        else:
            found["read as before" if got == wanted else "other values"] += 1
    return found


class _changed:
    """A context in which bytes of a file are others."""

    def __init__(self, file: Path, damage: dict[int, int]):
        self.file, self.whole = file, file.read_bytes()
        self.damage = damage

    def __enter__(self) -> None:
        broken = bytearray(self.whole)
        for place, by in self.damage.items():
            broken[place] ^= by
        self.file.write_bytes(broken)

    def __exit__(self, *_: object) -> None:
        self.file.write_bytes(self.whole)


if __name__ == "__main__":
    main()
