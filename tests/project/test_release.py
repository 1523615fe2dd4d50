"""What is released: one version, results of earlier releases, and docker/, as it can be seen without an engine."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import dsbrdf
from dsbrdf.data import encode_merl
from dsbrdf_service.settings import Settings
from tests.support.command_line import load_fit
from tests.support.merl_files import glossy_plastic
from tests.support.processes import short_folder
from tests.support.server import Server

ROOT = Path(__file__).parents[2]
STORED = sorted((Path(__file__).parent / "stored").iterdir())  # a folder for each release that stored something new
THETA_HALF = np.radians([[0.0], [5.0], [20.0], [60.0]])
THETA_DIFF = np.radians([0.0, 30.0, 60.0])
releases = pytest.mark.parametrize("folder", STORED, ids=lambda folder: folder.name)


def store(folder: Path, scratch: Path) -> None:
    """Write what this release stores, once a release: ``python -m tests.project.test_release FOLDER``.

    A fit as JSON, values of its model, and a service's database with the same fit, without the measurement.
    """
    folder.mkdir(parents=True)
    measurement = glossy_plastic()
    result = dsbrdf.fit(measurement, n_lobes=2)
    dsbrdf.save(result, folder / "plastic.json")
    values = result.model.evaluate(THETA_HALF, THETA_DIFF)
    (folder / "values.json").write_text(json.dumps(values.tolist(), indent=1))
    server = Server(scratch / "data").start()
    headers = {"Content-Type": "application/octet-stream"}
    server.http.post("/v1/fits?n_lobes=2", content=encode_merl(measurement), headers=headers).raise_for_status()
    server.stop()
    shutil.copy(server.data_dir / "dsbrdf.sqlite", folder)


def test_version_is_the_same_everywhere() -> None:
    version = dsbrdf.__version__
    assert re.fullmatch(r"\d+\.\d+\.\d+", version)
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    changelog = (ROOT / "CHANGELOG.md").read_text()
    assert re.findall(r"^## \[(\d.*?)\] - \d{4}-\d\d-\d\d$", changelog, re.MULTILINE)[0] == version


def test_first_release_of_this_major_version_is_there() -> None:
    assert f"{dsbrdf.__version__.partition('.')[0]}.0" in [folder.name for folder in STORED]


@pytest.mark.soak
def test_source_distribution_makes_a_wheel_whose_service_works(tmp_path: Path) -> None:
    def build(target: str, folder: Path) -> Path:
        command = [sys.executable, "-m", "hatchling", "build", "--target", target, "--directory", str(tmp_path)]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        (made,) = tmp_path.glob("*.whl" if target == "wheel" else "*.tar.gz")
        return made

    sources = build("sdist", ROOT)
    with tarfile.open(sources) as archive:
        archive.extractall(tmp_path, filter="data")
    with zipfile.ZipFile(build("wheel", tmp_path / sources.name.removesuffix(".tar.gz"))) as wheel:
        wheel.extractall(tmp_path / "installed")
    packages = {path.name for path in (tmp_path / "installed").iterdir() if path.suffix != ".dist-info"}
    assert packages == {"dsbrdf", "dsbrdf_service"}
    assert (tmp_path / "installed/dsbrdf/output/atlas/aurora_white.json").is_file()
    code = "from dsbrdf_service import app, settings; app.create_app(settings.Settings()).openapi();print(app.__file__)"
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "installed")}
    command = [sys.executable, "-P", "-c", code]
    answer = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == str(tmp_path / "installed/dsbrdf_service/app.py")


@releases
def test_model_stored_by_an_earlier_release_has_the_same_values(folder: Path) -> None:
    result = load_fit(folder / "plastic.json")
    expected = json.loads((folder / "values.json").read_text())
    np.testing.assert_allclose(result.model.evaluate(THETA_HALF, THETA_DIFF), expected, rtol=1e-12)
    assert result.report.options == dsbrdf.FitOptions(n_lobes=2)
    assert result.report.metrics.relative_rms is not None


@releases
def test_service_opens_the_database_of_an_earlier_release(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir(mode=0o700)
    shutil.copy(folder / "dsbrdf.sqlite", tmp_path / "data")
    expected = json.loads((folder / "values.json").read_text())[1][1]  # theta_half 5, theta_diff 30 degrees
    with Server.running(tmp_path / "data") as server:
        (fit,) = server.http.get("/v1/fits").raise_for_status().json()["items"]
        points = {"theta_half_deg": 5, "theta_diff_deg": 30}
        values = server.http.get(f"/v1/fits/{fit['id']}/brdf", params=points).raise_for_status().json()["values"]
    np.testing.assert_allclose(np.ravel(values), expected, rtol=1e-12)


DOCKER = ROOT / "docker"
COMPOSE = [DOCKER / "compose.yaml", DOCKER / "compose.cluster.yaml"]
TLS = DOCKER / "compose.tls.yaml"
DOCKERFILE = (DOCKER / "Dockerfile").read_text()


def tool(name: str) -> str:
    """The path of a linter, beside this Python or on the PATH; without it the test is skipped."""
    found = shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


def run(*command: str | Path) -> str:
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    return answer.stdout


def services(path: Path) -> Any:
    return yaml.safe_load(path.read_text())["services"]


def test_dockerfile_compose_files_and_script_pass_their_linters() -> None:
    run("bash", "-n", "docker/prove.sh")
    run(tool("compose-lint"), "--fail-on", "low", "--strict-config", "--config", DOCKER / ".compose-lint.yml", *COMPOSE)
    run(tool("hadolint"), "docker/Dockerfile")


def test_image_is_minimal_and_unprivileged() -> None:
    final = DOCKERFILE.rpartition("\nFROM ")[2]
    assert final.startswith("python AS service")
    assert re.search(r"^USER [1-9]\d+:[1-9]\d+$", final, re.MULTILINE)
    assert re.search(r"^HEALTHCHECK .*\\\n +CMD \[.*/health/ready", final, re.MULTILINE)
    assert re.search(r'^ENTRYPOINT \["dsbrdf"\]\nCMD \["serve"\]$', final, re.MULTILINE)
    assert not re.search(r"^ADD |curl |wget ", DOCKERFILE, re.MULTILINE)
    assert "pip" not in final
    installations = re.findall(r"pip (?:install|sync).*", DOCKERFILE)
    assert len(installations) == 4
    for line in installations:
        assert "--require-hashes" in line or "--offline" in line


def test_files_copied_by_the_dockerfile_are_let_in_and_exist() -> None:
    copied = re.findall(r"^COPY (?!--from)(.*) \S+$", DOCKERFILE, re.MULTILINE)
    sources = {word for line in copied for word in line.split()}
    assert len(sources) >= 8
    assert sources == set(re.findall(r"^!(.*)$", (DOCKER / "Dockerfile.dockerignore").read_text(), re.MULTILINE))
    assert all((ROOT / source).exists() for source in sources)


def test_image_holds_what_library_service_and_dask_need_and_no_tools() -> None:
    purposes = re.search(r"needs\.py (dependencies .*) > run.lock", DOCKERFILE)
    assert purposes
    assert set(purposes[1].split()) == {"dependencies", "service", "dask"}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras, lock = project["optional-dependencies"], (ROOT / "requirements.lock").read_text()
    direct = [*project["dependencies"], *extras["service"], *extras["dask"]]
    wanted = {re.split(r"[><=\[ ;]", name)[0].lower() for name in direct} - {"dsbrdf"}
    needs = run(sys.executable, DOCKER / "needs.py", *purposes[1].split())
    entries = re.findall(r"^\w(?:.*\\\n)+.*\n", needs, re.MULTILINE)
    assert all(entry in lock and "--hash=sha256:" in entry for entry in entries)
    here = {entry.partition("==")[0] for entry in entries}
    assert here >= wanted | {"starlette", "anyio", "click"}  # the last are what those need in turn
    assert here & {"pytest", "mypy", "ruff", "sphinx", "hypothesis", "playwright"} == set()
    assert "hatchling==" in run(sys.executable, DOCKER / "needs.py", "build-system")


@pytest.mark.parametrize("path", COMPOSE, ids=lambda path: path.name)
def test_every_setting_exists_and_fits_stay_within_the_memory_of_the_container(path: Path) -> None:
    names = set(re.findall(r"\bDSBRDF_[A-Z_]+", path.read_text() + DOCKERFILE))
    assert names <= {f"DSBRDF_{name.upper()}" for name in Settings.model_fields}
    for name, service in services(path).items():
        own = {name: value for name, value in service.get("environment", {}).items() if name.startswith("DSBRDF_")}
        texts = [re.sub(r"\$\{\w+:-(.*)\}", r"\1", str(value)) for value in own.values()]
        given = zip((name.removeprefix("DSBRDF_").lower() for name in own), texts, strict=True)
        settings = Settings(**dict(given))  # as text, like the environment's
        if name == "service":
            assert service["mem_limit"] == "4g"
            assert ((settings.workers or 0) + 1) * settings.fit_memory_mb <= 4096


def test_networks_isolate_service_and_cluster() -> None:
    document = yaml.safe_load((DOCKER / "compose.cluster.yaml").read_text())
    found = document["services"]
    assert {name for name, service in found.items() if "ports" in service} == {"proxy"}
    networks = {name: set(service["networks"]) for name, service in found.items()}
    open_ones = {name for name, network in document["networks"].items() if not (network or {}).get("internal")}
    assert {name for name, own in networks.items() if own & open_ones} == {"proxy"}
    assert not networks["proxy"] & (networks["scheduler"] | networks["worker"])  # who reaches those can run anything
    assert networks["scheduler"] | networks["worker"] < networks["service"]
    assert found["service"]["environment"]["DSBRDF_REQUIRE_KEYS"] == "true"
    for name in ("scheduler", "worker"):
        words = [*found[name]["entrypoint"], *found[name]["command"]]
        assert "--no-dashboard" in words
        assert words[words.index("--dashboard-address") + 1].startswith("127.0.0.1:")


def test_tls_adds_a_port_and_the_folder_of_its_files_to_nginx() -> None:
    assert set(services(TLS)) == {"proxy"}
    listening = re.search(r"^listen (\d+) ssl;", (DOCKER / "tls" / "tls.conf").read_text(), re.MULTILINE)
    assert listening
    assert services(TLS)["proxy"]["ports"] == [f"{listening[1]}:{listening[1]}"]
    (mount,) = services(TLS)["proxy"]["volumes"]
    folder, place, access = mount.split(":")
    assert access == "ro"
    assert (DOCKER / folder).resolve() == DOCKER / "tls"
    assert f"include {place}/*.conf;" in (DOCKER / "nginx.conf").read_text()
    assert "*.pem" in (DOCKER / "tls" / ".gitignore").read_text().splitlines()


def test_commands_of_the_docker_readme_name_existing_files() -> None:
    text = (DOCKER / "README.md").read_text()
    named = set(re.findall(r"--file (\S+)", text))
    assert named == {path.relative_to(ROOT).as_posix() for path in (*COMPOSE, TLS)}
    for path in re.findall(r"`((?:tests|service|docker)/\S+?)`", text):
        assert (ROOT / path).exists(), path


if __name__ == "__main__":
    with short_folder() as scratch:
        store(Path(sys.argv[1]), Path(scratch))
