"""What is wrong with a document is said in words that someone who does not know pydantic understands."""

import pytest
from pydantic import BaseModel

from dsbrdf.errors import InvalidArgumentError
from dsbrdf_service.wire.inputs import AnglesRequest, DirectionsRequest, NewName, SidesRequest, parse_document


@pytest.mark.parametrize(
    ("kind", "body", "said"),
    [
        (AnglesRequest, b"{}", "theta_half_deg is missing; theta_diff_deg is missing."),
        (AnglesRequest, b"[", "The body is not JSON: EOF while parsing a list at line 1 column 1."),
        (AnglesRequest, b"null", "The body must be an object."),
        (
            SidesRequest,
            b'{"theta_in_deg": "x", "theta_out_deg": [NaN]}',
            "theta_in_deg must be a list; theta_out_deg.0",
        ),
        (
            DirectionsRequest,
            b'{"omega_in": [[0, 1]], "omega_out": []}',
            "omega_in.0 must have at least 3 items, not 2.",
        ),
        (NewName, b'{"nam": "x"}', "Unknown 'nam'; known are name."),
        (NewName, b'{"name": 5}', "name must be a text."),
    ],
)
def test_fault_of_a_document_is_said_in_plain_words(kind: type[BaseModel], body: bytes, said: str) -> None:
    with pytest.raises(InvalidArgumentError) as refused:
        parse_document(kind, body, strict=True)
    assert str(refused.value).startswith(said)
