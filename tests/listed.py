"""Comparison of a list in a test or page with the names in the code; the message names the file to edit."""

from __future__ import annotations

from collections.abc import Collection

__all__ = ["assert_listed"]


def assert_listed(there: Collection[str], listed: Collection[str], where: str) -> None:
    """Fail if a list does not contain exactly the names in the code.

    Args:
        there: The names that the code has.
        listed: The names in the list.
        where: The list and its file, as in "NAMES in tests/urlink/test_public_names.py".
    """
    missing, surplus = sorted(set(there) - set(listed)), sorted(set(listed) - set(there))
    told = [
        *([f"add to {where}: {', '.join(missing)}"] if missing else []),
        *([f"remove from {where}, or restore in the code: {', '.join(surplus)}"] if surplus else []),
    ]
    assert not told, "\n".join(told)
