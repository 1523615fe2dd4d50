"""Imported once by the server from which worker processes are forked, so that every worker finds its imports done."""

import atexit
import os
import shutil

import dsbrdf.engines.local  # noqa: F401 (what workers run)
from dsbrdf.data.grid import nodes_above_horizon
from dsbrdf.engines.worker_process import SERVER_FOLDER

nodes_above_horizon()  # the result is cached, and the workers share its memory

if SERVER_FOLDER in os.environ:
    # The process that started the server removes the folder too, but cannot do so after a kill -9.
    atexit.register(shutil.rmtree, os.environ.pop(SERVER_FOLDER), ignore_errors=True)
