"""Every test of this folder checks that guarded attributes are used only with their lock held."""

from tests.worlds.guarded import guards

__all__ = ["guards"]
