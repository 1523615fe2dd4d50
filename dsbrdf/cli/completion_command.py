"""The command ``dsbrdf completion``: a script with which a shell completes commands, options and files."""

from typing import Literal

Shell = Literal["bash", "zsh", "fish"]


def completion(shell: Shell, /) -> int:
    """Print the script; return the exit code.

    Parameters
    ----------
    shell
        Load the script with: eval "$(dsbrdf completion bash)"; in fish with: dsbrdf completion fish | source
    """
    from dsbrdf.cli.commands import application  # it imports this module

    script = application().generate_completion(shell=shell)  # nosec B604
    print(script)
    return 0
