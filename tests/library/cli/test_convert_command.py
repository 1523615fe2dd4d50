import json
from pathlib import Path

import numpy as np
import pytest

from dsbrdf.data.grid import PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.merl import read_merl
from dsbrdf.data.rgl_file import encode_tensors, parse_tensors
from dsbrdf.data.sample_columns import VECTORS
from dsbrdf.output.export.rgl import rgl_bsdf
from dsbrdf.output.serialize import load_result
from tests.support.command_line import document, printed, run
from tests.support.known_models import single_lobe
from tests.support.mixtures import mixture, scattered_samples

pytestmark = pytest.mark.usefixtures("coarse_sampling")
TRUTH = mixture(1, 0)


def test_a_measurement_becomes_a_bsdf_file_or_is_copied_bit_for_bit(plastic_file: Path, tmp_path: Path) -> None:
    output, copy = tmp_path / "plastic.bsdf", tmp_path / "copy.binary"
    run("convert", plastic_file, output)
    fields = parse_tensors(output.read_bytes())
    assert fields["rgb"].shape[2] == 3
    assert fields["rgb"].min() >= 0.0
    run("convert", plastic_file, copy)
    assert copy.read_bytes() == plastic_file.read_bytes()


def test_an_rgl_file_loses_nothing_in_a_bsdf_file(tmp_path: Path) -> None:
    source = tmp_path / "paint.bsdf"
    source.write_bytes(rgl_bsdf(TRUTH))
    run("convert", source, tmp_path / "copy.bsdf")
    assert (tmp_path / "copy.bsdf").read_bytes() == source.read_bytes()
    run("convert", source, tmp_path / "spectral.bsdf", "--spectral")
    assert "spectra" in parse_tensors((tmp_path / "spectral.bsdf").read_bytes())


def test_an_rgl_file_becomes_a_merl_file(tmp_path: Path) -> None:
    source, output, model = tmp_path / "paint.bsdf", tmp_path / "paint.binary", single_lobe(1.0, 1.0, 0.2)
    source.write_bytes(rgl_bsdf(model))
    printed = run("convert", source, output)
    assert ": non reciprocity 0.0%" in printed.stdout
    assert printed.stderr == ""
    expected = model.evaluate(THETA_HALF[20], THETA_DIFF[30], PHI_DIFF[90])
    np.testing.assert_allclose(read_merl(output).values[:, 20, 30, 90], expected, rtol=0.02)


def test_what_a_merl_table_cannot_hold_of_a_bsdf_file_is_told(tmp_path: Path) -> None:
    """One order of the directions is brighter than the other: by a factor that grows with the first angle."""
    fields = dict(parse_tensors(rgl_bsdf(single_lobe(1.0, 1.0, 0.2))))
    fields["rgb"] = (fields["rgb"] * (1.0 + 1.5 * fields["theta_i"])[:, None, None, None]).astype(np.float32)
    (tmp_path / "one-way.bsdf").write_bytes(encode_tensors(fields))
    printed = run("convert", tmp_path / "one-way.bsdf", tmp_path / "one-way.binary", "--json")
    assert "warning: " in printed.stderr
    assert json.loads(printed.stdout)["non_reciprocity"] == pytest.approx(expected_difference(1.5), abs=0.02)


def expected_difference(growth: float) -> float:
    """Median of 2 |a - b| / (a + b) of the factors at two angles whose cosines are spread evenly."""
    cosine = np.random.default_rng(7).uniform(np.cos(np.radians(75.0)), 1.0, (2, 100_000))
    factor = 1.0 + growth * np.arccos(cosine)
    near = np.random.default_rng(8).random(cosine.shape[1]) < 0.25  # mirror pairs have equal angles
    difference = np.where(near, 0.0, 2.0 * np.abs(factor[0] - factor[1]) / factor.sum(axis=0))
    return float(np.median(difference))


def test_a_table_is_fitted_and_stored_or_converted(tmp_path: Path) -> None:
    samples, table = scattered_samples(TRUTH, 500), tmp_path / "felt.csv"
    head = ",".join((*VECTORS, "red", "green", "blue"))
    columns = [samples.omega_in, samples.omega_out, samples.values]
    np.savetxt(table, np.hstack(columns), delimiter=",", header=head, comments="", fmt="%.9g")
    command = ["fit", str(table), "-o", str(tmp_path), "--n-lobes", "1", "--ring-lobes", "0"]
    metrics = document(*command, "--json")["metrics"]
    assert metrics["relative_rms"] < 0.01
    assert metrics["psnr"] is None
    angles = np.radians(10.0), np.radians(30.0)
    found = load_result(tmp_path / "felt.json").model.evaluate(*angles)
    np.testing.assert_allclose(found, TRUTH.evaluate(*angles), rtol=0.02)
    assert "(kept)" in printed(*command)
    assert "error of the fit " in printed("convert", table, tmp_path / "felt.binary")
    at_node = read_merl(tmp_path / "felt.binary").values[:, 30, 30, 90]  # theta_half 10, theta_diff 30 degrees
    np.testing.assert_allclose(at_node, TRUTH.evaluate(*angles), rtol=0.05)
