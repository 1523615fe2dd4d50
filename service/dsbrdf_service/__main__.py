"""``python -m dsbrdf_service``: run the HTTP service."""

import signal
import sys

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # The imports take a second; Ctrl-C ends them at once.

from .admin.serve import main

if __name__ == "__main__":
    sys.exit(main())
