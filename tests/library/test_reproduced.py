"""What the library makes of inputs of many kinds is what it has made of them before."""

import json
import re
from base64 import b64decode
from dataclasses import asdict, astuple, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text

import dsbrdf
from dsbrdf import (
    DSBRDF,
    EnvironmentMap,
    Finding,
    FitResult,
    Measurement,
    ScatteredSamples,
    decompose,
    plot,
    render_sphere,
    space,
)
from dsbrdf.cli.commands import command_names
from dsbrdf.data import spherical
from dsbrdf.fitting import SelectionStep
from dsbrdf.fitting.lobe_search import SearchStep
from dsbrdf.output import to_json
from dsbrdf.output.atlas import load_material
from dsbrdf.output.figures import overview_figure, parameters_figure, residual_figure
from dsbrdf.output.notebook import html
from dsbrdf.output.sphere_panels import compare_spheres, side_by_side, thumbnail
from dsbrdf.samples.prediction import SamplePrediction
from dsbrdf.samples.scattered_fit import (
    expected_error,
    left_out_errors,
    left_out_values,
    pairs_to_measure,
    unconfirmed_sample,
)
from tests.library.samples.test_layouts import HABITS, PUBLISHED
from tests.library.samples.test_reading import DIRECTION, table
from tests.library.samples.test_tables_as_people_have_them import CLIPPED, GRID
from tests.support.command_line import load_fit, run
from tests.support.models import (
    LAYERS,
    MODELS,
    in_plane,
    mixture,
    samples_table,
    scattered_directions,
    scattered_samples,
    single_lobe,
)
from tests.support.reproduced import assert_reproduced, digest

pytestmark = pytest.mark.slow
MODEL_FILE = Path(__file__).parents[1] / "project/stored/1.0/plastic.json"
STORED_FIT = load_fit(MODEL_FILE)
ATLAS = ("acrylic_felt_pink", "aurora_white", "chm_mint", "colodur_azure_4e", "cg_sunflower")


@pytest.mark.parametrize("name", [*ATLAS, "layers", "mixture", "rings"])
def test_components(name: str) -> None:
    known: dict[str, Any] = {"layers": LAYERS, "mixture": mixture(3, 0), "rings": MODELS["elongated rings and cusps"]}
    document = json.loads(to_json(MODELS["mixture"], None, decompose(known.get(name) or load_material(name))))
    for part in document["components"]:
        part["lobe"] = digest(part["lobe"]["height"])
        part["layers"] = [digest(np.hstack([*layer.values()])) for layer in part["layers"]]
    document["structures"] = {one["name"]: one["weight"] for one in document["structures"]}
    kept = ("findings", "components", "structures", "diffuse_range", "alternatives")
    assert_reproduced(f"components/{name}", {key: document[key] for key in kept}, 1e-3)


def drawing(figure: Figure) -> list[dict[str, Any]]:
    """What a figure shows: its curves, points, pictures and words."""
    return [
        {
            "words": [text.get_text() for text in ax.findobj(Text) if isinstance(text, Text) and text.get_text()],
            "lines": [f"{line.get_label()} {line.get_linestyle()} {line.get_color()}" for line in ax.lines],
            "curves": [digest(line.get_ydata()) for line in ax.lines],
            "limits": ax.get_ylim(),
            "places": digest(np.concatenate([line.get_xdata() for line in ax.lines] or [[]])),
            "pictures": [digest(np.asarray(image.get_array())) for image in ax.images],
            "points": [digest(points.get_offsets()) for points in ax.collections],
        }
        for ax in figure.findobj(Axes)
        if isinstance(ax, Axes)
    ]


IN_PLANE = in_plane(STORED_FIT.model)


def test_figures(plastic: Measurement) -> None:
    data, black = dsbrdf.profiles(plastic), MODELS["paper"].select((), with_delta=False)
    aside = IN_PLANE.take(IN_PLANE.omega_out[:, 2] < 0.98)
    dark = np.where(aside.values > np.median(aside.values), aside.values, 0.0)
    aside = replace(aside, omega_out=aside.omega_out[:, [1, 0, 2]], values=dark)
    figures = {
        "fit": plot(STORED_FIT, plastic),
        "samples": plot(STORED_FIT, IN_PLANE),
        "components": plot(STORED_FIT),
        "component": plot(decompose(STORED_FIT)["diffuse"]),
        "measurement": plot(plastic),
        "materials": plot({"fit": STORED_FIT, "plastic": plastic, "layers": LAYERS}),
        "black model": parameters_figure(black),
        "black model beside data": overview_figure(data, black),
        "samples off their plane": plot(STORED_FIT, aside),
        "lobes": parameters_figure(MODELS["elongated rings and cusps"], title="rings", model_lobes=True),
        "lobes of each channel": parameters_figure(MODELS["paper"], model_lobes=True),
        "overview of lobes": overview_figure(data, MODELS["elongated rings and cusps"], model_lobes=True),
        "residual": residual_figure(data, STORED_FIT.model),
    }
    for name, figure in figures.items():
        assert_reproduced(f"figures/{name}", drawing(figure), 1e-3)


def test_what_notebooks_show(plastic: Measurement) -> None:
    finding = Finding("less", "less than <1 %>")
    warned = replace(STORED_FIT, report=replace(STORED_FIT.report, findings_of_fit=(finding,)))
    diffuse, layers = decompose(STORED_FIT)["diffuse"], decompose(STORED_FIT).layers
    shown: dict[str, Any] = {
        "fit": warned,
        "diffuse": diffuse,
        "layers": layers,
        "measurement": replace(plastic, name="<b>", sha256="0" * 64),
    }
    for name, one in shown.items():
        text, encoded, rest = re.split(r"(?<=base64,)([^\"]+)", html(one))
        picture = digest(imread(BytesIO(b64decode(encoded))))
        assert_reproduced(f"notebooks/{name}", [*text.split("<tr>"), *rest.split("<tr>"), picture], 1e-3)


def test_spheres(plastic: Measurement) -> None:
    pixels = np.random.default_rng(0).uniform(0.0, 1.0, (64, 128, 3)) ** 4
    pixels[20, 5::11] = np.linspace(3e3, 9e3, 12)[:, None]
    environment, even = EnvironmentMap.from_pixels(pixels), EnvironmentMap.from_pixels(np.ones((2, 4, 3)))
    found: dict[str, Any] = {"lights": [[*light.direction, *light.irradiance] for light in environment.lights]}
    found["even"] = repr(even)
    for lighting in ("three_lights", "environment", environment):
        for name in ("elongated rings and cusps", "paper"):
            found[f"{name} {lighting}"] = digest(render_sphere(MODELS[name], lighting=lighting, size=24))
    panels = compare_spheres(plastic, MODELS["mixture"], size=24)
    found |= {name: digest(panel) for name, panel in panels.panels.items()}
    found["side by side"] = digest(side_by_side(panels.panels))
    found["likeness"] = [panels.psnr, panels.ssim, panels.exposure]
    found["thumbnail"] = digest(imread(BytesIO(thumbnail(MODELS["mixture"], plastic))))
    found_space = space(MODELS)
    found["space"] = [digest(found_space.distance), digest(found_space.places), found_space.nearest("paper")]
    assert_reproduced("spheres/all", found, 1e-4)


def test_stages_of_a_fit_of_samples() -> None:
    directions, random = scattered_directions(mixture(2, 1), 50, 3), np.random.default_rng(1)
    values = LAYERS.evaluate_directions(*directions) * (1.0 + 0.02 * random.standard_normal((50, 3)))
    values[7] *= 9.0
    samples = ScatteredSamples.from_arrays(*directions, values, random.uniform(0.5, 1.5, 50))
    prediction, model = SamplePrediction.fit(samples), MODELS["mixture"]
    without = left_out_values(samples, prediction, model)
    total, rows = left_out_errors(samples, without, 1.3)
    found = {
        "structures": {one.structure.name: one.evidence for one in prediction.layers.found},
        "prediction": digest(prediction.evaluate_unmasked(*random.uniform(0.0, 1.2, (3, 50)))),
        "spread": [prediction.variance, prediction.noise, *prediction.reach],
        "left out": [digest(without), total, *map(asdict, rows)],
        "expected": expected_error(prediction, model, samples),
        "next": [astuple(pair) for pair in pairs_to_measure(prediction, model)[:5]],
        "doubted": [*unconfirmed_sample(samples, without)],
    }
    assert_reproduced("stages/prediction", found, 1e-3)


@pytest.mark.parametrize("name", [*MODELS, "one lobe"])
@pytest.mark.usefixtures("coarse_sampling")
def test_values_of_models(name: str) -> None:
    model, random = MODELS.get(name, single_lobe(1.0, 1.0)), np.random.default_rng(4)
    theta, phi = random.uniform(0.0, 1.5, (2, 60)), random.uniform(0.0, 6.0, (2, 60))
    pairs = spherical(theta[0], phi[0]), spherical(theta[1], phi[1])
    drawn = model.sample(pairs[0], random)
    found = {
        "values": digest(model.evaluate_directions(*pairs)),
        "albedo": model.albedo([0.0, 0.7, 1.4]),
        "drawn": [digest(drawn.omega_in), digest(drawn.weight)],
        "density": digest(model.pdf(*pairs)),
        "parameters": {key: digest(values) for key, values in model.parameters_at([0.1, 0.9, 1.5]).items()},
        "described": repr(model),
    }
    assert_reproduced(f"models/{name}", found, 1e-5)


@pytest.fixture(scope="module")
def spoiled(plastic: Measurement) -> Measurement:
    """With noise, a hole, outliers, and negative values."""
    random = np.random.default_rng(0)
    values = plastic.values * (1.0 + 0.1 * random.standard_normal(plastic.values.shape[1:]))
    values[:, 20, 30, ::7] *= 9.0
    values[2, 60:] -= 0.01
    return Measurement.from_values(values, plastic.valid & (random.uniform(size=plastic.valid.shape) > 0.1))


@pytest.mark.parametrize(("weighting", "robust"), [("plain", False), ("cosine", False), ("log", True)])
def test_reductions(weighting: str, robust: bool, spoiled: Measurement) -> None:
    data = dsbrdf.profiles(spoiled, weighting=weighting, robust=robust)
    found = {name: digest(getattr(data, name)) for name in ("mean", "weight", "within")}
    found |= {f"folded {name}": digest(getattr(data.folded, name)) for name in ("mean", "weight", "cos2_phi")}
    assert_reproduced(f"models/reduction {weighting}", found)


COMMANDS = (Path(__file__).parent / "commands.txt").read_text().splitlines()


@pytest.fixture(scope="module")
def folder(plastic_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that the commands read."""
    folder = tmp_path_factory.mktemp("commands")
    for path in (plastic_file, HABITS / "panel.csv", PUBLISHED / "scatterometer.txt"):
        (folder / path.name).symlink_to(path)
    samples = scattered_samples(mixture(2, 1), 60).take(np.arange(60) < 52)
    for name, content in {
        "clipped": table([*DIRECTION, "value"], np.column_stack([GRID, CLIPPED])),
        "plane": samples_table(IN_PLANE),
        "samples": samples_table(samples),
    }.items():
        (folder / f"{name}.csv").write_bytes(content)
    better = SelectionStep(1, -0.25, 1.5, None, 4.0, 2.5, True), SelectionStep(2, -0.5, 1.25, None, None, None, False)
    tried = SearchStep(n_lobes=2, ring_lobes=1, error=1.23e-3, kept=False)
    models: dict[str, FitResult | DSBRDF] = {
        "model": STORED_FIT,
        "plain": STORED_FIT.model,
        "compared": replace(STORED_FIT, report=replace(STORED_FIT.report, search=(tried,), selection=better)),
        "rings": MODELS["elongated rings and cusps"],
        "50%_gloss": MODELS["mixture"],
        "mixture": MODELS["mixture"],
        "black": STORED_FIT.model.select((), with_delta=False),
    }
    for name, model in models.items():
        dsbrdf.save(model, folder / f"{name}.json")
    return folder


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.usefixtures("coarse_sampling")
def test_commands(command: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a command prints, and the beginning of the texts that it writes."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "100")
    before = {*folder.iterdir()}
    answer = run(*command.split(), code=2 if "none.csv" in command else 0)
    told = json.loads(answer.stdout) if "--json" in command else answer.stdout.splitlines()
    new = [path for path in sorted({*folder.iterdir()} - before) if path.suffix not in (".png", ".pdf", ".json")]
    written = [path.read_text().replace(dsbrdf.__version__, "VERSION").splitlines()[:16] for path in new]
    assert_reproduced(f"commands/{command}", [told, answer.stderr, *written], 1e-3)


@pytest.mark.parametrize("command", command_names())
def test_flags_and_defaults(command: str) -> None:
    text = re.sub(r"\s+", " ", run(command, "--help").stdout)
    assert_reproduced(f"flags/{command}", " ".join(re.findall(r"--\w[\w-]*|\[(?:default|choices): [^\]]*\]", text)))
