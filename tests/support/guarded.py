"""A service that wants keys, and keys made beside it."""

from dataclasses import dataclass
from subprocess import CompletedProcess
from typing import Any

from dsbrdf_service.admin.commands import keys
from dsbrdf_service.storage.database import Database
from dsbrdf_service.storage.keys import add_key
from tests.support.commands import run_main
from tests.support.server import Server


@dataclass(frozen=True)
class Guarded:
    """A service that wants keys, and the headers that hold the keys of two users."""

    server: Server
    alice: dict[str, str]
    bob: dict[str, str]

    def new_key(self, name: str = "another", **limits: Any) -> dict[str, str]:
        """Return the header of a further key."""
        return new_key(self.server, name, **limits)[1]


def new_key(server: Server, name: str, **limits: Any) -> tuple[str, dict[str, str]]:
    """Make a key beside a running service, and use it at once; return its id and the header that holds it."""
    database = Database(server.data_dir, exclusive=False)
    key_id, key = add_key(database, name, **limits)
    database.close()
    header = {"Authorization": f"Bearer {key}"}
    assert server.http.get("/v1/fits", headers=header).status_code == 200
    return key_id, header


def keys_command(*words: str) -> "CompletedProcess[str]":
    """Run ``dsbrdf keys`` without a process of its own."""
    return run_main(keys, *words)
