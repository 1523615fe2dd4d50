"""Files of measurements: placed whole, discarded whole."""

import asyncio
import errno
import os
from pathlib import Path

import httpx
import pytest
from starlette.types import Message

from dsbrdf.data.merl_validation import FILE_SIZE
from service.app import create_app
from service.http.responses import OpenFileResponse
from service.settings import Settings
from service.storage.blobs import Blobs, Incoming
from tests.support.server import QUICK, assert_problem


def test_discarded_upload_is_removed_and_placed_one_stays(tmp_path: Path) -> None:
    blobs = Blobs(tmp_path)
    blobs.make_folders()
    dropped, kept = blobs.incoming(), blobs.incoming()
    dropped.write(b"a")
    dropped.discard()
    dropped.discard()
    kept.write(b"b")
    sha256 = kept.close()
    blobs.place(kept)
    kept.discard()
    assert list(blobs.all()) == [sha256]
    assert blobs.path(sha256).read_bytes() == b"b"
    assert not list((tmp_path / "tmp").iterdir())


def test_file_is_durable_before_it_is_placed_and_its_name_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blobs = Blobs(tmp_path)
    blobs.make_folders()
    incoming = blobs.incoming()
    incoming.write(b"content")
    steps: list[tuple[str, str]] = []
    fsync, replace = os.fsync, Path.replace

    def record_fsync(descriptor: int) -> None:
        steps.append(("fsync", str(Path(f"/proc/self/fd/{descriptor}").readlink())))
        fsync(descriptor)

    def record_replace(source: Path, target: Path) -> Path:
        steps.append(("replace", str(source)))
        return replace(source, target)

    monkeypatch.setattr(os, "fsync", record_fsync)
    monkeypatch.setattr(Path, "replace", record_replace)
    sha256 = incoming.close()
    blobs.place(incoming)
    folder = blobs.path(sha256).parent
    written = str(incoming.path)
    assert steps == [
        ("fsync", written),
        ("fsync", str(folder.parent)),
        ("replace", written),
        ("fsync", str(folder)),
    ]


def test_download_survives_deletion_of_its_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"content")
    sent: list[Message] = []

    async def send(message: Message) -> None:
        sent.append(message)

    async def receive() -> Message:
        await asyncio.sleep(60)
        return {"type": "http.disconnect"}

    response = OpenFileResponse(path, {}, "text/plain", "0" * 64, pytest.fail)
    path.unlink()
    scope = {"type": "http", "method": "GET", "headers": [(b"range", b"bytes=3-")]}
    asyncio.run(response(scope, receive, send))
    assert sent[0]["status"] == 206
    assert b"".join(message.get("body", b"") for message in sent) == b"tent"
    with pytest.raises(FileNotFoundError):
        OpenFileResponse(path, {}, "text/plain", "0" * 64, pytest.fail)


def test_full_disk_is_507_until_there_is_room(tmp_path: Path, data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    full = {"at": 20_000_000}
    write = Incoming.write

    def write_until_full(incoming: Incoming, content: bytes | memoryview) -> None:
        if incoming.size + len(content) > full["at"]:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(incoming, content)

    monkeypatch.setattr(Incoming, "write", write_until_full)
    app = create_app(Settings(data_dir=tmp_path / "data", workers=1))

    async def post_twice() -> tuple[httpx.Response, list[Path], httpx.Response]:
        transport = httpx.ASGITransport(app)
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=transport, base_url="http://localhost", timeout=60) as http,
        ):
            first = await http.post("/v1/fits", params=QUICK, content=data)
            left = list((tmp_path / "data").glob("tmp/*"))
            full["at"] = FILE_SIZE
            return first, left, await http.post("/v1/fits", params=QUICK, content=data)

    first, left, second = asyncio.run(post_twice())
    assert_problem(first, 507, "disk-full")
    assert left == []
    assert second.json()["status"] == "succeeded"
