"""A model as a MERL ``.binary`` table, for programs that read measurements."""

from dsbrdf.data.merl import encode_merl
from dsbrdf.model.dsbrdf import DSBRDF


def merl_table(model: DSBRDF) -> bytes:
    """Return the bytes of a MERL file with the values of a model at every node.

    Parameters
    ----------
    model : DSBRDF

    Returns
    -------
    bytes
        34,992,012 bytes.

    Raises
    ------
    MeasurementFormatError
        If a value is not finite.
    """
    return encode_merl(model.tabulate())
