"""What ``dsbrdf fit`` gives of several files: a line each, a table, CSV, figures; and fits on a server."""

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import dsbrdf
from dsbrdf.cli import fit_command
from dsbrdf.engines.batch import FileFit
from dsbrdf.fitting.report import FitResult
from tests.support.command_line import QUICK, document, printed, run, sentence
from tests.support.guarded import Guarded
from tests.support.server import Server


@pytest.fixture
def three_files(two_lobe_fit: FitResult, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the fits of three files be known: a good one, a failed one, a bad one."""

    def known(files: list[Path], *_: Any, **__: Any) -> Iterator[FileFit]:
        report = two_lobe_fit.report
        worse = replace(report, metrics=replace(report.metrics, relative_rms=0.9), warnings=("Look at it.",))
        yield FileFit(files[0], result=two_lobe_fit)
        yield FileFit(files[1], error="no measurement")
        yield FileFit(files[2], result=FitResult(two_lobe_fit.model, worse))

    monkeypatch.setattr(fit_command, "fit_files", known)


@pytest.mark.usefixtures("three_files")
def test_several_files_end_with_a_table_worst_first(two_lobe_fit: FitResult, tmp_path: Path) -> None:
    table = tmp_path / "fits.csv"
    command = ["fit", "good.binary", "none.binary", "bad.binary"]
    captured = run(*command, "--csv", table, code=2)
    assert captured.stderr.splitlines() == ["dsbrdf: none.binary: no measurement", "dsbrdf: bad.binary: Look at it."]
    first, second, _, head, *rows, failed = captured.stdout.splitlines()
    assert first.startswith("good: close (")
    assert second.startswith("bad: close (")
    assert head.split() == ["relative_rms", "excess", "psnr", "lobes", "warnings", "worst", "first"]
    assert [row.split()[-1] for row in rows] == ["bad", "good"]
    assert rows[0].split()[0] == "0.9"
    assert failed == "1 file could not be fitted"

    written = list(csv.DictReader(table.read_text().splitlines()))
    assert [row["file"] for row in written] == ["good.binary", "none.binary", "bad.binary"]
    assert [row["status"] for row in written] == ["succeeded", "failed", "succeeded"]
    assert float(written[0]["psnr"]) == two_lobe_fit.report.metrics.psnr
    assert (written[0]["n_lobes"], written[0]["ring_lobes"]) == ("2", "0")
    assert (written[1]["error"], written[2]["warnings"]) == ("no measurement", "Look at it.")
    items = document(*command, "--json", code=2)["items"]
    assert [(item["file"], item["status"]) for item in items] == [(row["file"], row["status"]) for row in written]
    assert items[1]["error"] == "no measurement"


def test_fit_saves_reports_and_draws(plastic_file: Path, tmp_path: Path) -> None:
    out = printed("fit", plastic_file, "-o", tmp_path, "--plot", *QUICK)
    assert "component     half width" in out
    assert out.splitlines()[-2:] == [f"saved: {tmp_path / 'plastic.json'}", f"figure: {tmp_path / 'plastic.png'}"]
    assert (tmp_path / "plastic.png").read_bytes().startswith(b"\x89PNG")
    assert dsbrdf.load_result(tmp_path / "plastic.json").model.n_lobes == 1


def test_fit_on_a_server_is_the_fit_here(server: Server, plastic_file: Path, tmp_path: Path) -> None:
    address = ["--url", str(server.http.base_url)]
    there = document("fit", plastic_file, "--json", "-o", tmp_path, *address, *QUICK)
    assert there["model"] == document("fit", plastic_file, "--json", *QUICK)["model"]
    assert json.loads((tmp_path / "plastic.json").read_text())["model"] == there["model"]
    no_measurement = tmp_path / "cut.binary"
    no_measurement.write_bytes(plastic_file.read_bytes()[:1000])
    assert "1000" in sentence("fit", no_measurement, *address)


def test_server_that_does_not_answer_or_wants_a_key_is_named(guarded: Guarded, plastic_file: Path) -> None:
    said = sentence("fit", plastic_file, "--url", "http://127.0.0.1:9", code=1)
    nobody = "dsbrdf: nothing answers at http://127.0.0.1:9: is a service running there? dsbrdf serve starts one"
    assert said.startswith(nobody)
    assert "the environment variable DSBRDF_KEY" in sentence("fit", plastic_file, "--url", guarded.server.http.base_url)
