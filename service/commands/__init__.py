"""The service's commands beside ``serve``: keys, purge, doctor."""
