"""Missions: SMR-CL, the language of DTU's mobile robot controller MRC, executed in Python.

Where the facts come from: MRC's sources (LaserNavigation, 2014) and recorded runs of it, which the tests repeat tick by
tick. `docs/smrcl.md` describes the language, and `profile.py` has each difference from the original. What has not been
compared with a run of it: `followline`, `followwall`, `followwall2` and `align`.
"""
