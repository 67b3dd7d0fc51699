"""Recordings by name, folder or file: their format, what is read of a folder, and sources of
windows.
"""

import abc
import dataclasses
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, cast

from neurosym_jax.configuration import component
from neurosym_jax.data.evidence import judge
from neurosym_jax.data.readers import columns
from neurosym_jax.data.readers.storage import FRAME, InMemory, is_frame
from neurosym_jax.data.tables import (
    AS_IT_SAYS,
    FORMATS,
    SCALED,
    SIGNATURES,
    Format,
    Head,
    Question,
    ReadOptions,
    names_tracks,
    read_head,
    role_of,
    vocabulary,
)
from neurosym_jax.data.tracks import PERIOD, Reading, Tracks, on_grid, resample
from neurosym_jax.errors import InputError, InputWarning, brief, option, printable
from neurosym_jax.plugins import load_entry_points
from neurosym_jax.runtime.foreign import reading

if TYPE_CHECKING:
    from neurosym_jax.data.windows import Windows

__all__ = [
    "GENERAL",
    "SCENES",
    "EthUcy",
    "Files",
    "Folders",
    "Source",
    "Synthetic",
    "data_files",
    "data_folder",
    "files_in",
    "find",
    "format_of",
    "is_folder",
    "licences_of",
    "open_source",
    "read_any",
    "recordings_in",
    "refuse_useless",
    "split_files",
    "windows_from",
]


# Reading with the format that knows how a file begins.

# Endings of the files that are taken from a folder.
SUFFIXES = (".txt", ".csv", ".tsv", ".ndjson", ".json", ".gz", ".parquet", ".feather")
SUFFIXES += (
    ".geojson",
    ".arrow",
    ".sqlite",
    ".db",
    ".h5",
    ".hdf5",
    ".npy",
    ".npz",
    ".mat",
    ".xlsx",
)


def format_of(path: Path, options: ReadOptions = AS_IT_SAYS) -> Format:
    """The format of a file, as `options` or the file itself say."""
    if options.format is not None:
        load_entry_points()
        return component(options.format, FORMATS, str(path))
    owner = _owner(path)
    if owner:
        return owner
    head = read_head(path)
    begins = [head.magic.decode("latin-1"), *head.lines]
    names = ["storage", "json"] if options.columns else reversed(list(FORMATS))
    for name in names:
        signature = SIGNATURES.get(name, "")
        if any(re.search(signature, line) for line in begins):
            form = FORMATS[name]()
            if form.knows(head):
                return form
    return columns.Columns()


def is_folder(path: Path) -> bool:
    """Whether a path is a folder of files, and not one that is a recording itself."""
    # os's also for a name that is too long.
    return os.path.isdir(path) and not _owner(path)


def _owner(path: Path) -> Format | None:
    """The format that a path is of by its name."""
    if path.suffix.lower() in SUFFIXES and not os.path.isdir(path):
        return None  # No package of another format is loaded for a table.
    load_entry_points()
    for kind in reversed(FORMATS.values()):
        form = kind()
        if form.owns(path):
            return form
    return None


def read_any(
    data: Any, options: ReadOptions = AS_IT_SAYS, frame_period: float = PERIOD
) -> list[Tracks]:
    """The recordings in a file or dataframe, on their own clocks; each has a `reading`.

    `data` is the path of a file of any known format, or a table of pandas, polars,
    pyarrow, GeoPandas, PedPy or MovingPandas, which is read as a table with named
    columns. The most common step of frame numbers is `frame_period` seconds where
    nothing else is said.

    Raises:
        InputError: naming file, row and reason; for an option that the format does not
            use, and for people who move as none do (see `evidence`), unless
            `options.allow` names the guard.

    Warns:
        InputWarning: of what looks wrong, which is in `reading` too.
    """
    is_path = isinstance(data, str | os.PathLike) or not is_frame(data)
    path = Path(data) if is_path else FRAME
    with reading(path, "a recording"):
        form = format_of(path, options) if is_path else InMemory(data)
        if isinstance(form, InMemory) and options.format not in (None, "columns"):
            raise InputError(
                f"it is a {form.title}, not {option('format', options.format)}"
            )
        refuse_useless(path, form, options)

        def take(answer: tuple[str, ...]) -> list[Tracks]:
            with_answer = dataclasses.replace(options, columns=answer)
            is_table = form.uses is not None and "columns" in form.uses
            reader = form if is_table else columns.Columns()
            return reader.read(path, with_answer, frame_period)

        try:
            recordings = form.in_metres(path, options, frame_period)
        except Question as question:
            raise columns.answered(question, options.columns, take) from None
        return [_judged(path, form, tracks, options) for tracks in recordings]


def _judged(path: Path, form: Format, tracks: Tracks, options: ReadOptions) -> Tracks:
    """Tracks with their `reading`, after what they say of themselves."""
    report = tracks.reading or Reading(
        tracks.recording, printable(str(path)), rows=len(tracks.id)
    )
    lines = (*report.warnings, *_unnamed(path, options))
    for guard, refused, line in judge(tracks):
        lines += (options.allowed(guard, line) if refused else line,)
    for line in lines:
        warnings.warn(f"{path}: {line}", InputWarning, stacklevel=4)
    if isinstance(form, InMemory):
        file, name = None, "columns"
    else:
        file, name = report.file, FORMATS.name_of(form)
    report = dataclasses.replace(report, file=file, format=name, warnings=lines)
    return dataclasses.replace(tracks, reading=report)


def _unnamed(path: Path, options: ReadOptions) -> Iterator[str]:
    """A line for each option that has values of other recordings alone."""
    recording = printable(path.stem)
    if options.unit and not options.unit_of(path.stem):
        yield f"{option('unit', options.unit)} does not name {recording}"
    if options.fps and not options.fps_of(path.stem):
        yield f"{option('fps', options.fps)} does not name {recording}"


def refuse_useless(path: Path, form: Format, options: ReadOptions) -> None:
    """Refuse options of reading that a format does not use.

    Raises:
        InputError: naming the first.
    """
    uses = SCALED if form.uses is None else form.uses
    for name in sorted(columns.OF_A_TABLE - uses):
        if getattr(options, name):
            raise InputError(
                f"{path}: {option(name)} is of no use for {form.title}, which fixes it"
            )


def recordings_in(data: Any, options: ReadOptions = AS_IT_SAYS) -> list[Tracks]:
    """The recordings in a file, folder, dataframe (see `read_any`), tracks, or several of these.

    Raises:
        InputError: as `read_any`, and for what is none of these.
    """
    if isinstance(data, Tracks):
        return [data]
    if isinstance(data, str | Path):
        path = Path(data)
        paths = data_files(path, options) if is_folder(path) else [path]
        recordings = []
        for path in paths:
            recordings += read_any(path, options)
        return recordings
    if not isinstance(data, list | tuple) and is_frame(data):
        return read_any(data, options)
    if not isinstance(data, Iterable):
        raise InputError(
            f"{brief(data)}: is no recording: give a file, table or `make_tracks`"
        )
    recordings = []
    for item in data:
        recordings += recordings_in(item, options)
    return recordings


def data_files(folder: Path, options: ReadOptions = AS_IT_SAYS) -> list[Path]:
    """The recordings of a folder, in order of name; warn of tables without columns of tracks.

    Raises:
        InputError: for a folder that is missing or has none.
    """
    paths = files_in(folder)
    if options.columns or options.format:
        return paths
    others = {}
    for path in paths:
        form = format_of(path)
        if isinstance(form, columns.Layout) or not isinstance(form, columns.Columns):
            continue
        head = read_head(path)
        if not names_tracks(head.names):
            others[path] = "it has no columns of tracks"
        elif _has_no_people(path, head, options):
            others[path] = "it has no people"
    for path, why in others.items():
        warnings.warn(f"{path}: left out: {why}", InputWarning, stacklevel=2)
    if len(paths) == len(others):
        raise InputError(
            f"{folder}: its tables have no columns of tracks of people; name them, or others"
        )
    return [path for path in paths if path not in others]


def _has_no_people(path: Path, head: Head, options: ReadOptions) -> bool:
    """Whether all rows are of other kinds, which are looked for where the first ones are."""
    others = vocabulary()["others"]
    for at, name in enumerate(head.names):
        if role_of(name) == "label" and head.table.words(at).is_in(others).all():
            try:
                columns.Columns().read(path, options, PERIOD)
            except columns.NoPeople:
                return True
            except InputError:
                return False
    return False


def files_in(folder: Path, pattern: str = "*") -> list[Path]:
    """Every file of `folder` that may be a recording, by its ending (`SUFFIXES`); at least one.

    Raises:
        InputError: if there is none.
    """
    paths = []
    for path in sorted(folder.glob(pattern)):
        is_known = path.suffix.lower() in SUFFIXES or _owner(path)
        if is_known and not _owner(path.parent):
            paths.append(path)
    if not paths:
        raise InputError(
            f"{folder}: no such folder, or no {', '.join(SUFFIXES)} file in it"
        )
    return paths


# The leave-one-out splits of ETH/UCY.
#
# As SGAN arranges it, the folder has `all/` (whole recordings, for testing), `train/` and
# `val/`.

SCENES = {
    "eth": ("biwi_eth",),
    "hotel": ("biwi_hotel",),
    "univ": ("students001", "students003"),
    "zara1": ("crowds_zara01",),
    "zara2": ("crowds_zara02",),
}
"""The recordings that each of the benchmark's five data sets tests on."""


def split_files(folder: Path, scene: str | None, split: str) -> list[Path]:
    """Files of one leave-one-out split: `test` has the whole recordings of the data set
    `scene`, `train` and `val` have parts of all others (None leaves out none).

    Raises:
        InputError: for an unknown data set or missing files.
    """
    if scene is not None and scene not in SCENES:
        raise InputError(f"unknown data set {scene!r}: ETH/UCY has {', '.join(SCENES)}")
    own = SCENES[scene] if scene else ()
    paths = [folder / "all" / f"{name}.txt" for name in own]
    if split != "test":
        held_out = {f"{name}_{split}" for name in own}
        files = sorted((folder / split).glob("*.txt"))
        paths = [path for path in files if path.stem not in held_out]
    for path in paths or [folder / split / "*.txt"]:
        if not path.is_file():
            raise InputError(f"{path}: missing, and data set {scene} needs it")
    return paths


# Sources of recordings by name of the data set (simulations, ETH/UCY, files), and their
# places.
#
# A source reads files only when recordings are asked for.

Split = Literal["train", "val", "test"]

GENERAL = "general"
"""Held-out data set of models that are trained on all of them and tested on other people."""

COLLECTIONS = ("eth-ucy", "sgan-checkpoints", "thor")
"""They are downloaded into `data_folder()`."""

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
    # of all data sets together, if a model may be tested on all of them
    name: ClassVar[str] = ""
    # what it contains, for people who did not ask for it by name
    about: ClassVar[str] = ""

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
        return self._on_grid(recordings_in(paths, self.read))

    @abc.abstractmethod
    def _read(self, scene: str, split: Split) -> Iterable[Tracks]:
        """The recordings as they are in the files."""

    def _on_grid(self, recordings: Iterable[Tracks]) -> list[Tracks]:
        return [
            on_grid(tracks, self.period, self.read.max_gap) for tracks in recordings
        ]


_SEEDS = {"test": range(2), "val": range(100, 102), "train": range(200, 208)}
"""Seeds of the simulations of each split."""


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

        seeds = _SEEDS[split]
        return (resample(simulate(cast(Any, scene), seed), PERIOD) for seed in seeds)


@dataclasses.dataclass(frozen=True)
class EthUcy(Source):
    """ETH/UCY with its leave-one-out splits, in `folder`."""

    folder: Path = Path()
    scenes: tuple[str, ...] = tuple(SCENES)

    def _read(self, scene: str, split: Split) -> Iterable[Tracks]:
        own = None if scene == GENERAL else scene
        return recordings_in(split_files(self.folder, own, split), self.read)


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
        if split == "val":
            return ()
        return recordings_in(paths, self.read)


@dataclasses.dataclass(frozen=True)
class Folders(Source):
    """A folder with a user's own split: train, val and, where there is one, test.

    The data sets are the files of `test`.
    """

    folder: Path = Path()

    def _read(self, scene: str, split: Split) -> Iterable[Tracks]:
        if split == "test":
            return recordings_in([self.paths[self.scenes.index(scene)]], self.read)
        return recordings_in(_part(self.folder, split), self.read)


def _part(folder: Path, split: Split) -> Path | None:
    """The folder of one part of a user's own split, if it is there."""
    for name in _PARTS[split]:
        if (folder / name).is_dir():
            return folder / name
    return None


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
        data = data_folder() / ("eth-ucy" if target in SCENES else "thor")
        available = target in (*SCENES, *(path.stem for path in data.glob("*")))
        if not available or not data.is_dir():
            if scene in SCENES:
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
        tests = data_files(test, read) if test else []
        names = [printable(path.stem) for path in tests]
        return Folders(tuple(names), paths=tuple(tests), folder=data, **shared)
    paths = data_files(data, read) if is_folder(data) else [data]
    names = [printable(path.stem) for path in paths]
    if len({*names, GENERAL}) <= len(names):
        raise InputError(
            f"{data}: two files are called alike, or one {GENERAL}; rename it"
        )
    return Files(tuple(names), paths=tuple(paths), **shared)


def data_folder() -> Path:
    """`$NEUROSYM_DATA`, else `neurosym_jax` in `$XDG_DATA_HOME` (default `~/.local/share`)."""
    own = os.environ.get("NEUROSYM_DATA")
    if own:
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
) -> "Windows":
    """Read recordings, resample them to steps of `period` seconds, and cut them into windows.

    `data` is a file of any known format, a folder of them, a dataframe of pandas or
    polars, tracks on any clock (see `make_tracks`), or several of these; `skip` and
    `min_agents` are those of `cut_windows`.
    """
    # Only here, so that recordings are read without JAX.
    from neurosym_jax.data.windows import cut_windows

    grid = [
        on_grid(tracks, period, read.max_gap) for tracks in recordings_in(data, read)
    ]
    return cut_windows(grid, obs_len, pred_len, skip=skip, min_agents=min_agents)
