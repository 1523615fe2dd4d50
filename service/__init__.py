"""The HTTP service: takes measurements, returns fitted DSBRDF models, their values and their components.

Wings, each calling only those to its left: errors, settings, storage, operations, wire, http, access, jobs, routes,
app, client, commands. The Python `client` uses only errors and wire.
"""

DEFAULT_DATA_DIR = "dsbrdf-data"
