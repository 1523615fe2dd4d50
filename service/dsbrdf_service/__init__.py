"""The HTTP service: takes measurements, returns fitted DSBRDF models, their values and their components.

Subpackages and modules, each importing only those to its left: errors, settings, log, storage, access, queue, compute,
http, api, app, admin, client, client_engine, __main__.
"""

DEFAULT_DATA_DIR = "dsbrdf-data"
