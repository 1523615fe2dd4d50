"""Measurements put into a store without a service."""

from service.storage.schema import Caller
from service.storage.store import Store
from service.storage.uploads import Received

LOCAL = Caller()


def receive(store: Store, content: bytes = b"content") -> Received:
    incoming = store.blobs.incoming()
    incoming.write(content)
    return Received(incoming, incoming.close(), 1)


def add(store: Store, content: bytes = b"content", caller: Caller = LOCAL) -> str:
    """Store bytes as a measurement and return their sha256."""
    received = receive(store, content)
    row, new = store.add_measurement(caller, received)
    received.incoming.discard()
    assert (new, row.owner) == (True, caller.owner)
    return row.sha256
