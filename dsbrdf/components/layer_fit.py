"""Fit every structure of layers to values, and weigh the structures by their evidence.

Each structure is fitted from several starts (`dsbrdf.components.layer_descent`). Structures whose cost stays far behind
the best are dropped early. The weight of a structure is proportional to ``exp(-evidence / 4)``.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from dsbrdf.arrays import Array
from dsbrdf.components.layer_descent import EVIDENCE_SCALE, N_SAMPLES, Descent, FittedStructure, LayerData
from dsbrdf.components.layers import SpecularLayer
from dsbrdf.components.structures import STRUCTURES, LayerStructure

_TRIAL_STEPS = (5,)
_QUICK_TRIAL_STEPS = (2, 3)  # In a quick trial, all starts get two steps, and the better half of the starts three more.
_QUICK_TRIAL_STRIDE = 2  # Trials of a complete material use every second pair of directions.
_MAX_FIRST_STEPS = 10
_MAX_STEPS = 60
_MAX_REFINING_STEPS = 20
_MAX_TRIAL_COST_LEAD = 40.0  # After the trials, structures whose cost is higher than the best by more are dropped.
_MAX_COST_LEAD = 30.0  # After the first steps, a structure whose cost is higher than the best by more is dropped.
_MIN_CHANNEL_START = 0.05  # The colour of a layer starts with at least this fraction of its brightest channel.


def fit_structures(
    data: LayerData, structures: Sequence[LayerStructure] = STRUCTURES, *, quick: bool = False
) -> list[FittedStructure]:
    """Fit structures to data and sort the fits, the best first; structures far behind are dropped after a trial.

    If `quick`, trials use half of the data, and the worse half of the starts is dropped after two steps. Fits of
    scattered samples need the full trials, because two steps do not yet identify the best start.
    """
    unit = data.n_samples / N_SAMPLES
    found: list[FittedStructure] = []
    best = np.inf
    for trial in _trials(data, structures, quick=quick):
        if trial.prospect > best + _MAX_TRIAL_COST_LEAD * unit:
            break
        descent = replace(trial, data=data, done=False)
        descent.run(_MAX_FIRST_STEPS)
        if descent.prospect > best + _MAX_COST_LEAD * unit:
            continue
        descent.run(_MAX_STEPS)
        best = min(best, descent.prospect)
        found.append(descent.fitted())
    return sorted(found, key=lambda fitted: fitted.evidence)


def refined(data: LayerData, structure: LayerStructure, unknowns: Array) -> FittedStructure:
    """Fit one structure, starting from unknowns (U,) near the optimum."""
    descent = Descent(data, structure, unknowns, is_first=False)
    descent.run(_MAX_REFINING_STEPS)
    return descent.fitted()


def structure_weights(found: Sequence[FittedStructure]) -> Array:
    """Return the weights of fitted structures, which sum to 1 and follow from the evidence."""
    evidence = np.array([fitted.evidence for fitted in found])
    weights = np.exp((evidence.min() - evidence) / EVIDENCE_SCALE)
    return np.asarray(weights / weights.sum())


def _trials(data: LayerData, structures: Sequence[LayerStructure], *, quick: bool) -> "list[Descent]":
    """Take a few steps of the fit of every structure; return the fits so far, the most promising first."""
    if quick:
        data = data.thinned(_QUICK_TRIAL_STRIDE)
    trials: dict[str, Descent] = {}
    for structure in structures:
        if structure.parent in trials:
            structure = structure.started_from(trials[structure.parent].model)
        trials[structure.name] = _best_trial(data, structure, _QUICK_TRIAL_STEPS if quick else _TRIAL_STEPS)
    return sorted(trials.values(), key=lambda trial: trial.prospect)


def _best_trial(data: LayerData, structure: LayerStructure, stages: Sequence[int]) -> "Descent":
    """Return the best of the fits from all starts of a structure.

    `stages` are numbers of steps; only the better half of the starts enters the next stage.
    """
    trials = [Descent(data, structure, _start(data, structure, widths)) for widths in structure.starts]
    for steps in stages:
        for trial in trials:
            trial.run(steps)
        trials = sorted(trials, key=lambda trial: trial.prospect)[: -(-len(trials) // 2)]
    return trials[0]


def _start(data: LayerData, structure: LayerStructure, widths: tuple[float, ...]) -> Array:
    """Return start unknowns: the half widths [degrees], the best colours for them, and the prior's mean for the rest.

    The colours of the layers, and F90 of a specular layer, are found by linear least squares.
    """
    unknowns = structure.mean.copy()
    shapes, remaining = [], list(widths)
    for prior, part in zip(structure.layers, structure.slices, strict=True):
        own = unknowns[part]
        if prior.kind is SpecularLayer and remaining:
            own[6] = np.log(np.tan(np.radians(remaining.pop(0))) / np.sqrt(np.sqrt(2.0) - 1.0))
        white = np.concatenate([np.zeros(3), own[3:]])
        if prior.kind is SpecularLayer:
            white[3] = 0.0
        layer = prior.kind.linearize(data.points, white)
        shapes.append(layer.own[0])
        if layer.grazing is not None:
            shapes.append(layer.grazing)
    columns = np.stack(shapes)
    found = [nnls((columns * root).T, goal)[0] for root, goal in zip(data.root_weight, data.weighted, strict=True)]
    heights = iter(np.array(found).T)
    for prior, part in zip(structure.layers, structure.slices, strict=True):
        own, color = unknowns[part], next(heights)
        least = 0.1 * np.exp(prior.mean[0]) if prior.kind is SpecularLayer else 0.005
        own[:3] = np.log(np.maximum(color, _MIN_CHANNEL_START * max(float(color.max()), least)))
        if prior.kind is SpecularLayer:
            own[3] = np.log(np.clip(next(heights).mean(), 0.02, 1.2))
    return unknowns
