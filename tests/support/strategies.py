"""Hypothesis strategies of more than one test, and how many examples they are given."""

import struct

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from dsbrdf import DSBRDF

SPECIAL = (np.nan, np.inf, -np.inf, -1.0, -0.0, 0.0, 5e-324, 1.7e308, 1.5e11, -1.7e308)

MODEL = DSBRDF(
    theta_diff=np.array([0.0, 0.7, 1.5]),
    amplitude=np.full((3, 5, 2), 0.3),
    kappa=np.full((1, 1, 2), 0.3),
    gamma=np.full((1, 1, 2), 4.0),
    elongation=np.array([[0.5, -0.5]]),
    shape_theta_diff=np.zeros(1),
    delta=np.zeros((3, 3)),
)


def examples(share: float) -> settings:
    """Return settings with a multiple of the number of examples that the profile has."""
    return settings(max_examples=max(1, round(share * settings().max_examples)))


@st.composite
def arrays(draw: st.DrawFn) -> bytes:
    """A .npy file whose header promises anything."""
    shape = draw(st.lists(st.one_of(st.integers(0, 4), st.integers(-2, 2**62)), max_size=4).map(tuple))
    kind = draw(
        st.sampled_from(["<f8", ">f8", "<f2", "<i8", "|O", "<U9", "|b1", "<c16", "|V8", "<M8[s]", "|S0", "x", ""])
    )
    header = draw(
        st.one_of(
            st.just(f"{{'descr': {kind!r}, 'fortran_order': {draw(st.booleans())}, 'shape': {shape}, }}"),
            st.text(st.characters(codec="latin-1"), max_size=60),
        )
    ).encode("latin-1")
    version = draw(st.sampled_from([b"\1\0", b"\2\0", b"\3\0", b"\0\0", b"\xff\xff"]))
    length = struct.pack("<H" if version == b"\1\0" else "<I", draw(st.sampled_from([len(header), 0, 65535])))
    values = draw(st.one_of(st.binary(max_size=200), st.just(np.full(18, 0.5).tobytes())))
    return b"\x93NUMPY" + version + length + header + values
