"""Files in published layouts, with numbers of our own, of a truth that is known."""

from pathlib import Path

import numpy as np
import pytest

from dsbrdf.samples.reading import read_samples
from tests.library.samples.test_layouts import truth

FOLDER = Path(__file__).parent / "published"
SOURCES = {
    "alta.dat": "ALTA (Inria), isotropic formulation with theta view, theta light and |dphi|",
    "alta_half.alta": "ALTA (Inria), RUSIN_TH_TD_PD",
    "asphalt.xompt": "ASAM OpenMATERIAL 3D 1.1, material_brdf_schema.json",
    "blacklab.txt": "ua-loft/bsdf-tools, a laboratory's spectra with src_z, src_a, view_z, view_a",
    "cornell_spectra.brdf": "pbrt-v2, src/materials/measured.cpp, and scenes/brdfs",
    "e2387.txt": "ASTM E2387, names after VARS",
    "fred.txt": "Photon Engineering, FRED help, Tabulated BSDF; ua-loft/bsdf-tools, write_fred.m",
    "fred_in_plane.txt": "Photon Engineering, FRED help, Tabulated BSDF, in-plane",
    "fred_scaled.txt": "ua-loft/bsdf-tools, rt300s_to_bsdf_iso.m, head without the words type and format",
    "lighttools.bsdf": "libbsdf, LightToolsBsdfReader",
    "micrometres.csv": "a column of wavelengths in um, exit zenith",
    "mueller.csv": "a Mueller matrix in columns, f_r11 its first element",
    "pgii.txt": "pab advanced technologies' pgII and Mountain; Radiance, pabopto2bsdf(1)",
    "polar_by_azimuth.csv": "a matrix of the polar by the azimuth angle, the incidence in its head",
    "scans.csv": "a scan after each angle of incidence, which a line gives",
    "speos.brdf": "Ansys help, Structure of BRDF files; Ansys' BSDF converter",
    "tekari.txt": "rgl-epfl/tekari, src/data_io.cpp",
    "transposed.csv": "a spreadsheet whose columns stand in lines, as J&C's RT-300S writes A, I, R",
}


@pytest.mark.parametrize("name", SOURCES)
def test_published_layouts_are_read(name: str) -> None:
    samples = read_samples(FOLDER / name)
    assert len(samples.values) >= 60
    np.testing.assert_allclose(samples.values, truth(samples.omega_in, samples.omega_out), rtol=2e-5)
    assert {path.name for path in FOLDER.iterdir()} == {*SOURCES}
