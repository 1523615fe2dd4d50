"""Run the HTTP service, which takes measurements and returns fitted DSBRDF models, their values and components.

Subpackages and modules, each importing only those to its left: errors, settings, log, wire, storage, access, queue,
compute, http, api, app, admin, client, __main__.
"""

DEFAULT_DATA_DIR = "dsbrdf-data"
