"""`eyespot dataset push` against a stand-in for the Hub on this machine."""

import base64
import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import huggingface_hub.constants
import pytest

from eyespot.benchmarks.sets.make import push
from eyespot.benchmarks.sets.read import verify_set
from eyespot.benchmarks.sets.score.scored_spots import sample_folder
from eyespot.formats.inputs import InputError
from tests.support.command_line import printed

TOKEN = "stand-in"

# What huggingface_hub calls in its own HTTP library is deprecated there.
pytestmark = pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")


class StandIn(ThreadingHTTPServer):
    """A stand-in for the Hub: repositories with their files, and blobs by SHA-256.

    It answers as the Hub's documented interface does: text files come within the commit, images by
    the LFS batch interface. The Hub's own storage protocol (Xet) is not imitated.
    """

    def __init__(self, token: str) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.token = token
        self.files: dict[str, dict[str, bytes]] = {}
        self.blobs: dict[str, bytes] = {}

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"


@contextmanager
def stand_in(token: str) -> Iterator[StandIn]:
    with StandIn(token) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


class _Handler(BaseHTTPRequestHandler):
    server: StandIn
    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        body = self._body()
        if self.headers.get("authorization") != f"Bearer {self.server.token}":
            self._answer({"error": "Invalid credentials"}, status=401)
        elif self.path == "/api/repos/create":
            name = f"{body['organization']}/{body['name']}"
            self.server.files.setdefault(name, {})
            self._answer({"url": f"{self.server.address}/datasets/{name}", "id": name})
        elif self.path == "/api/validate-yaml":
            self._answer({"errors": [], "warnings": []})
        elif "/preupload/" in self.path:
            self._answer({"files": [self._mode(file["path"]) for file in body["files"]]})
        elif self.path.endswith("/info/lfs/objects/batch"):
            self._answer({"transfer": "basic", "objects": [*map(self._upload, body["objects"])]})
        elif "/commit/" in self.path:
            self._commit(body)
        else:
            self._answer({"error": f"no {self.path}"}, status=404)

    def do_PUT(self) -> None:
        content = self.rfile.read(int(self.headers["content-length"]))
        self.server.blobs[hashlib.sha256(content).hexdigest()] = content
        self._answer({})

    def log_message(self, format: str, *args: Any) -> None:
        pass

    def _mode(self, path: str) -> dict[str, Any]:
        mode = "lfs" if path.endswith(".png") else "regular"
        return {"path": path, "uploadMode": mode, "shouldIgnore": False}

    def _upload(self, blob: dict[str, Any]) -> dict[str, Any]:
        action = {"href": f"{self.server.address}/upload/{blob['oid']}"}
        return {**blob, "actions": {"upload": action}}

    def _commit(self, lines: list[dict[str, Any]]) -> None:
        _, _, _, owner, name, *_ = self.path.split("/")
        files = self.server.files[f"{owner}/{name}"]
        for line in lines:
            value = line["value"]
            if line["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif line["key"] == "lfsFile":
                files[value["path"]] = self.server.blobs[value["oid"]]
        address = f"{self.server.address}/datasets/{owner}/{name}/commit/{'0' * 40}"
        self._answer({"commitUrl": address, "commitOid": "0" * 40, "success": True})

    def _body(self) -> Any:
        text = self.rfile.read(int(self.headers.get("content-length") or 0)).decode()
        if self.headers.get("content-type") == "application/x-ndjson":
            return [json.loads(line) for line in text.splitlines()]
        return json.loads(text or "{}")

    def _answer(self, content: dict[str, Any], *, status: int = 200) -> None:
        body = json.dumps(content).encode()
        self.send_response(status)
        self.send_header("content-type", "application/vnd.git-lfs+json")
        self.send_header("content-length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


@pytest.fixture
def hub(monkeypatch):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_DISABLE_XET", True)
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_DISABLE_PROGRESS_BARS", True)
    with stand_in(TOKEN) as server:
        yield server


def test_the_set_arrives_whole(hub, tmp_path):
    said = printed("dataset", "push", sample_folder(), "a-lab/sample", "--endpoint", hub.address)
    assert f"Wrote {hub.address}/datasets/a-lab/sample/commit/" in said
    for name, content in hub.files["a-lab/sample"].items():
        path = tmp_path / "copy" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    assert verify_set(tmp_path / "copy") == verify_set(sample_folder())


@pytest.mark.parametrize(("token", "name"), [("another", "a-lab/sample"), (TOKEN, "a lab/sample")])
def test_a_refused_token_or_name_is_one_message_with_the_remedy(hub, monkeypatch, token, name):
    monkeypatch.setenv("HF_TOKEN", token)
    with pytest.raises(InputError, match=rf"did not take .* as {name}.*hf auth login"):
        push(sample_folder(), name, endpoint=hub.address)
    assert not hub.files


def test_a_hub_that_cannot_be_reached_is_one_message(monkeypatch):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    with stand_in(TOKEN) as server:
        address = server.address
    with pytest.raises(InputError, match="did not take"):
        push(sample_folder(), "a-lab/sample", endpoint=address)


def test_what_is_no_complete_set_is_not_sent(hub, tmp_path):
    with pytest.raises(InputError, match="not a labelled set"):
        push(tmp_path, "a-lab/sample", endpoint=hub.address)
    assert not hub.files
