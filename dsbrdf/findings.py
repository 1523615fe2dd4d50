"""Define a finding: something to know about a measurement or a fit before its result is used."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Finding:
    """Tell a user one thing in a sentence, and a script the same thing by a code and by numbers.

    Attributes
    ----------
    code : str
        Kind of the finding, such as ``"clipped-highlight"``; `docs/faults.md` lists all codes.
    sentence : str
        What was noticed, and what can be done.
    numbers : dict of str to float
        The numbers in the sentence, by name.
    """

    code: str
    sentence: str
    numbers: dict[str, float] = field(default_factory=dict, hash=False)
