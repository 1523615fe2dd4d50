"""``python -m dsbrdf_service``: run the HTTP service."""

import signal
import sys

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C during the imports ends the process without a traceback.

from .admin.serve import main

if __name__ == "__main__":
    sys.exit(main())
