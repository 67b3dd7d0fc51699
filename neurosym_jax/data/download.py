"""Published collections, fetched, checked and put in their place.

A collection appears in its folder at once and whole; until then it grows in `NAME.part` beside it,
where an interrupted download goes on.
"""

from pathlib import Path

from tqdm import tqdm

from neurosym_jax.data.published import HOME, PublishedFile, published_files
from neurosym_jax.data.transfer import sha256_of, transfer
from neurosym_jax.errors import InputError

__all__ = ["download"]

GO_ON = "what has come is kept: run this again, or name another place with --mirror"


def download(what: str, folder: Path, mirror: str = HOME, timeout: float = 20.0) -> tuple[int, int]:
    """Bring what `folder` lacks of a collection; nothing that is there is overwritten.

    Args:
        what: name of the collection, see `published.COLLECTIONS`.
        folder: the collection's own.
        mirror: address, or folder, of a copy of the files, with the same paths below it.
        timeout: seconds of silence after which a connection is given up.

    Returns:
        How many files the collection has, and how many of them were fetched now.

    Raises:
        InputError: naming the file or address and what is wrong with it.
    """
    if not 0 < timeout < float("inf"):
        raise InputError(f"--timeout must be positive, not {timeout}")
    wanted = published_files(what)
    try:
        _refuse_others(folder, wanted)
        return len(wanted), _fetch(folder, wanted, _address(mirror), timeout)
    except OSError as error:  # Of the disk: those of the network are said by `transfer`.
        raise InputError(f"{folder}: {error.strerror or error}") from None


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
