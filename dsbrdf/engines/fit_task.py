"""The computation of one fit, in one step or in the three that an engine takes which computes elsewhere.

    compute:  file -> outcome
    reduce:   file -> parcel        fit_parcel:  parcel -> outcome        complete:  outcome, same file -> outcome

The first and the last of the three need the measurement's file; only the parcel travels. Both ways give the same
document to the last bit, apart from the timings.
"""

import logging
import pickle  # nosec B403
import time
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from dsbrdf.data.merl import read_merl
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.engines.engine import Fault, FitTask, Fitted, Outcome
from dsbrdf.errors import ConvergenceWarning, DSBRDFError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit, profiles_for, with_samples
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.serialize import from_json, to_json

Report = Callable[[float], None]

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Parcel:
    """What travels: the profiles to fit; those to judge the fit by, where they are others; seconds that it took."""

    fitted: Profiles
    plain: Profiles | None
    seconds: float


@dataclass(frozen=True)
class Reduced:
    """A measurement's parcel, and the digest of the file that it was made of."""

    packed: bytes
    sha256: str


def outcome_of(work: Callable[..., Any], *arguments: Any) -> Any:
    """Call one of the functions below; every failure of the fit is an outcome, not an exception."""
    try:
        return work(*arguments)
    except DSBRDFError as error:
        return Fault("input", type(error).__name__, str(error))
    except MemoryError:
        return Fault("compute", "MemoryLimit", "The fit needs more memory than a fit may use.")
    except OSError as error:
        logger.exception("a measurement could not be read")
        reason = error.strerror or type(error).__name__
        return Fault("system", "MeasurementUnreadable", f"The stored measurement could not be read: {reason}.")
    except Exception as error:
        logger.exception("a fit broke")
        message = f"The computation broke with {type(error).__name__}; the log has the details."
        return Fault("compute", "InternalError", message)


def compute(task: FitTask, report: Report) -> Outcome:
    """Fit the measurement of `task`."""
    measurement = read_merl(task.path)
    with _sentences() as sentences:
        result = fit(measurement, task.options, progress=report)
    return _fitted(result, sentences)


def reduce(task: FitTask, _: Report) -> Reduced:
    """Pack what a fit of the measurement of `task` needs elsewhere; some 0.3 MB, or twice that if weighted."""
    measurement = read_merl(task.path)
    begin = time.perf_counter()
    fitted = profiles_for(measurement, task.options)
    seconds = time.perf_counter() - begin
    plain = profiles(measurement, horizon_cutoff=task.options.horizon_cutoff) if fitted.weighted else None
    return Reduced(zlib.compress(pickle.dumps(_Parcel(fitted, plain, seconds)), 1), measurement.sha256)


def fit_parcel(packed: bytes, options: FitOptions, report: Report) -> Outcome:
    """Fit what `reduce` has packed; what only the samples can tell is missing from the report."""
    # Who sends the parcel also sends the code that opens it.
    parcel: _Parcel = pickle.loads(zlib.decompress(packed))  # noqa: S301  # nosec B301
    with _sentences() as sentences:
        result = fit(parcel.fitted, options, plain=parcel.plain, progress=report)
    timings = result.report.timings | {"profiles": parcel.seconds}
    return _fitted(FitResult(result.model, replace(result.report, timings=timings)), sentences)


def complete(fitted: Fitted, task: FitTask, sha256: str, _: Report) -> Outcome:
    """Add to the report of `fit_parcel` what only the samples can tell; they have to be those of the parcel."""
    model, report = from_json(fitted.document)
    if report is None:
        raise ValueError("the document of a fit has a report")
    measurement = read_merl(task.path)
    if measurement.sha256 != sha256:
        return Fault("system", "MeasurementChanged", "The measurement's file was changed while it was being fitted.")
    return _fitted(with_samples(FitResult(model, report), measurement), fitted.warnings)


@contextmanager
def _sentences() -> Iterator[list[str]]:
    """Collect what a fit says about its convergence."""
    sentences: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ConvergenceWarning)
        yield sentences
    sentences += [str(warning.message) for warning in caught if issubclass(warning.category, ConvergenceWarning)]


def _fitted(result: FitResult, sentences: "list[str] | tuple[str, ...]") -> Fitted:
    return Fitted(to_json(result.model, result.report), dict(result.report.metrics), tuple(sentences))
