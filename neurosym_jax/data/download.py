"""`python -m neurosym_jax download`: what is published, fetched, checked and put in its place.

A collection appears in its folder at once and whole; until then it grows in `NAME.part` beside it,
where an interrupted download goes on.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tqdm import tqdm

from neurosym_jax.data.inspection import InspectOptions, inspect
from neurosym_jax.data.published import HOME, PublishedFile, data_folder, published_files
from neurosym_jax.data.transfer import sha256_of, transfer
from neurosym_jax.errors import InputError

__all__ = ["DownloadOptions", "download"]

THOR = """THÖR's recordings are to be fetched by hand:
  1. download https://zenodo.org/records/3382145 (THÖR: files such as Exp_1_run_1_6D.tsv) or
     https://zenodo.org/records/10407223 (THÖR-MAGNI: CSV files), and unpack what is an archive;
  2. put the recordings into {folder}
     (any of them; each file is a scene of its own);
  3. run this command again: it says what is there and whether it can be read."""


GO_ON = "what has come is kept: run this again, or name another place with --mirror"


@dataclasses.dataclass(frozen=True)
class DownloadOptions:
    """Fetch ETH/UCY or SGAN's checkpoints; say how to get THÖR, and check what was put there.

    evaluate.py and train.py look into the folder of the data by themselves.
    """

    what: Annotated[Literal["eth-ucy", "sgan-checkpoints", "thor"], tyro.conf.Positional]
    """Recordings of ETH/UCY (5.4 MB), SGAN's 20 published checkpoints (2.6 MB), or THÖR."""
    to: Path | None = None
    """Folder in which the collection gets a folder of its own; default: $NEUROSYM_DATA, else
    neurosym_jax in $XDG_DATA_HOME or ~/.local/share."""
    mirror: str = HOME
    """Address, or folder, of a copy of the files, with the same paths below it."""
    timeout: float = 20.0
    """Seconds of silence after which a connection is given up."""


def download(options: DownloadOptions) -> int:
    """Do what the verb says; 2 where nothing of THÖR is there yet.

    Raises:
        InputError: naming the file or address and what is wrong with it.
    """
    base = data_folder() if options.to is None else options.to
    folder = base / options.what
    if options.what == "thor":
        return _check_by_hand(folder)
    if not 0 < options.timeout < float("inf"):
        raise InputError(f"--timeout must be positive, not {options.timeout}")
    wanted = published_files(options.what)
    try:
        _refuse_others(folder, wanted)
        came = _fetch(folder, wanted, _address(options.mirror), options.timeout)
    except OSError as error:  # Of the disk: those of the network are said by `transfer`.
        raise InputError(f"{folder}: {error}") from None
    print(f"{folder}: {len(wanted)} files, every SHA-256 as published, {came} of them fetched now")
    if options.to is not None and options.to.resolve() != data_folder().resolve():
        print(f"To have it found without being told: export NEUROSYM_DATA={options.to}")
    return 0


def _address(mirror: str) -> str:
    """A URL that ends in a slash, of a URL or a folder."""
    if Path(mirror).is_dir():
        mirror = Path(mirror).resolve().as_uri()
    if not mirror.startswith(("https://", "http://", "file://")):
        raise InputError(f"--mirror {mirror}: neither a folder nor an address of http or https")
    return mirror.rstrip("/") + "/"


def _refuse_others(folder: Path, wanted: list[PublishedFile]) -> None:
    """InputError for a file that is there and is not the published one; none is overwritten."""
    for file in wanted:
        path = folder / file.path
        if path.exists() and sha256_of(path) != file.sha256:
            raise InputError(f"{path}: is not the published file; move it away to fetch that")


def _fetch(folder: Path, wanted: list[PublishedFile], home: str, timeout: float) -> int:
    """Bring what is missing; how many files that were."""
    into = folder if folder.exists() else folder.with_name(f"{folder.name}.part")
    missing = [file for file in wanted if not (into / file.path).exists()]
    total, before = sum(file.size for file in missing), 0
    with tqdm(total=total, desc=folder.name, unit="B", unit_scale=True, disable=None) as bar:
        for file in missing:
            try:
                transfer(
                    home + file.address,
                    into / file.path,
                    file.size,
                    file.sha256,
                    timeout=timeout,
                    progress=lambda count, before=before: bar.update(before + count - bar.n),
                )
            except InputError as error:
                raise InputError(f"{error} ({GO_ON})") from None
            before += file.size
    if into != folder:
        into.rename(folder)
    return len(missing)


def _check_by_hand(folder: Path) -> int:
    print(THOR.format(folder=folder.resolve()))
    if not folder.is_dir() or not any(folder.iterdir()):
        print("\nNothing is there yet.")
        return 2
    print()
    return inspect(InspectOptions(folder))
