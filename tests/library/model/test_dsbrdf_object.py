import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from tests.support.random_models import SLICES, papers_model, random_model

Array = NDArray[np.float64]


def test_copies_are_equal_read_only_and_hash_alike() -> None:
    for model in (random_model(), papers_model(), random_model(family="student")):
        model.evaluate(0.1, 0.2)  # what is computed once must not travel stale
        for other in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model), copy.copy(model)):
            assert other == model
            assert hash(other) == hash(model)
            np.testing.assert_array_equal(other.evaluate(0.3, 0.4), model.evaluate(0.3, 0.4))
            with pytest.raises(ValueError, match="read-only"):
                other.kappa[0] = 2.0
        assert len(pickle.dumps(model)) < 3000 + 9 * sum(
            getattr(model, name).size for name in ("amplitude", "kappa", "gamma", "center", "elongation", "delta")
        )


def test_models_that_differ_in_anything_are_not_equal() -> None:
    model = random_model()
    state: list[Any] = list(model.__reduce__()[1])
    for index, value in enumerate(state):
        changed: Any = "student"
        if isinstance(value, np.ndarray):
            changed = value * (1.0 - 1e-12) if value.any() else value + 1e-12
        elif value != "hemi_epd":
            continue  # the interpolation cannot change alone
        other = DSBRDF(*[*state[:index], changed, *state[index + 1 :]])
        assert other != model, index
        assert hash(other) != hash(model)
    assert model != "a model"
    negative_zero = DSBRDF(*[*state[:4], np.where(model.center == 0.0, -0.0, model.center), *state[5:]])
    assert (negative_zero == model, hash(negative_zero)) == (True, hash(model))
    assert len({model, random_model(), random_model(1)}) == 2


def test_repr_is_short_and_says_what_it_is() -> None:
    text = repr(random_model())
    assert text == f"<DSBRDF: 4 lobes (hemi_epd), 4 knots, {random_model().n_numbers} numbers>"
    assert "1 lobe " in repr(random_model(n_lobes=1, family="student"))


def test_numbers_that_count() -> None:
    model = random_model()  # of the four lobes one has a center
    assert model.is_ring.tolist() == [False, True, False, False]
    assert model.n_numbers == 3 * 6 * 4 + 6 * 4 + 6 * 4 + 6 + 5 * 4
    assert papers_model().n_numbers == 3 * 4 * 3 * 3 + 3 * 4


def test_model_keeps_its_own_read_only_arrays() -> None:
    kappa = np.ones((3, 4, 2))
    model = DSBRDF(SLICES, kappa, kappa, kappa, interpolation="linear")
    kappa[:] = 5.0
    assert np.all(model.kappa == 1.0)
    for name in ("theta_diff", "amplitude", "kappa", "gamma", "center", "elongation", "delta"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(model, name)[...] = 2.0


ONE = np.ones((1, 2, 1))
GOOD: dict[str, Any] = {
    "theta_diff": [0.0, 0.5],
    "amplitude": np.ones((3, 2, 1)),
    "kappa": ONE,
    "gamma": ONE,
    "interpolation": "linear",
}


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"theta_diff": []}, "theta_diff must be a sequence of at least one knot"),
        ({"theta_diff": 0.3}, "theta_diff must be a sequence of at least one knot"),
        ({"theta_diff": "many"}, "theta_diff must be an array of numbers"),
        ({"theta_diff": [0.5, 0.5]}, "knots theta_diff must increase from 0 or more to at most pi/2"),
        ({"theta_diff": [0.0, 1.6]}, "knots theta_diff must increase from 0 or more to at most pi/2"),
        ({"shape_theta_diff": [-0.1, 0.5]}, "knots shape_theta_diff must increase from 0 or more to at most pi/2"),
        ({"elongation_theta_diff": [0.0, np.nan]}, "knots elongation_theta_diff must increase from 0 or more"),
        ({"amplitude": np.ones((3, 3, 1))}, r"amplitude must have shape \(3, 2, 1\), not \(3, 3, 1\)"),
        ({"amplitude": np.ones((3, 2))}, "amplitude and kappa must have three axes: channel, control value and lobe"),
        ({"amplitude": np.ones((1, 2, 1))}, r"amplitude must have shape \(3, 2, 1\), not \(1, 2, 1\)"),
        ({"kappa": np.ones((2, 2, 1))}, r"kappa must have shape \(3, 2, 1\), not \(2, 2, 1\)"),
        ({"gamma": np.ones((1, 2, 2))}, r"gamma must have shape \(1, 2, 1\), not \(1, 2, 2\)"),
        ({"center": np.ones((3, 2, 1))}, r"center must have shape \(1, 2, 1\), not \(3, 2, 1\)"),
        ({"elongation": np.ones((2, 1))}, r"elongation must have shape \(1, 1\), not \(2, 1\)"),
        ({"delta": np.ones((3, 1))}, r"delta must have shape \(3, 2\), not \(3, 1\)"),
        ({"kappa": 0.0 * ONE}, "every kappa must be positive"),
        ({"kappa": np.inf * ONE}, "every kappa must be finite"),
        ({"kappa": 701.0 * ONE}, "no kappa may exceed 700: values would leave the range of numbers"),
        ({"gamma": -ONE}, "every gamma must be zero or positive"),
        ({"gamma": np.nan * ONE}, "every gamma must be finite"),
        ({"gamma": 2e100 * ONE}, r"no gamma may exceed 1e\+100"),
        ({"amplitude": -np.ones((3, 2, 1))}, "every amplitude must be zero or positive"),
        ({"delta": np.full((3, 2), -1e-9)}, "every delta must be zero or positive"),
        ({"delta": np.full((3, 2), np.inf)}, "every delta must be finite"),
        ({"center": 1.7 * ONE}, r"every center must lie between -1\.57 and 1\.57 radians"),
        ({"elongation": np.full((1, 1), 11.0)}, "every elongation must lie between -10 and"),
        ({"interpolation": "magic"}, "interpolation must be one of linear, spline, not 'magic'"),
        ({"lobe": "gauss"}, "lobe must be one of hemi_epd, student, not 'gauss'"),
        (
            {"interpolation": "spline", "theta_diff": [0.3], "amplitude": np.zeros((3, 1, 1)), "kappa": ONE[:, :1],
             "gamma": ONE[:, :1]},
            "every amplitude must be positive for a spline, which is one of its logarithm",
        ),
    ],
)  # fmt: skip
def test_impossible_models_are_refused(changed: dict[str, Any], sentence: str) -> None:
    DSBRDF(**GOOD)
    with pytest.raises(InvalidArgumentError, match=sentence) as caught:
        DSBRDF(**(GOOD | changed))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("angle", [-1e-6, np.pi / 2 + 1e-5, np.nan, np.inf])
def test_angles_out_of_range_are_refused_by_name(angle: float) -> None:
    model = random_model()
    for name, call in (
        ("theta_half", lambda: model.evaluate([0.1, angle], 0.1)),
        ("theta_diff", lambda: model.evaluate(0.1, [0.1, angle])),
        ("theta_diff", lambda: model.parameters_at(angle)),
        ("theta_out", lambda: model.albedo(angle)),
    ):
        with pytest.raises(InvalidArgumentError, match=f"{name} must lie between 0 and 90 degrees"):
            call()


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda model: model.evaluate(0.1, 0.1, [0.0, np.nan]), "phi_diff must be finite"),
        (lambda model: model.evaluate(0.1, 0.1, np.inf), "phi_diff must be finite"),
        (
            lambda model: model.evaluate([0.1, 0.2], [0.1, 0.2, 0.3]),
            r"must broadcast against each other; got theta_half \(2,\), theta_diff \(3,\), phi_diff \(\)",
        ),
        (lambda model: model.evaluate_directions([0, 0, 1], [0, 0, 1.1]), "omega_out must be of unit length"),
        (lambda model: model.evaluate_directions([0, 0, np.nan], [0, 0, 1]), "omega_in contains NaN or infinity"),
    ],
)
def test_what_is_no_angle_or_direction_is_refused(call: Callable[[DSBRDF], Array], sentence: str) -> None:
    with pytest.raises(InvalidArgumentError, match=sentence):
        call(random_model())
