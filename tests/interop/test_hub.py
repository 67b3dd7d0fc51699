"""Models to the Hugging Face Hub and back: through folders, and a small server in its place."""

import base64
import dataclasses
import json
import re
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
import yaml

from neurosym_jax import InputError, load_model, save_model
from neurosym_jax.data.recordings import licences_of
from neurosym_jax.interop import from_pretrained, push_to_hub
from tests.repository import run_python

COMMIT = "c" * 40


class Hub(BaseHTTPRequestHandler):
    """The part of the Hub's interface that an upload and a download of small files need."""

    files: dict[str, bytes]
    commits: list[str]
    """Paths of the repositories that were committed to."""
    made: dict[str, bool]
    """Whether the repository is private, as it was asked for first."""

    def do_POST(self):
        body = self.rfile.read(int(self.headers["Content-Length"]))
        if self.path.endswith("/repos/create"):
            asked = json.loads(body)
            is_private = asked.get("private") or asked.get("visibility") == "private"
            self.made.setdefault("private", bool(is_private))
        if "/preupload/" in self.path:
            small = {"uploadMode": "regular", "shouldIgnore": False}
            self.reply(
                {
                    "files": [
                        {"path": f["path"], **small} for f in json.loads(body)["files"]
                    ]
                }
            )
            return
        if "/commit/" in self.path:
            self.commits.append(self.path)
            lines = [json.loads(line) for line in body.splitlines()]
            for file in (line["value"] for line in lines if line["key"] == "file"):
                self.files[file["path"]] = base64.b64decode(file["content"])
        url = f"http://{self.headers['Host']}/me/walkers"
        self.reply(
            {"url": url, "commitUrl": f"{url}/commit/{COMMIT}", "commitOid": COMMIT}
        )

    def do_GET(self):
        name = self.path.split("/")[-1]
        elsewhere = "/revision/" in self.path and name not in ("main", COMMIT)
        is_ours = self.path.startswith(("/api/models/me/walkers", "/me/walkers"))
        if elsewhere or not is_ours:
            self.reply({"error": "Repository not found"}, 404)
        elif "/resolve/" in self.path:
            headers = {"ETag": f'"{name}"', "X-Repo-Commit": COMMIT}
            self.reply(self.files[name], **headers)
        elif "/tree/" in self.path:
            sizes = {name: len(content) for name, content in self.files.items()} | {
                "film.mp4": 9
            }
            file = {"type": "file", "oid": "0" * 40}
            self.reply(
                [{**file, "path": name, "size": size} for name, size in sizes.items()]
            )
        else:
            siblings = [{"rfilename": file} for file in (*self.files, "film.mp4")]
            facts = {"id": "me/walkers", "sha": COMMIT, "siblings": siblings}
            self.reply(facts | self.made)

    do_HEAD = do_GET

    def reply(self, content, status=200, **headers):
        data = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(status)
        for name, value in ({"Content-Length": str(len(data))} | headers).items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    def log_message(self, format, *args):
        pass


@pytest.fixture
def hub():
    handler = type("OneHub", (Hub,), {"files": {}, "commits": [], "made": {}})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}", handler
        server.shutdown()


TASK = "time-series-forecasting"


@pytest.mark.parametrize(
    ("data", "licence"),
    [
        ({}, "unknown"),
        ({"simulations": "MIT"}, "mit"),
        ({"ETH/UCY": "unstated"}, "unknown"),
        (
            licences_of(["Stanford"]),
            "cc-by-nc-sa-3.0",
        ),  # As training names a folder of SDD.
        ({"SDD": "CC BY-NC-SA 3.0, restricted", "ETH/UCY": "unstated"}, "other"),
    ],
)
def test_folders_have_the_header_of_the_hub(model, tmp_path, data, licence):
    datasets = [name.lower().replace("/", "-") for name in data]
    for card, facts in (
        (None, (licence, datasets, "neurosym_jax", TASK)),
        ("---\nlicense: mit\n---\n\n# Mine\n", ("mit", None, None, None)),
    ):
        folder = tmp_path / str(facts[2])
        save_model(folder, dataclasses.replace(model("none"), data=data), card)
        text = (folder / "README.md").read_text()
        (head,) = re.findall(r"\A---\n(.*?)---\n\n# ", text, re.DOTALL)
        header = yaml.safe_load(head)
        names = ("license", "datasets", "library_name", "pipeline_tag")
        fields = tuple(map(header.get, names))
        assert fields == facts
        assert from_pretrained(folder).data == data


def run(code, tmp_path, endpoint):
    """What `code` prints in a process whose Hub is `endpoint`."""
    pytest.importorskip("huggingface_hub", reason="huggingface_hub is not installed")
    hub = {
        "HF_ENDPOINT": endpoint,
        "HF_TOKEN": "hf_a",
        "HF_HOME": str(tmp_path / "cache"),
    }
    hub["HF_HUB_DISABLE_PROGRESS_BARS"] = "1"
    code = f"import neurosym_jax as nj\n{code}"
    return run_python("-c", code, cwd=tmp_path.parent, **hub).stdout


PUSH = """
model = nj.load_model('sgan_simulations_8')
try: print(nj.interop.push_to_hub(model, 'me/walkers'))
except nj.errors.InputError as error: print(error)
"""
PUSH_PRIVATE = PUSH.replace("'me/walkers'", "'me/walkers', private=True")
PULL = """
for name, revision in (('me/walkers', None), ('me/nobody', None), ('me/walkers', 'v0')):
    try: nj.save_model('back', nj.interop.from_pretrained(name, revision=revision))
    except nj.errors.InputError as error: print(error)
"""


def test_a_model_goes_to_the_hub_and_comes_back(hub, tmp_path, monkeypatch):
    """A process costs two seconds: one goes there and back, one meets what others changed."""
    monkeypatch.chdir(tmp_path)
    endpoint, handler = hub
    files, made = handler.files, handler.made
    code = PUSH_PRIVATE + PULL
    url, *missing = run(code, tmp_path / "first", endpoint).splitlines()
    assert url == f"{endpoint}/me/walkers/commit/{COMMIT}"
    assert made == {"private": True}
    assert sorted(files) == ["README.md", "config.json", "params.safetensors"]
    for name, content in files.items():
        assert (tmp_path / "back" / name).read_bytes() == content
    assert [line.split(": ")[0] for line in missing] == ["me/nobody", "me/walkers"]

    files["README.md"] += b"edited in the browser"
    made["private"] = False  # Somebody made it public.
    code = PULL + PUSH_PRIVATE + PUSH
    lines = run(code, tmp_path / "again", endpoint).splitlines()
    damaged, _, _, refused, public = lines
    assert "damaged: its files do not match the digest" in damaged
    assert "me/walkers: is there already and public: nothing is sent" in refused
    assert public == url
    assert len(handler.commits) == 2


def test_a_missing_model_is_named_in_one_line(monkeypatch):
    with pytest.raises(InputError, match="absent: no such model"):
        from_pretrained("absent")
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(
        InputError, match=r"me/walkers: the Hub needs huggingface_hub: .*\[hub\]"
    ):
        from_pretrained("me/walkers")
    with pytest.raises(InputError, match="the Hub needs"):
        push_to_hub(load_model("sgan_simulations_8"), "me/walkers")
