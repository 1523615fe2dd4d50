"""What is wrong with a document is said in words that someone who does not know pydantic understands."""

from functools import partial
from typing import Any

import pytest

from dsbrdf import InvalidArgumentError
from dsbrdf_service.api.fields import parse
from dsbrdf_service.api.fits import NewName
from dsbrdf_service.api.points import from_json


@pytest.mark.parametrize(
    ("read", "body", "said"),
    [
        (from_json, b"{}", "The request has no point; give theta_half_deg and theta_diff_deg, or"),
        (from_json, b'{"theta_half": 1}', "'theta_half' does not belong to a point; give theta_half_deg and"),
        (from_json, b'{"phi_diff_deg": 1}', "theta_half_deg is missing; theta_diff_deg is missing."),
        (from_json, b"[", "The body is not JSON: EOF while parsing a list at line 1 column 1."),
        (from_json, b"null", "The body must be an object; give theta_half_deg"),
        (
            from_json,
            b'{"theta_in_deg": "x", "theta_out_deg": [NaN]}',
            "theta_in_deg must be a list, not 'x'; theta_out_deg.0 must be a finite number",
        ),
        (
            from_json,
            b'{"omega_in": [[0, 1]], "omega_out": []}',
            "omega_in.0 must have at least 3 items, not 2.",
        ),
        (partial(parse, NewName), b'{"nam": "x"}', "Unknown 'nam'; known are name."),
        (partial(parse, NewName), b'{"name": 5}', "name must be a text, not 5."),
    ],
)
def test_fault_of_a_document_is_said_in_plain_words(read: Any, body: bytes, said: str) -> None:
    with pytest.raises(InvalidArgumentError) as refused:
        read(body)
    assert str(refused.value).startswith(said)
