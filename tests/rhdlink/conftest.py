"""Every test of this folder checks that attributes guarded by a lock are used only with the lock."""

from tests.worlds.guarded import guards

__all__ = ["guards"]
