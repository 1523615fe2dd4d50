"""Files of measurements: placed whole, discarded whole."""

import errno
import json
import os
from pathlib import Path

import pytest

from service.storage.blobs import Blobs, Incoming
from tests.support.application import application


def test_file_is_durable_before_it_is_placed_and_its_name_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blobs = Blobs(tmp_path)
    blobs.make_folders()
    incoming = blobs.incoming()
    incoming.write(b"content")
    steps: list[tuple[str, Path]] = []
    fsync, replace = os.fsync, Path.replace

    def record_fsync(descriptor: int) -> None:
        steps.append(("fsync", Path(f"/proc/self/fd/{descriptor}").readlink()))
        fsync(descriptor)

    def record_replace(source: Path, target: Path) -> Path:
        steps.append(("replace", source))
        return replace(source, target)

    monkeypatch.setattr(os, "fsync", record_fsync)
    monkeypatch.setattr(Path, "replace", record_replace)
    folder = blobs.path(incoming.close()).parent
    blobs.place(incoming)
    written = incoming.path
    assert steps == [("fsync", written), ("fsync", folder.parent), ("replace", written), ("fsync", folder)]


@pytest.mark.anyio
async def test_full_disk_is_507_until_there_is_room(
    tmp_path: Path, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = Incoming.write

    def write_until_full(incoming: Incoming, content: bytes | memoryview) -> None:
        if incoming.size + len(content) > 20_000_000:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(incoming, content)

    async with application(tmp_path, monkeypatch) as running:
        upload = "/v1/measurements", running.new_key(), "POST", data, "application/octet-stream"
        with monkeypatch.context() as full:
            full.setattr(Incoming, "write", write_until_full)
            refused = await running.ask(*upload).end()
        assert (refused.status, json.loads(refused.body)["type"]) == (507, "urn:dsbrdf:problem:disk-full")
        assert list((tmp_path / "tmp").iterdir()) == []
        assert (await running.ask(*upload).end()).status == 201
