"""How a mission ends: exit codes, and the exceptions that lead to them.

``MissionError``
├── ``Refused``     nothing was commanded: bad input, no vehicle, a pre-flight check failed
├── ``Aborted``     broken off; says why, and what the vehicle shall do now
└── ``HandsOff``    someone else (pilot, failsafe) has the aircraft: nothing more is commanded
"""

from __future__ import annotations

import enum


class Exit(enum.IntEnum):
    """Exit codes of every mission."""

    DONE = 0
    REFUSED = 1
    USAGE = 2
    NOTHING = 3
    ABORTED = 4
    NOT_CONFIRMED = 5
    HANDS_OFF = 6
    INTERRUPTED = 130


MEANING = """\
exit codes: 0 flown to the end; 1 refused, nothing was commanded; 2 wrong usage; 3 flown, but the data do not suffice;
4 aborted, the vehicle confirmed its safe state; 5 aborted and NOT confirmed: act now; 6 the pilot or a failsafe took
over, nothing was commanded; 130 stopped by Ctrl-C, the vehicle confirmed its safe state"""


class Response(enum.Enum):
    """Action of the vehicle after an abort."""

    HOLD = "hold"
    RETURN = "rtl"


class MissionError(Exception):
    """Anything that ends a mission before its end."""


class Refused(MissionError):
    """Nothing was commanded."""


class Aborted(MissionError):
    """Broken off.

    Attributes
    ----------
    response : Response, optional
        What the vehicle shall do; None leaves it to ``--on-abort``.
    code : Exit
        What the script ends with once the vehicle has confirmed.
    """

    def __init__(self, why: str, response: Response | None = None, code: Exit = Exit.ABORTED) -> None:
        super().__init__(why)
        self.response = response
        self.code = code


class HandsOff(MissionError):
    """Someone else has the aircraft."""
