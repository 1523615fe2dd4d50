"""Types of parameters that several commands have, each with its help, its placeholder and its other names."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import CoercionError, Parameter, Token, convert

from dsbrdf.output.export import PARTS


def _whole_number(kind: Any, tokens: Sequence[Token]) -> Any:
    """Convert as cyclopts does, but refuse 2.5, which it would round."""
    (token,) = tokens
    if "." in token.value:
        raise CoercionError(token=token, target_type=kind)
    return convert(kind, tokens)


Whole = Parameter(converter=_whole_number, metavar="N")
ModelFile = Annotated[Path, Parameter(help="A .json or .npz file from dsbrdf fit.")]
SourceFile = Annotated[Path, Parameter(help="A .json or .npz model, or a .binary or .bsdf measurement.")]
RequiredFiles = Annotated[Path, Parameter(required=True)]
OutputFile = Annotated[Path, Parameter(alias="-o", metavar="FILE")]
OutputFolder = Annotated[Path, Parameter(alias="-o", metavar="DIR")]
Component = Annotated[
    str | None,
    Parameter(choices=PARTS, help="One component, or the guide (all components' own lobes), instead of the model."),
]
Jobs = Annotated[int | None, Whole]
Json = Annotated[bool, Parameter(help="Print one JSON document instead of text.")]
