"""Sources of recordings by name of the data set (simulations, ETH/UCY, files), and their places.

A source reads files only when recordings are asked for.
"""

import abc
import dataclasses
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

from neurosym_jax.data import formats
from neurosym_jax.data.clock import on_grid, resample
from neurosym_jax.data.readers import eth_ucy
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.tracks import PERIOD, Tracks
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError, option, printable

__all__ = [
    "GENERAL",
    "EthUcy",
    "Files",
    "Folders",
    "Source",
    "Synthetic",
    "data_folder",
    "find",
]
__all__ += ["licences_of", "open_source", "windows_from"]

Split = Literal["train", "val", "test"]

GENERAL = "general"
"""Held-out data set of models that are trained on all of them and tested on other people."""

COLLECTIONS = (
    "eth-ucy",
    "sgan-checkpoints",
    "thor",
)  # that are downloaded into `data_folder()`

_LICENCES = {
    # What forbids a use is called restricted, and learned from by no model that ships.
    **dict.fromkeys(("sdd", "stanford"), ("SDD", "CC BY-NC-SA 3.0, restricted")),
    "simulations": ("simulations", "MIT"),
}

_PARTS = {"train": ("train",), "val": ("val", "valid", "validation"), "test": ("test",)}
# Names of the folders of a user's own split.


@dataclasses.dataclass(frozen=True)
class Source(abc.ABC):
    """Named data sets and their recordings."""

    scenes: tuple[str, ...]  # names of the data sets
    read: ReadOptions = AS_IT_SAYS
    period: float = PERIOD  # seconds between steps, to which recordings are resampled
    paths: tuple[Path, ...] = ()  # all files
    name: ClassVar[str] = (
        ""  # of all data sets together, if a model may be tested on all of them
    )
    about: ClassVar[str] = (
        ""  # what it contains, for people who did not ask for it by name
    )

    def recordings(self, scene: str, split: Split = "test") -> list[Tracks]:
        """Recordings of one split of `scene`, or of all data sets for `GENERAL`.

        Raises:
            InputError: for an unknown data set.
        """
        if scene not in self.scenes and (scene != GENERAL or split == "test"):
            raise InputError(
                f"unknown data set {scene!r}: there are {', '.join(self.scenes)}"
            )
        return self._on_grid(self._read(scene, split))

    def files(self, names: Sequence[str]) -> list[Tracks]:
        """Recordings by path of a file or folder, or by name without ending of a source's file.

        Raises:
            InputError: for an unknown name.
        """
        available = {printable(path.stem): path for path in self.paths}
        for name in names:
            if name not in available and not os.path.exists(name):
                among = ", ".join(sorted(available)) or "nothing"
                raise InputError(f"{name}: no such file, nor a recording among {among}")
        paths = [available.get(name, Path(name)) for name in names]
        return self._on_grid(formats.recordings_in(paths, self.read))

    @abc.abstractmethod
    def _read(self, scene: str, split: Split) -> Iterable[Tracks]:
        """The recordings as they are in the files."""

    def _on_grid(self, recordings: Iterable[Tracks]) -> list[Tracks]:
        return [
            on_grid(tracks, self.period, self.read.max_gap) for tracks in recordings
        ]


@dataclasses.dataclass(frozen=True)
class Synthetic(Source):
    """Simulations of the robot paper's two scenarios; each split has its own seeds."""

    scenes: tuple[str, ...] = ("all-forward", "cross-path")
    name = "simulations"
    about = "Simulated people who walk together (all-forward) and cross (cross-path)."

    def _read(self, scene: str, split: Split) -> Iterable[Tracks]:
        if scene == GENERAL:
            raise InputError(
                f"{scene} is for models of real people: say of whom with {option('data')}"
            )
        from neurosym_jax.simulation.scenarios import simulate

        seeds = {"test": range(2), "val": range(100, 102), "train": range(200, 208)}[
            split
        ]
        return (resample(simulate(cast(Any, scene), seed), PERIOD) for seed in seeds)


@dataclasses.dataclass(frozen=True)
class EthUcy(Source):
    """ETH/UCY with its leave-one-out splits, in `folder`."""

    folder: Path = Path()
    scenes: tuple[str, ...] = tuple(eth_ucy.SCENES)

    def _read(self, scene: str, split: Split) -> Iterable[Tracks]:
        own = None if scene == GENERAL else scene
        return formats.recordings_in(
            eth_ucy.split_files(self.folder, own, split), self.read
        )


@dataclasses.dataclass(frozen=True)
class Files(Source):
    """A user's files of any known format; each is a data set named after the file.

    All but the one under test are for training, which keeps a part of them for
    validation.
    """

    def _read(self, scene: str, split: Split) -> Iterable[Tracks]:
        test = split == "test"
        paths = [path for path in self.paths if (printable(path.stem) == scene) == test]
        if not paths:
            raise InputError(
                f"{scene}: the only recording, so nothing is left to train on (without --dataset "
                "it is trained on, and nothing is left to test on)"
            )
        return () if split == "val" else formats.recordings_in(paths, self.read)


@dataclasses.dataclass(frozen=True)
class Folders(Source):
    """A folder with a user's own split: train, val and, where there is one, test.

    The data sets are the files of `test`.
    """

    folder: Path = Path()

    def _read(self, scene: str, split: Split) -> Iterable[Tracks]:
        if split == "test":
            return formats.recordings_in(
                [self.paths[self.scenes.index(scene)]], self.read
            )
        return formats.recordings_in(_part(self.folder, split), self.read)


def _part(folder: Path, split: Split) -> Path | None:
    """The folder of one part of a user's own split, if it is there."""
    return next(
        (folder / name for name in _PARTS[split] if (folder / name).is_dir()), None
    )


def open_source(
    data: str | Path | None,
    scene: str | None = None,
    model_scene: str | None = None,
    read: ReadOptions = AS_IT_SAYS,
    period: float = PERIOD,
) -> Source:
    """The source at `data`: ETH/UCY as SGAN arranges it, a recording, or a folder of
    recordings, which may be divided into folders train, val and test.

    The path may be below the folder of downloads. By default it is the downloaded
    collection that has the data set `scene`, or else the model's held-out
    `model_scene`, or the simulations.

    Raises:
        InputError: if nothing is there.
    """
    shared: Any = {"read": read, "period": period}
    if data is None:
        target = scene or model_scene
        data = data_folder() / ("eth-ucy" if target in eth_ucy.SCENES else "thor")
        available = target in (*eth_ucy.SCENES, *(path.stem for path in data.glob("*")))
        if not available or not data.is_dir():
            if scene in eth_ucy.SCENES:
                raise InputError(
                    f"data set {scene} belongs to ETH/UCY: say with {option('data')} where that "
                    "is, or fetch it once: python -m neurosym_jax download eth-ucy"
                )
            return Synthetic(**shared)
    data = find(Path(data))
    if not os.path.exists(data):
        hint = f": `neurosym download {data}` fetches it" * (str(data) in COLLECTIONS)
        raise InputError(f"{data}: no such file or folder{hint}")
    if (data / "all").is_dir():
        return EthUcy(folder=data, paths=tuple(sorted(data.glob("*/*.txt"))), **shared)
    own = _part(data, "train") and _part(data, "val")
    if own:
        test = _part(data, "test")
        tests = formats.data_files(test, read) if test else []
        names = [printable(path.stem) for path in tests]
        return Folders(tuple(names), paths=tuple(tests), folder=data, **shared)
    paths = formats.data_files(data, read) if formats.is_folder(data) else [data]
    names = [printable(path.stem) for path in paths]
    if len({*names, GENERAL}) <= len(names):
        raise InputError(
            f"{data}: two files are called alike, or one {GENERAL}; rename it"
        )
    return Files(tuple(names), paths=tuple(paths), **shared)


def data_folder() -> Path:
    """`$NEUROSYM_DATA`, else `neurosym_jax` in `$XDG_DATA_HOME` (default `~/.local/share`)."""
    if own := os.environ.get("NEUROSYM_DATA"):
        return Path(own)
    base = os.environ.get("XDG_DATA_HOME") or os.path.expanduser("~/.local/share")
    return Path(base) / "neurosym_jax"


def find(path: Path) -> Path:
    """`path`, or where it is below the data folder or a collection in it, if it is anywhere."""
    base = data_folder()
    places = (path, base / path, *(base / name / path for name in COLLECTIONS))
    return next(filter(os.path.exists, places), path)


def licences_of(names: Iterable[str]) -> dict[str, str]:
    """The licence of each data set, "unstated" where its publisher states none or it is unknown."""
    return dict(_LICENCES.get(name.casefold(), (name, "unstated")) for name in names)


def windows_from(
    data: Any,
    obs_len: int,
    pred_len: int,
    *,
    period: float = PERIOD,
    read: ReadOptions = AS_IT_SAYS,
    skip: int = 1,
    min_agents: int = 2,
) -> Windows:
    """Read recordings, resample them to steps of `period` seconds, and cut them into windows.

    `data` is a file of any known format, a folder of them, a dataframe of pandas or
    polars, tracks on any clock (see `make_tracks`), or several of these; `skip` and
    `min_agents` are those of `cut_windows`.
    """
    grid = [
        on_grid(tracks, period, read.max_gap)
        for tracks in formats.recordings_in(data, read)
    ]
    return cut_windows(grid, obs_len, pred_len, skip=skip, min_agents=min_agents)
