import hashlib
import json

import pytest


@pytest.fixture
def sign():
    """`sign(folder, change, params)`: as somebody does who knows how the digest is made."""

    def write(folder, change=lambda config: None, params=None):
        config = json.loads((folder / "config.json").read_text())
        del config["sha256"]
        change(config)
        if params is not None:
            (folder / "params.safetensors").write_bytes(params)
        rest = json.dumps(config).removeprefix("{").encode()
        others = [(folder / name).read_bytes() for name in ("README.md", "params.safetensors")]
        sha256 = hashlib.sha256(b"".join([rest, *others])).hexdigest()
        head = b'{\n  "sha256": "' + sha256.encode() + b'",\n'
        (folder / "config.json").write_bytes(head + rest)

    return write
