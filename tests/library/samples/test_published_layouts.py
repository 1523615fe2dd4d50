"""Files in published layouts, with numbers of our own, of a truth that is known."""

from pathlib import Path

import numpy as np
import pytest

from dsbrdf import MeasurementFormatError
from dsbrdf.samples.reading import parse_samples, read_samples
from tests.library.samples.test_layouts import truth

FOLDER = Path(__file__).parent / "published"
SOURCES = {
    "alta.dat": "ALTA (Inria), isotropic formulation with theta view, theta light and |dphi|",
    "alta_half.alta": "ALTA (Inria), RUSIN_TH_TD_PD",
    "asphalt.xompt": "ASAM OpenMATERIAL 3D 1.1, material_brdf_schema.json",
    "azimuth_scans.txt": "a scan of the polar angle after each azimuth, which a line gives",
    "bird.brdf": "EURAMET project BiRD, data_json_schema_v1.0.json",
    "blacklab.txt": "ua-loft/bsdf-tools, a laboratory's spectra with src_z, src_a, view_z, view_a",
    "cornell_spectra.brdf": "pbrt-v2, src/materials/measured.cpp, and scenes/brdfs",
    "cosines.dat": "radiative transfer codes, cosines of angles and a relative azimuth",
    "e2387.txt": "ASTM E2387, names after VARS",
    "field_spectra.csv": "remote sensing, theta_s for the sun, theta_v for the viewer, -9999 for what is missing",
    "fields.txt": "NIST GOSI, a line for the name of each column",
    "fred.txt": "Photon Engineering, FRED help, Tabulated BSDF; ua-loft/bsdf-tools, write_fred.m",
    "fred_in_plane.txt": "Photon Engineering, FRED help, Tabulated BSDF, in-plane",
    "fred_scaled.txt": "ua-loft/bsdf-tools, rt300s_to_bsdf_iso.m, head without the words type and format",
    "grouped.csv": "a spreadsheet with groups of columns, radiance factors at two wavelengths",
    "kernels.dat": "AMBRALS, jgomezdans/BRDF_modelling, data.r2023.c87.dat",
    "lighttools.bsdf": "libbsdf, LightToolsBsdfReader",
    "micrometres.csv": "a column of wavelengths in um, exit zenith",
    "matrices.txt": "a matrix of the polar by the azimuth angle after each incidence",
    "mueller.csv": "a Mueller matrix in columns, f_r11 its first element",
    "pgii.txt": "pab advanced technologies' pgII and Mountain; Radiance, pabopto2bsdf(1)",
    "photometry.tab": "Planetary Data System, incidence, emission and phase angles",
    "polar_by_azimuth.csv": "a matrix of the polar by the azimuth angle, the incidence in its head",
    "rami.txt": "JRC, RAMI benchmark, measurements brfpp and brfop",
    "records.json": "a table saved by pandas as JSON records",
    "scans.csv": "a scan after each angle of incidence, which a line gives",
    "scatterometer.txt": "TMA CASI, angles from the mirror direction, a title before each scan",
    "speos.brdf": "Ansys help, Structure of BRDF files; Ansys' BSDF converter",
    "tekari.txt": "rgl-epfl/tekari, src/data_io.cpp",
    "transposed.csv": "a spreadsheet whose columns stand in lines, as J&C's RT-300S writes A, I, R",
    "two_azimuths.csv": "remote sensing, azimuths from north and from the sun, and a scattering angle",
    "viewing_by_wavelength.csv": "NIST STARR, wavelengths down and viewing angles across",
}


REFUSED = {
    "The column 'camera azimuth' is not understood, and may be an azimuth, which the table lacks": (
        "theta_in,camera azimuth,theta_out,brdf\n10,20,30,1\n10,40,30,1\n"
    ),
    "In 2 of 2 rows the phase angle is not between the difference and the sum of theta_in and theta_out": (
        "incidence phase emission value\n10 70 20 1\n30 5 60 1\n"
    ),
    "The JSON has no lists of numbers by name, such as theta_in": '{"data": {"theta_i": [], "brdf": "dark"}}',
    "is a label of the Planetary Data System; take the file that it describes": "PDS_VERSION_ID = PDS3\n",
    "begins with 'ScatterAzimuth 1', as tabular BSDF of Zemax, text of LightTools": (
        "ScatterAzimuth 1\n0\nScatterRadial 1\n0\nDataBegin\nAOI 0\n1e\n"
    ),
}


@pytest.mark.parametrize("words", REFUSED)
def test_other_files_are_refused_with_the_reason(words: str) -> None:
    with pytest.raises(MeasurementFormatError, match=words):
        parse_samples(REFUSED[words].encode())


@pytest.mark.parametrize("name", SOURCES)
def test_published_layouts_are_read(name: str) -> None:
    samples = read_samples(FOLDER / name)
    assert len(samples.values) >= 60
    np.testing.assert_allclose(samples.values, truth(samples.omega_in, samples.omega_out), rtol=2e-5)
    assert {path.name for path in FOLDER.iterdir()} == {*SOURCES}
