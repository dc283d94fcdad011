"""Missions: SMR-CL, the language of DTU's mobile robot controller MRC, executed in Python.

The facts come from MRC's sources (LaserNavigation, 2014) and from recorded runs of MRC, which the tests repeat tick by
tick. `docs/smrcl.md` describes the language, and `profile.py` lists each difference from the original. Only the motion
`followwall2` has not been compared with a run of MRC.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.names import lazy_names

if TYPE_CHECKING:
    from linkcore.handle import Handle as Handle, Motion as Motion
    from ..errors import Mistake as Mistake
    from .mission import Debugger as Debugger, MissionRun as MissionRun
    from .server import MissionServer as MissionServer

else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "linkcore.handle": "Handle Motion",
            "rhdlink.errors": "Mistake",
            ".mission": "Debugger MissionRun",
            ".server": "MissionServer",
        },
    )
