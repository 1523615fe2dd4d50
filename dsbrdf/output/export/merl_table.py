"""A model as a MERL ``.binary`` table, which programs that read measurements open like one."""

from dsbrdf.data.merl import encode_merl
from dsbrdf.model.dsbrdf import DSBRDF


def merl_table(model: DSBRDF) -> bytes:
    """Return the bytes of a MERL file with the model's values at every node.

    Parameters
    ----------
    model : DSBRDF

    Returns
    -------
    bytes
        34,992,012 of them.

    Raises
    ------
    MeasurementFormatError
        If a value is not finite.
    """
    return encode_merl(model.tabulate())
