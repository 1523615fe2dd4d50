"""Measurements put into a store without a service."""

from dsbrdf_service.storage.files import Incoming
from dsbrdf_service.storage.schema import Caller
from dsbrdf_service.storage.store import Store

LOCAL = Caller()


def receive(store: Store, content: bytes = b"content") -> Incoming:
    incoming = Incoming(store.blobs.temporary)
    incoming.write(content)
    incoming.valid_nodes = 1
    incoming.close()
    return incoming


def add(store: Store, content: bytes = b"content", caller: Caller = LOCAL) -> str:
    """Store bytes as a measurement and return their sha256."""
    incoming = receive(store, content)
    row, new = store.add_measurement(caller, incoming)
    incoming.discard()
    assert (new, row.owner) == (True, caller.owner)
    return row.sha256
