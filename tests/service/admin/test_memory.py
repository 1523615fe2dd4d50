"""Memory that is free goes back to the system."""

import platform
import subprocess
import sys

import pytest

PROGRAM = """
from pathlib import Path
from dsbrdf.process_settings import trim_memory

def megabytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

kept = [bytes(3000) for _ in range(40_000)]
last = bytes(3000)  # at the end of the heap, which therefore does not shrink by itself
kept.clear()
before = megabytes()
trim_memory()
print(before - megabytes())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries return memory as they like")
def test_free_memory_is_returned() -> None:
    answer = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert float(answer.stdout) > 60
