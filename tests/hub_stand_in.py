"""A stand-in for the Hugging Face Hub: the few requests of an upload, and files in memory.

It answers as the Hub's documented interface does: text files come within the commit, images by the
LFS batch interface. The Hub's own storage protocol (Xet) is not imitated.
"""

import base64
import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


class StandIn(ThreadingHTTPServer):
    """Repositories with their files, and blobs by SHA-256."""

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
