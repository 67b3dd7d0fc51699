"""Files of torch.save, damaged, foreign and hostile: one line each, and no code is run."""

import copy
import io
import os
import pickle
import struct
import time
import zipfile

import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.interop.checkpoint import SAME, load_torch_checkpoint
from neurosym_jax.interop.pickles import LEGACY_MAGIC, read_torch_file
from tests.repository import SMALL as CHECKPOINT

SMALL = CHECKPOINT.read_bytes()


def as_legacy(zip_bytes):
    """The same checkpoint in the legacy form: a stream of pickles, then the storages."""
    with zipfile.ZipFile(io.BytesIO(zip_bytes)) as archive:
        root = archive.namelist()[0].split("/")[0]
        keys = [n.rsplit("/", 1)[1] for n in archive.namelist() if "/data/" in n]
        program = archive.read(f"{root}/data.pkl")
        storages = [archive.read(f"{root}/data/{key}") for key in keys]
    return legacy_file(program, keys, storages)


def legacy_file(program, keys=(), storages=(), little_endian=True, protocol=1001):
    system = {"protocol_version": protocol, "little_endian": little_endian}
    parts = [pickle.dumps(part, 2) for part in (LEGACY_MAGIC, protocol, system)]
    parts += [program, pickle.dumps(list(keys), 2)]
    return b"".join(parts + [struct.pack("<q", len(s) // 4) + s for s in storages])


def zip_file(program, compression=zipfile.ZIP_STORED):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        archive.writestr("archive/data.pkl", program)
    return file.getvalue()


FORMS = {"zip": SMALL, "legacy": as_legacy(SMALL)}
EMPTY = pickle.dumps({}, 2)


def test_legacy_form_reads_the_same(tmp_path):
    for form, data in FORMS.items():
        (tmp_path / form).write_bytes(data)
    a, b = (load_torch_checkpoint(tmp_path / form) for form in FORMS)
    assert a.config == b.config
    for name, array in a.params["params"]["decoder"]["lstm"].items():
        np.testing.assert_array_equal(
            array, b.params["params"]["decoder"]["lstm"][name]
        )


def test_not_a_file(tmp_path):
    for path in (tmp_path, tmp_path / "absent.pt"):
        with pytest.raises(InputError, match=str(path)):
            load_torch_checkpoint(path)
    (tmp_path / "a.pt").write_bytes(SMALL)
    os.truncate(tmp_path / "a.pt", 2**40)  # It takes no room on the disk.
    with pytest.raises(InputError, match=r"reading it needs some 4398\.0 GB of memory"):
        load_torch_checkpoint(tmp_path / "a.pt")


class Hostile:
    def __init__(self, command):
        self.command = command

    def __reduce__(self):
        return os.system, (self.command,)


@pytest.mark.parametrize("protocol", [2, 4])
@pytest.mark.parametrize("wrap", [zip_file, legacy_file])
def test_code_is_refused_by_name(tmp_path, wrap, protocol):
    path, trace = tmp_path / "a.pt", tmp_path / "trace"
    program = pickle.dumps({"g_state": {}, "args": Hostile(f"touch {trace}")}, protocol)
    path.write_bytes(wrap(program))
    with pytest.raises(
        InputError, match=rf"a\.pt: refused.*'{os.system.__module__}\.system'"
    ):
        load_torch_checkpoint(path)
    assert not trace.exists()


FOREIGN = [
    (b"", "an empty file"),
    (b"frame,id,x,y\n", "not a file of torch.save"),
    (b"\x80\x02}.", "not a file of torch.save"),
    (zip_file(b"")[:4], "damaged or cut short"),
    (zip_file(b"").replace(b"data.pkl", b"data.jpg"), "not one of torch"),
    (zip_file(EMPTY, zipfile.ZIP_DEFLATED), "compressed, and may be of any size"),
    (legacy_file(EMPTY, little_endian=False), "big-endian"),
    (legacy_file(EMPTY, protocol=1000), "another format"),
    (legacy_file(EMPTY) + b"more", "4 bytes follow"),
]
PROGRAMS = [
    (b"cos\nsystem\n.", r"'os\.system'"),
    (b"cbuiltins\neval\n.", r"'builtins\.eval'"),
    (b"(ios\nsystem\n.", "opcode INST"),
    (b"\x82\x01.", "opcode EXT1"),
    (b"}r\xff\xff\xff\x7f.", "has no g_state"),
    # A pair of a pair of ..., each twice the same: as a key, its hash takes minutes.
    (b"}K\x01" + b"q\x00h\x00\x86" * 30 + b"Ns.", "key is neither text nor a number"),
    (b"}(K\x01" + b"q\x00h\x00\x86" * 30 + b"Nu.", "key is neither text nor a number"),
    (b"ctorch.nn\nLinear\n.", r"'torch\.nn\.Linear'"),
    # Each of these would write into a class or an object of ours.
    (b"ctorch._utils\n_rebuild_tensor_v2\n}X\x01\x00\x00\x00aK\x01sb.", "damaged"),
    (b"ccollections\nOrderedDict\nN}X\x01\x00\x00\x00aK\x01s\x86b.", "damaged"),
    (b"ctorch\nFloatStorage\nN}X\x01\x00\x00\x00aK\x01s\x86b.", "damaged"),
    (b"ctorch._utils\n_rebuild_tensor_v2\n)\x81.", "damaged"),
    (b"(X\x06\x00\x00\x00modulectorch\nSize\nX\x01\x00\x00\x000NK\x01tQ.", "refused"),
    # A dictionary that begins with something would be lost.
    (b"ccollections\nOrderedDict\n]\x85R.", "made in a way torch does not"),
]
for wrapped in (zip_file, legacy_file):
    FOREIGN += [
        (wrapped(b"\x80\x02" + program), message) for program, message in PROGRAMS
    ]


@pytest.mark.parametrize(("data", "message"), FOREIGN)
def test_foreign_files_and_pickles_that_no_checkpoint_needs(tmp_path, data, message):
    path = tmp_path / "a.pt"
    path.write_bytes(data)
    with pytest.raises(InputError, match=rf"a\.pt: .*{message}"):
        load_torch_checkpoint(path)


def test_parts_that_are_shared_thirty_times_take_no_time(tmp_path):
    """As text they would be gigabytes; the message shows a part of them."""
    value, path = [1], tmp_path / "a.pt"
    for _ in range(30):
        value = [value, value]
    for arguments in (
        {"num_layers": value},
        dict.fromkeys([*SAME, "pooling_type"], value),
    ):
        path.write_bytes(zip_file(pickle.dumps({"g_state": {}, "args": arguments}, 2)))
        since = time.perf_counter()
        with pytest.raises(InputError) as caught:
            load_torch_checkpoint(path)
        assert len(str(caught.value)) < 400
        assert time.perf_counter() - since < 2


def test_entries_of_an_archive_that_lie_on_each_other(tmp_path):
    """A file of 200 kB whose central directory names one content of 100 kB a hundred times."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("a/data.pkl", EMPTY)
        archive.writestr("a/data/0", bytes(100_000))
        entry = archive.infolist()[1]
        for number in range(1, 100):
            again = copy.copy(entry)
            again.filename = f"a/data/{number}"
            archive.filelist.append(again)
    (tmp_path / "a.pt").write_bytes(file.getvalue())
    # Headers are compared with the directory before sizes are.
    reason = "its entries are larger than itself|File name in directory .* differ"
    with pytest.raises(InputError, match=reason):
        load_torch_checkpoint(tmp_path / "a.pt")


def tensor_program(offset=0, shape=(2, 2), strides=(2, 1), numel=4, view=None):
    """The pickle of one tensor."""

    def encode(value):
        return pickle.dumps(value, 2)[2:-1]

    fields = b"".join(encode(v) for v in (offset, shape, strides, False))
    storage = encode("storage") + b"ctorch\nFloatStorage\n"
    storage += b"".join(encode(v) for v in ("0", "cuda:0", numel, view))
    call = b"ctorch._utils\n_rebuild_tensor_v2\n((" + storage + b"tQ" + fields + b"NtR"
    return b"\x80\x02" + call + b"."


@pytest.mark.parametrize(
    "description",
    [
        *(
            {"offset": 1},
            {"offset": -1},
            {"shape": (2, 3)},
            {"shape": (2, -2)},
            {"shape": (4,)},
        ),
        *({"strides": (3, 1)}, {"strides": (-2, 1)}, {"view": ("v", 1, 3)}),
        *({"numel": -1}, {"numel": 3}, {"numel": 5}),
        {"shape": (2**30, 2**30), "strides": (0, 0)},
    ],
)
def test_tensors_stay_within_their_storage(tmp_path, description):
    path = tmp_path / "a.pt"
    values = np.arange(4, dtype=np.float32)
    path.write_bytes(legacy_file(tensor_program(), ["0"], [values.tobytes()]))
    np.testing.assert_array_equal(read_torch_file(path), values.reshape(2, 2))
    path.write_bytes(
        legacy_file(tensor_program(**description), ["0"], [values.tobytes()])
    )
    with pytest.raises(InputError):
        read_torch_file(path)


@pytest.mark.filterwarnings("ignore:invalid escape sequence")
@pytest.mark.parametrize("form", ["zip", "legacy"])
def test_cut_short_or_a_byte_flipped_anywhere(tmp_path, form):
    """A flip in a weight goes unnoticed (legacy files carry no checksum); none does worse."""
    original, path, rng = FORMS[form], tmp_path / "a.pt", np.random.default_rng(0)
    for length in [*range(0, len(original), 61), len(original) - 1]:
        path.write_bytes(original[:length])
        with pytest.raises(InputError, match=r"a\.pt: [^\n]+$"):
            load_torch_checkpoint(path)
    messages = []
    for position in range(0, len(original), 17):
        data = bytearray(original)
        data[position] ^= rng.integers(1, 256)
        path.write_bytes(data)
        try:
            load_torch_checkpoint(path)
        except InputError as error:
            messages.append(str(error))
    assert len(messages) > 50
    assert all(text.startswith(f"{path}: ") and "\n" not in text for text in messages)


@pytest.mark.parametrize("dtype", ["float64", "int64", "bool"])
@pytest.mark.parametrize("zip_form", [False, True])
def test_dtypes_written_by_torch(tmp_path, torch, zip_form, dtype):
    tensor = torch.arange(6).reshape(2, 3).to(getattr(torch, dtype)).T
    contents = {"a": tensor, "b": torch.tensor(3)}
    torch.save(contents, tmp_path / "a.pt", _use_new_zipfile_serialization=zip_form)
    read = read_torch_file(tmp_path / "a.pt")
    np.testing.assert_array_equal(np.asarray(read["a"]), tensor.numpy(), strict=True)
    assert np.asarray(read["b"]) == 3
