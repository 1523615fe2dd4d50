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


def test_a_measurement_becomes_a_bsdf_file_and_a_file_of_its_own_kind_a_copy(
    plastic_file: Path, tmp_path: Path
) -> None:
    output = tmp_path / "plastic.bsdf"
    run("convert", plastic_file, output)
    assert parse_tensors(output.read_bytes())["rgb"].shape[2] == 3
    for source in (plastic_file, output):
        run("convert", source, tmp_path / f"copy{source.suffix}")
        assert (tmp_path / f"copy{source.suffix}").read_bytes() == source.read_bytes()
    run("convert", output, tmp_path / "spectral.bsdf", "--spectral")
    assert "spectra" in parse_tensors((tmp_path / "spectral.bsdf").read_bytes())


def test_an_rgl_file_becomes_a_merl_file_and_what_that_cannot_hold_is_told(tmp_path: Path) -> None:
    source, output, model = tmp_path / "paint.bsdf", tmp_path / "paint.binary", single_lobe(1.0, 1.0, 0.2)
    source.write_bytes(rgl_bsdf(model))
    answer = run("convert", source, output)
    assert ": non reciprocity 0.0%" in answer.stdout
    assert answer.stderr == ""
    expected = model.evaluate(THETA_HALF[20], THETA_DIFF[30], PHI_DIFF[90])
    np.testing.assert_allclose(read_merl(output).values[:, 20, 30, 90], expected, rtol=0.02)
    # One order of the directions is brighter than the other: by a factor that grows with the first angle.
    fields = dict(parse_tensors(source.read_bytes()))
    fields["rgb"] = (fields["rgb"] * (1.0 + 1.5 * fields["theta_i"])[:, None, None, None]).astype(np.float32)
    source.write_bytes(encode_tensors(fields))
    answer = run("convert", source, output, "--json")
    assert "warning: " in answer.stderr
    assert json.loads(answer.stdout)["non_reciprocity"] == pytest.approx(expected_difference(1.5), abs=0.02)


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
