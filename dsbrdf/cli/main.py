"""Run the command ``dsbrdf``.

Angles are in degrees on the command line, BRDF values in 1/sr, colours in the order red, green, blue. Exit codes:
0 success; 2 bad usage or bad input, with one sentence on stderr; 130 interrupted; 1 any other failure.

The module `dsbrdf.cli.commands` defines the commands. This module is imported late, because it needs the extra ``cli``.
"""

import os
import sys
from collections.abc import Sequence

from dsbrdf.cli.arguments import BAD_INPUT, SERVICE_COMMANDS, prepare_output, print_error, run_service_command
from dsbrdf.errors import WRONG_PATH_ERRORS, DSBRDFError
from dsbrdf.extras import MissingExtraError, require
from dsbrdf.process_settings import ONE_BLAS_THREAD
from dsbrdf.version import __version__

INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; `argv` are the arguments after ``dsbrdf``. Return the exit code."""
    prepare_output()
    try:
        code = _run(list(sys.argv[1:] if argv is None else argv))
        sys.stdout.flush()
    except (DSBRDFError, *WRONG_PATH_ERRORS) as error:
        print_error(error)
        return BAD_INPUT
    except BrokenPipeError:
        # The reader of our output, such as `head`, has ended, so that flushing stdout at the end would fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (MissingExtraError, OSError) as error:
        print_error(error)
        return 1
    except KeyboardInterrupt:
        print_error("interrupted")
        return INTERRUPTED
    return code


def _run(words: list[str]) -> int:
    if words == ["--version"]:
        print(f"dsbrdf {__version__}")
        return 0
    if not words:
        print_error("name a command (see dsbrdf --help)")
        return BAD_INPUT
    if words[0] in SERVICE_COMMANDS:
        return run_service_command(words[0], words[1:])
    # NumPy reads these environment variables when it is imported, so that they must be set before.
    if words[0] == "fit" and "numpy" not in sys.modules:
        os.environ.update(ONE_BLAS_THREAD)
    require("cli", "cyclopts", "rich", purpose="the command line")
    from dsbrdf.cli.commands import run_command  # After the environment and the extra are as it needs them.

    return run_command(words)


if __name__ == "__main__":
    sys.exit(main())
