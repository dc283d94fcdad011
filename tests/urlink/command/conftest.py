"""Every test of this folder compares what a lock guards with the lock."""

from tests.worlds.guarded import guards

__all__ = ["guards"]
