"""A stand-in for the Hugging Face Hub on this machine, for commands that push to it or load from it.

It keeps repositories in memory and speaks as much of the Hub's protocol as `huggingface_hub` needs to create, commit
to, tag, list and download them. Every file travels inside its commit, so neither LFS nor Xet is needed.
"""

import base64
import hashlib
import json
import re
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import huggingface_hub.constants as constants
import pytest

from tests.preloaded import hub_at

USER = "tester"


@dataclass
class Repository:
    """What was pushed: the files of every revision by name, the newest revision, other branches' newest, the tags."""

    head: str
    revisions: dict[str, dict[str, bytes]]
    private: bool
    tags: dict[str, str] = field(default_factory=dict)
    branches: dict[str, str] = field(default_factory=dict)

    @property
    def files(self) -> dict[str, bytes]:
        """Contents by path, newest revision."""
        return self.revisions[self.head]

    def resolve(self, revision: str) -> str | None:
        """The revision that a branch, tag or revision names."""
        if revision in ("main", "refs/heads/main"):
            return self.head
        named = self.tags | self.branches
        return named.get(revision, revision if revision in self.revisions else None)

    def commit(self, lines: list[dict[str, Any]], branch: str = "main") -> str:
        """Apply the lines of a commit request to a branch."""
        before = self.branches.get(branch, self.head)
        files = dict(self.revisions[before])
        for line in lines:
            if line["key"] == "file":
                files[line["value"]["path"]] = base64.b64decode(line["value"]["content"])
            elif line["key"] == "deletedFile":
                files.pop(line["value"]["path"], None)
        digest = hashlib.sha1(before.encode())
        for path in sorted(files):
            digest.update(path.encode() + b"\0" + files[path])
        revision = digest.hexdigest()
        self.revisions[revision] = files
        if branch in self.branches:
            self.branches[branch] = revision
        else:
            self.head = revision
        return revision


@dataclass
class Hub:
    """A running stand-in.

    Attributes:
        url: Its address.
        repositories: By kind ("models" or "datasets") and name ("user/name").
    """

    url: str
    repositories: dict[tuple[str, str], Repository] = field(default_factory=dict)


@pytest.fixture
def hub() -> Iterator[Hub]:
    """An empty stand-in that ends with the test."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    server.hub = Hub(url=f"http://127.0.0.1:{server.server_port}")  # type: ignore[attr-defined]
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server.hub  # type: ignore[attr-defined]
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def online(hub: Hub, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Hub:
    """This process talks to the stand-in."""
    for name, value in hub_at(hub.url, tmp_path / "cache").items():
        monkeypatch.setattr(constants, name, value)
    monkeypatch.setenv("HF_TOKEN", "hf_stand_in")
    return hub


class _NotFoundError(Exception):
    """The named repository, revision or file does not exist; holds the Hub's word for which."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    @property
    def hub(self) -> Hub:
        return self.server.hub  # type: ignore[attr-defined]

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""

    def _handle(self) -> None:
        path = unquote(urlsplit(self.path).path)
        body = self._body()
        try:
            if path == "/api/whoami-v2":
                self._json({"type": "user", "name": USER, "orgs": [], "auth": {"accessToken": {"role": "write"}}})
            elif path == "/api/validate-yaml":  # of a README's head
                self._json({"errors": [], "warnings": []})
            elif path == "/api/repos/create":
                self._create(json.loads(body))
            elif match := re.fullmatch(r"/api/(models|datasets)/([^/]+/[^/]+)(?:/([^/]+))?(?:/(.*))?", path):
                kind, name, operation, argument = match.groups(default="")
                self._repository(kind, name, operation, argument, body)
            elif match := re.fullmatch(r"/(?:(datasets)/)?([^/]+/[^/]+)/resolve/([^/]+)/(.+)", path):
                self._file(match[1] or "models", *match.groups()[1:])
            else:
                raise _NotFoundError("EntryNotFound")
        except _NotFoundError as error:
            self._send(404, b"", {"X-Error-Code": str(error), "X-Error-Message": str(error)})

    do_GET = do_HEAD = do_POST = do_DELETE = _handle  # noqa: N815

    def _create(self, request: dict[str, Any]) -> None:
        kind = f"{request.get('type') or 'model'}s"
        name = f"{request.get('organization') or USER}/{request['name']}"
        url = f"{self.hub.url}/{'datasets/' if kind == 'datasets' else ''}{name}"
        if (kind, name) in self.hub.repositories:
            self._json({"error": "exists", "url": url}, status=409)
            return
        first = hashlib.sha1(name.encode()).hexdigest()
        private = bool(request.get("private")) or request.get("visibility") == "private"
        self.hub.repositories[kind, name] = Repository(head=first, revisions={first: {}}, private=private)
        self._json({"url": url, "name": name})

    def _repository(self, kind: str, name: str, operation: str, argument: str, body: bytes) -> None:
        repository = self._find(kind, name)
        if operation == "preupload":
            files = [
                {"path": file["path"], "uploadMode": "regular", "shouldIgnore": False, "oid": None}
                for file in json.loads(body)["files"]
            ]
            self._json({"files": files})
        elif operation == "commit":
            revision = repository.commit([json.loads(line) for line in body.splitlines()], argument or "main")
            url = f"{self.hub.url}/{name}/commit/{revision}"
            self._json({"success": True, "commitOid": revision, "commitUrl": url, "hookOutput": ""})
        elif operation == "branch":
            repository.branches[argument] = repository.head
            self._json({})
        elif operation == "tag" and self.command == "DELETE":
            if repository.tags.pop(argument, None) is None:
                raise _NotFoundError("RevisionNotFound")
            self._json({})
        elif operation == "tag":
            repository.tags[json.loads(body)["tag"]] = self._resolve(repository, argument)
            self._json({})
        elif operation == "refs":
            heads = {"main": repository.head} | repository.branches
            branches = [
                {"name": name, "ref": f"refs/heads/{name}", "targetCommit": revision}
                for name, revision in heads.items()
            ]
            tags = [
                {"name": tag, "ref": f"refs/tags/{tag}", "targetCommit": revision}
                for tag, revision in repository.tags.items()
            ]
            self._json({"branches": branches, "tags": tags, "converts": []})
        else:
            self._list(repository, name, operation, argument, body)

    def _list(self, repository: Repository, name: str, operation: str, argument: str, body: bytes) -> None:
        named, _, folder = argument.partition("/")
        revision = self._resolve(repository, named or "main")
        files = repository.revisions[revision]
        if operation == "tree":
            wanted = [path for path in files if path.startswith(folder)]
        elif operation == "paths-info":
            wanted = [path for path in json.loads(body)["paths"] if path in files]
        else:
            siblings = [{"rfilename": path} for path in files]
            self._json({"_id": revision, "id": name, "sha": revision, "tags": [], "siblings": siblings})
            return
        self._json(
            [{"type": "file", "path": path, "size": len(files[path]), "oid": _digest(files[path])} for path in wanted]
        )

    def _file(self, kind: str, name: str, revision: str, path: str) -> None:
        repository = self._find(kind, name)
        resolved = self._resolve(repository, revision)
        content = repository.revisions[resolved].get(path)
        if content is None:
            raise _NotFoundError("EntryNotFound")
        headers = {"ETag": f'"{_digest(content)}"', "X-Repo-Commit": resolved, "Accept-Ranges": "bytes"}
        if part := re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range") or ""):
            first, last = int(part[1]), int(part[2] or len(content) - 1)
            headers["Content-Range"] = f"bytes {first}-{last}/{len(content)}"
            self._send(206, content[first : last + 1], headers)
        else:
            self._send(200, content, headers)

    def _find(self, kind: str, name: str) -> Repository:
        if (kind, name) not in self.hub.repositories:
            raise _NotFoundError("RepoNotFound")
        return self.hub.repositories[kind, name]

    def _resolve(self, repository: Repository, revision: str) -> str:
        resolved = repository.resolve(revision)
        if resolved is None:
            raise _NotFoundError("RevisionNotFound")
        return resolved

    def _body(self) -> bytes:
        if self.headers.get("Transfer-Encoding", "").lower() != "chunked":
            return self.rfile.read(int(self.headers.get("Content-Length") or 0))
        chunks = []
        while size := int(self.rfile.readline().split(b";")[0], 16):
            chunks.append(self.rfile.read(size))
            self.rfile.readline()
        self.rfile.readline()
        return b"".join(chunks)

    def _json(self, answer: object, status: int = 200) -> None:
        self._send(status, json.dumps(answer).encode(), {"Content-Type": "application/json"})

    def _send(self, status: int, content: bytes, headers: dict[str, str]) -> None:
        self.send_response(status)
        for key, value in (headers | {"Content-Length": str(len(content))}).items():
            self.send_header(key, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)


def _digest(content: bytes) -> str:
    return hashlib.sha1(content).hexdigest()
