"""The HTTP service: takes measurements, returns fitted DSBRDF models, their values and their components.

Wings, each calling only those to its left: errors, settings, storage, operations, wire, client, client_engine,
access, http, jobs, routes, app, commands, __main__.
"""

DEFAULT_DATA_DIR = "dsbrdf-data"
