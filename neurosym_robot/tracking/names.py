"""Names that trackers give to people, as numbers and back."""

import collections
import hashlib
import re

import numpy as np

UNNAMED = int(np.iinfo(np.int64).min)
"""Id of a person who has none."""
NAMES = 4096
"""Names that are remembered, of those seen last."""
_names: collections.OrderedDict[int, str] = collections.OrderedDict()


def id_of_name(name: str) -> int:
    """The id of a person's name: the number it is, or else a hash of it; `UNNAMED` if empty.

    Hashes lie between 2**52 and 2**53, where floats and JavaScript still represent
    every integer.
    """
    if re.fullmatch("0|-?[1-9][0-9]{0,17}", name):  # "007" is another name than "7".
        return int(name)
    if not name:
        return UNNAMED
    digest = hashlib.blake2b(name.encode(), digest_size=6).digest()
    id = 2**52 | int.from_bytes(digest)
    _names[id] = name
    while len(_names) > NAMES:
        _names.popitem(last=False)
    return id


def name_of(id: int) -> str:
    """The name of which `id_of_name` made the id, while it is remembered; else the number."""
    return _names.get(id, str(id))
