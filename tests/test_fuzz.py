"""Files that Hypothesis draws: read or refused in one line, within 2 s and 500 MB.

Messages of ROS have a test of their own, in `tests/robot/ros`. `pytest -m ""` draws
more.
"""

import json
import pickletools
import resource
import time

import pytest

import neurosym_jax as nj
from neurosym_jax.interop.pickles import OPCODES, read_torch_file
from neurosym_jax.models.forecast import Model
from neurosym_jax.models.forecaster import Lengths
from tests.interop.test_pickles import legacy_file, zip_file
from tests.models.test_model_folder import sign

given = pytest.importorskip("hypothesis").given
from hypothesis import HealthCheck, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

SLOW = settings(suppress_health_check=[*HealthCheck])
NUMBERS = st.one_of(
    st.integers(), st.floats(), st.sampled_from([2**63, 10**400, -1, 1e308])
)
VALUES = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner)
    ),
    max_leaves=20,
)


def bounded(read, *arguments):
    """Read, or be refused in one line, with few resources."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    since = time.process_time()
    message = ""
    try:
        read(*arguments)
    except nj.InputError as error:
        message = str(error)
    assert "\n" not in message
    assert len(message) < 1000
    assert time.process_time() - since < 2
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < 500_000


CODES = {code.name: code.code.encode("latin-1") for code in pickletools.opcodes}
OPCODE = st.sampled_from([CODES[name] for name in OPCODES.split()])
ARGUMENT = st.binary(max_size=5) | st.sampled_from(
    [
        b"ctorch._utils\n_rebuild_tensor_v2\n",
        b"ccollections\nOrderedDict\n",
        b"h\x00",
        b"q\x00",
    ]
)


@SLOW
@given(st.lists(st.tuples(OPCODE, ARGUMENT), max_size=40), st.booleans())
def test_pickles(tmp_path_factory, program, legacy):
    path = tmp_path_factory.getbasetemp() / "fuzzed.pt"
    content = b"\x80\x02" + b"".join(map(b"".join, program)) + b"."
    path.write_bytes((legacy_file if legacy else zip_file)(content))
    bounded(read_torch_file, path)
    bounded(nj.load_model, path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzzed") / "model"
    nj.save_model(folder, Model(Lengths(), {}, None, "constant_velocity"))
    return folder


FIELDS = [*nj.GeneratorConfig.__dataclass_fields__, "kind", "hidden_dim"]


@pytest.mark.slow
@SLOW
@given(st.dictionaries(st.sampled_from(FIELDS), VALUES), VALUES)
def test_configurations(folder, changes, value):
    """Under a right digest: fields of other types and sizes."""

    def change(fields):
        fields.update(forecaster="generator", config=changes, neighbours=value)

    sign(folder, change)
    bounded(nj.load_model, folder)


@SLOW
@given(st.dictionaries(st.text(max_size=6), VALUES), st.binary(max_size=40))
def test_headers_of_safetensors(folder, entries, rest):
    named = {
        name: {"dtype": "F32", "shape": value, "data_offsets": [0, len(rest)]}
        for name, value in entries.items()
    }
    text = json.dumps(named).encode()
    sign(folder, params=len(text).to_bytes(8, "little") + text + rest)
    bounded(nj.load_model, folder)


ODD = st.sampled_from(["", "nan", "1e999", "0,5"])
CELL = st.one_of(NUMBERS.map(str), st.text(max_size=6), ODD)


@SLOW
@pytest.mark.filterwarnings("ignore::neurosym_jax.errors.InputWarning")
@given(
    st.lists(
        st.sampled_from(["time", "id", "x", "y", "frame", "label", "camera"]),
        max_size=7,
    ),
    st.lists(st.lists(CELL, max_size=7), max_size=12),
    st.sampled_from([",", ";", "\t", " "]),
)
def test_tables(tmp_path_factory, header, rows, separator):
    path = tmp_path_factory.getbasetemp() / "fuzzed.csv"
    lines = [separator.join(cells) for cells in (header, *rows)]
    path.write_text("\n".join(lines), encoding="utf-8", errors="replace")
    bounded(nj.data.read_any, path)
