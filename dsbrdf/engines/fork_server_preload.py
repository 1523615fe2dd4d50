"""What the server that children are forked from does before the first of them: what all of them need is made once."""

import atexit
import os
import shutil

from dsbrdf.data.grid import nodes_above_horizon
from dsbrdf.engines.worker_process import SERVER_FOLDER

nodes_above_horizon()

if SERVER_FOLDER in os.environ:
    # Who has started the server removes it, too, but not after a kill -9.
    atexit.register(shutil.rmtree, os.environ.pop(SERVER_FOLDER), ignore_errors=True)
