"""``python -m dsbrdf_service``: run the HTTP service."""

import signal
import sys

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # what follows takes a second, and Ctrl-C may end it at once

from .admin.serve import main

if __name__ == "__main__":
    sys.exit(main())
