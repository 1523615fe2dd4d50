"""Writes what this release stores, once a release: ``python -m tests.support.stored_fits tests/project/stored/1.0``.

A fit as JSON, values of its model, and a service's database with the same fit, without the measurement.
"""

import json
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

import dsbrdf
from dsbrdf.data import encode_merl
from tests.support.merl_files import glossy_plastic
from tests.support.server import Server

THETA_HALF = np.radians([[0.0], [5.0], [20.0], [60.0]])
THETA_DIFF = np.radians([0.0, 30.0, 60.0])


def write(folder: Path) -> None:
    folder.mkdir(parents=True)
    measurement = glossy_plastic()
    result = dsbrdf.fit(measurement, n_lobes=2)
    dsbrdf.save(result, folder / "plastic.json")
    values = result.model.evaluate(THETA_HALF, THETA_DIFF)
    (folder / "values.json").write_text(json.dumps(values.tolist(), indent=1))
    with tempfile.TemporaryDirectory() as scratch:
        server = Server(Path(scratch) / "data").start()
        headers = {"Content-Type": "application/octet-stream"}
        server.http.post("/v1/fits?n_lobes=2", content=encode_merl(measurement), headers=headers).raise_for_status()
        server.stop()
        shutil.copy(server.data_dir / "dsbrdf.sqlite", folder)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
