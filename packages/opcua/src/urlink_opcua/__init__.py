"""Universal Robots arms over OPC UA: a `Server` has the state of robots as variables, and methods for programs.

Everyone who can connect may read. Writing a register and calling a method need `Server(allow=True)`, an encrypted
channel, and a password or a trusted certificate (`Access`).
"""

from __future__ import annotations

# Before urlink: the warning about another distribution named linkcore must come before an import fails.
import linkcore  # noqa: F401

from .access import Access
from .server import Server

__all__ = ["Access", "Server"]
