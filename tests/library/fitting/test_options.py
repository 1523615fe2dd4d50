import dataclasses
from typing import Any

import numpy as np
import pytest

from dsbrdf import FitOptions, InvalidArgumentError, TableOptions
from dsbrdf.fitting.options import MAX_RING_LOBES
from tests.support.reproduced import assert_reproduced

REFUSED: dict[str, tuple[Any, ...]] = {
    "n_lobes": (0, 11, 2.0, True, "many"),
    "ring_lobes": (-1, MAX_RING_LOBES + 1, 1.0, False, None),
    "method": ("best",),
    "weighting": ("area",),
    "variation": ("cubic",),
    "lobe": ("gauss",),
    "knots_deg": ([9], [9, 9], [0.0, 0.5], [0, 90], [-1, 9], [0.0, np.nan], [0, True], [0, "9"], 5),
    "horizon_cutoff_deg": (0.0, 91, np.nan, 1e-11, True, "80"),
    "mask": (-0.1, 10.5, float("nan"), "1", None),
    "robust": (1, "yes", None),
    "em_iterations": (0, 10_001, 5.0, True),
    "weigthing": (3,),
    "zzz": (3,),
}
OF_THE_PAPER = {
    "ring_lobes": 1,
    "knots_deg": (0, 10),
    "weighting": "balanced",
    "variation": "parametric",
    "lobe": "student",
}
OF_TABLES: dict[str, tuple[Any, ...]] = {
    "columns": ("AOI", 3),
    "constants": ("theta_in=nan",),
    "missing": ("0", [0, np.nan], 10**400),
    "scale": (0, True),
    "phi": ("turned",),
}
CHOICES: list[dict[str, Any]] = [
    *({name: bad} for name, all_bad in (REFUSED | OF_TABLES).items() for bad in all_bad),
    *({"method": "paper", name: value} for name, value in OF_THE_PAPER.items()),
]


@pytest.mark.parametrize("chosen", CHOICES, ids=repr)
def test_a_wrong_choice_is_refused_in_one_sentence(chosen: dict[str, Any]) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        (TableOptions if chosen.keys() <= OF_TABLES.keys() else FitOptions)(**chosen)
    assert_reproduced(f"options/{chosen}"[:60], str(caught.value))


def test_what_lies_at_a_bound_is_a_right_choice() -> None:
    FitOptions(n_lobes=1, ring_lobes=0, mask=0.0, horizon_cutoff_deg=None, knots_deg=(0, 1), em_iterations=1)
    most = {"n_lobes": 10, "ring_lobes": MAX_RING_LOBES, "mask": 10, "horizon_cutoff_deg": 90.0, "em_iterations": 10**4}
    options = FitOptions(**most, knots_deg=tuple(range(90)))  # type: ignore[arg-type]
    assert {name: getattr(options, name) for name in most} == most
    assert dataclasses.replace(options) == options


def test_angles_are_radians_where_the_fit_computes() -> None:
    options = FitOptions(knots_deg=[0.0, 30, np.int64(89)], horizon_cutoff_deg=np.float32(45))  # type: ignore[arg-type]
    assert options.knots_deg == (0, 30, 89)
    assert options.knots == pytest.approx((0.0, np.pi / 6, np.radians(89.0)), rel=1e-15)
    assert options.horizon_cutoff == pytest.approx(np.pi / 4, rel=1e-15)


def test_the_default_is_the_automatic_global_fit() -> None:
    options = FitOptions()
    assert (options.method, options.n_lobes, options.ring_lobes) == ("global", "auto", "auto")
    assert (options.lobe, options.weighting, options.resolved_weighting) == ("hemi_epd", "auto", "balanced")
    assert (options.knots_deg, options.mask, options.resolved_mask) == ("auto", "auto", 0.0)
    paper = FitOptions(method="paper")
    assert (paper.resolved_weighting, paper.resolved_mask) == ("plain", 1.0)
    assert FitOptions(weighting="log").resolved_weighting == "log"


def test_numpy_numbers_and_booleans_are_taken_as_pythons_own() -> None:
    numpys = {"n_lobes": np.int64(2), "ring_lobes": np.int8(1), "robust": np.True_, "mask": np.float32(1)}
    own = {"n_lobes": 2, "ring_lobes": 1, "robust": True, "mask": 1.0}
    assert repr(FitOptions(**numpys)) == repr(FitOptions(**own))  # type: ignore[arg-type]
    for bad in (np.int64(11), np.True_):
        with pytest.raises(InvalidArgumentError, match="n_lobes"):
            FitOptions(n_lobes=bad)  # type: ignore[arg-type]
