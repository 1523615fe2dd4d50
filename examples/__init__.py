"""Programs that use the library and the service, run from a clone."""
