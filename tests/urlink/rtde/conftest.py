"""Check, in every test of this folder, that guarded attributes change only with their lock held."""

from tests.worlds.guarded import guards

__all__ = ["guards"]
