"""Builds the documentation and checks its links: ``python docs/_ext/build.py [FOLDER]``, what ``make docs`` does.

A warning is an error. The pages are in the subfolder ``html``; FOLDER is ``docs/_build`` unless it is named. With
``--without-results``, notebooks are not run.
"""

import gc
import json
import os
import sys
from pathlib import Path

import links
from sphinx.cmd.build import main as sphinx_build

DOCS = Path(__file__).parents[1]


def main(folder: Path, *, with_results: bool = True) -> int:
    """Return the exit code."""
    _quieten_kernels(folder / "ipython")
    html = folder / "html"
    options = ["--fail-on-warning", "--keep-going", "--quiet", "--doctree-dir", str(folder / "doctrees")]
    if not with_results:  # Only a kernel tells the language of its cells.
        options += ["--define", "nb_execution_mode=off", "--define", "suppress_warnings=myst-nb.lexer"]
    code = sphinx_build([*options, str(DOCS), str(html)])
    if code:
        return code
    pages = links.read_pages(html)
    faults = links.faults(html, pages)
    for fault in faults:
        sys.stderr.write(f"{fault}\n")
    elsewhere = links.external(pages)
    (folder / "external_links.txt").write_text("".join(f"{address}\n" for address in elsewhere))
    sys.stdout.write(
        f"{html / 'index.html'}: {len(pages)} pages, {sum(len(page.links) for page in pages.values())} links, "
        f"{len(faults)} of them wrong; {len(elsewhere)} addresses elsewhere (not asked) are in external_links.txt\n"
    )
    return 1 if faults else 0


def _quieten_kernels(folder: Path) -> None:
    """Keep what notebooks need in this folder, not in the user's, and leave out their warning of loopback."""
    os.environ["IPYTHONDIR"] = str(folder.resolve())
    configuration = folder / "profile_default" / "ipython_kernel_config.json"
    configuration.parent.mkdir(parents=True, exist_ok=True)
    configuration.write_text(json.dumps({"IPKernelApp": {"log_level": 40}}))


if __name__ == "__main__":
    gc.disable()  # The trees of all pages are needed until the end; looking for garbage takes a sixth of the time.
    words = [word for word in sys.argv[1:] if word != "--without-results"]
    sys.exit(main(Path(*words) if words else DOCS / "_build", with_results="--without-results" not in sys.argv))
