"""What cannot be read ends in one line that names the file, the row and the reason."""

import pytest

from neurosym_jax.data import ReadOptions, read_any
from neurosym_jax.errors import InputError

QTM = "NO_OF_FRAMES\t3\n" * 9 + "X\nFrame\tTime"  # the rows begin with row 12
HELMET = f"{QTM}\tHelmet_1 X\tHelmet_1 Y\tHelmet_1 Z\n"
TRACKLETS = "Time,x,y,ag_id,tracklet_id\n"
POINT = '{"track": {"f": 1, "p": 1, "x": 1, "y": 0}}\n'

REFUSALS = [
    ("text", "", "the file has no rows"),
    ("text", "\n # nothing \n", "the file has no rows"),
    ("text", "0 1 2 3\n1 1 2\n", r"row 2: 3 columns, not 4: '1 1 2'"),
    ("text", "0 1 2 3\n1 1 2 3 4\n", "row 2: 5 columns, not 4"),
    ("text", "0 1 2\n1 1 2\n", r"row 1: 3 columns, not 4 \(--format, or --columns time=1"),
    ("text", "0,1,,3\n", "row 1: x is not a number: ''"),
    ("text", "# a comment\n\n0 1 2 3\n1 1 2 x4\n", "row 2: y is not a number: 'x4'"),
    ("text", "frame ped x y\n0 1 2 3\n", "row 1: x is not a number: 'x'"),
    ("text", "0 1 nan 3\n1 1 2 3\n", "row 1: x is not finite"),
    ("text", "0 1 2 3\n1 1 2 -inf\n", "row 2: y is not finite"),
    ("text", "0 1 2 3\ninf 1 2 3\n", "row 2: frame is not finite"),
    ("text", "0 1 2 3\n1 2 2 3\n0 1 5 5\n", r"row 3: repeats \(time 0, id 1\)"),
    ("text", "0 1 2 3\n0.5 1 2 3\n", "row 2: frame 0.5 is not whole"),
    ("text", "0 1 2 3\n1 1.5 2 3\n", "row 2: ped 1.5 is not whole"),
    ("text", "0 1 2 3\n1 1e30 2 3\n", r"row 2: ped 1e\+30 is too large"),
    ("text", "0 1 2 3\n1 1 2 1e300\n", r"row 2: position 2, 1e\+300 is not a usable number"),
    ("text", "0 1 2 3\n1 1 2 3,4\n", r"row 2: y is not a number: '3,4' \(use a decimal point\)"),
    ("text", "780 1 8,46 3,59\n", "row 1: 3 columns, not 4"),
    ("text", "780;1;8,46;3,59\n", r"row 1: x is not a number: '8,46' \(use a decimal point\)"),
    ("text", "0 1 2 3\n1 1_0 2 3\n", "row 2: ped is not a number: '1_0'"),
    ("text", "0 1 2 3\n1 01 2 3\n", "the ids '1' and '01' are one number"),
    ("cliff", "1e12,1,0,0,0,0\n", r"row 1: time 1e\+12 is not a usable number"),
    ("cliff", "0.1,1.5,0,0,0,0\n", "row 1: id 1.5 is not whole"),
    ("columns", "t,id,x\n1,2,3\n", "which column is y"),
    ("columns", "id,x,y\n1,2,3\n", "which column is time or frame"),
    ("columns", "t,id,x,x,y\n1,2,3,4,5\n", "which column is x, 'x' or 'x'?"),
    ("columns", "t,id,x,y\n1,2,3\n", "row 1: 3 columns, not 4"),
    ("columns", "t,id,x,y\n1,2,3,q\n", "row 1: y is not a number: 'q'"),
    ("columns", "t,id,x,y\n1,2,3,1\n1,n/a,3,1\n", r"row 2: the id is missing \('n/a'\)"),
    ("columns", "t,id,x,y\n1,2,3,inf\n", "row 1: y is not finite"),
    ("columns", "t,id,x,y\n1,2,3,1e99\n", r"row 1: position 3, 1e\+99 is not a usable number"),
    ("columns", "t,id,x,y\n1e99,2,3,1\n", r"row 1: time 1e\+99 is not .*: say --time-unit ms"),
    ("columns", "t,id,x,y\n", "the file has no rows"),
    ("columns", "t,id,x,y\n1,2,3,4\n1,2,3,5\n", r"row 2: repeats \(time 1, id 2\)"),
    ("columns", "t,id,x,y\n2024-05-01,1,0,0\n2024-13-01,1,0,0\n", "row 2: '2024-13-01' is not a d"),
    ("columns", "{}", "which column is id"),
    ("columns", "[]", "a table in JSON has an object a line"),
    ("columns", "[1]", "row 1: not an object"),
    ("columns", '{"t": 1, "id": 1, "x": 0, "y": 0}\n1', "row 2: not an object"),
    ("columns", '{"t": 1, "id": 1, "x": 0, "y": 0}\n{"t": 1', "row 2: not JSON"),
    ("columns", "[" * 100_000, "row 1: not JSON"),
    ("columns", '{"t": [1], "id": [], "x": [], "y": []}', "row 1: t is not a number"),
    ("columns", '{"t": 1, "id": 1, "t": 1}', "the key 't' is there twice"),
    ("columns", '{"t": {}}', "which column is id"),
    ("columns", '{"t": 1, "id": 1, "x": [], "y": 0}', "row 1: x is not a number"),
    ("columns", '{"t": 1, "id": null, "x": 1, "y": 0}', "row 1: the id is missing"),
    ("trajnet", "", "the file has no track rows"),
    ("trajnet", '{"track": {"f": 1', "row 1: not JSON"),
    ("trajnet", "[1]", "row 1: neither a track nor a scene"),
    ("trajnet", '{"track": {"f": 1, "p": 1, "x": 0}}', "row 1: y is not a number"),
    ("trajnet", "\n" + POINT.replace('"f": 1', '"f": 1.5'), "row 2: f 1.5 is not whole"),
    ("trajnet", POINT.replace('"x": 1', '"x": NaN'), "row 1: not JSON .NaN is not"),
    ("trajnet", POINT.replace('"x": 1', '"x": 1e12'), "row 1: position"),
    ("trajnet", '{"scene": {"id": 1, "p": 1, "s": 0, "e": 1, "fps": 0}}', "row 1: fps is 0"),
    ("trajnet", '{"scene": {"fps": 2}}\n{"scene": {"fps": 3}}', "row 2: fps 3, and 2 before"),
    ("trajnet", POINT * 2, "row 2: repeats"),
    ("trajnet", POINT.replace("1", "9" * 5000, 1), "row 1: f is not finite"),
    ("qtm", "Fame\n", "no header that begins with `Frame`"),
    ("qtm", f"FREQUENCY\tfast\n{HELMET}", "row 1: FREQUENCY is 'fast'"),
    ("qtm", f"{QTM}\tCiti_1 X\tCiti_1 Y\n", r"no body fits .*; the header has Citi_1"),
    ("qtm", HELMET, "no rows follow the header"),
    ("qtm", f"{HELMET}1\t2\t3\n", "row 12: 3 columns, not 5"),
    ("qtm", f"{HELMET}1\t0\t1\t7\t0\n2\t1\t1\t7\t0\t0\n", "row 13: 6 columns, not 5"),
    ("qtm", f"{HELMET}1\t0\t1\t7\t0\t0\n", "row 12: 6 columns, not 5"),
    ("qtm", f"{HELMET}1\t2\t3\tx\t4\n", "row 12: Helmet_1 Y is not a number: 'x'"),
    ("qtm", f"{HELMET}1\t\t3\t4\t4\n", "row 12: Time is not a number: ''"),
    ("qtm", f"{HELMET}\n1\t0\t0\t0\t0\n", "none of its 1 bodies is ever visible"),
    ("qtm", f"{HELMET}\n1\t0\t1e300\t0\t0\n", "row 13: position 1e.297, 0 is not a usable number"),
    ("qtm", HELMET + "1\t0\t1\t0\t0\n" * 2, "row 13: repeats"),
    ("qtm", f"{HELMET[:-1]}\tHelmet_1 X\n", "the header names Helmet_1  X twice"),
    ("tracklets", "Time,x,y,ag_id\n1,2,3,Helmet_1\n", "the header lacks tracklet_id"),
    ("tracklets", "Time,x,x,y,ag_id,tracklet_id\n1,1,2,3,4,5\n", "the header repeats x"),
    ("tracklets", f"{TRACKLETS}1,2,3\n", "row 1: 3 columns, not 5"),
    ("tracklets", f"{TRACKLETS}1,2,3,4,5\n2,2,3,6,5\n", "row 2: tracklet 5 is of two helmets"),
    ("tracklets", f"{TRACKLETS}1,2,3,4,5\n1,9,3,4,5\n", "row 2: repeats a moment of tracklet 5"),
]


@pytest.mark.parametrize(("kind", "text", "message"), REFUSALS)
def test_refusals(tmp_path, kind, text, message):
    path = tmp_path / "bad.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_any(path, ReadOptions(format=kind))
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x00\x01\x02\xff" * 999, "not text"),
        (b"PK\x03\x04" + b"ab" * 9999, ""),
        (b"PAR1" + b"\xff" * 99, "cannot be read"),
        (b"ARROW1\0\0" + b"\xff" * 99, "cannot be read"),
        (b"\x1f\x8b\x08\x00" + b"\xff" * 99, "gzip|cannot be read"),
    ],
)
def test_other_content(tmp_path, content, message):
    path = tmp_path / "binary.txt"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_any(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < len(str(path)) + 200


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"no\.txt: cannot be read"):
        read_any(tmp_path / "no.txt")
