"""Universal Robots arms over the Model Context Protocol (MCP): a `Server` offers tools that an agent can call.

Tools that read are always offered. Tools that move the arm or switch outputs need `Server(allow=True)`, robots with
limits of the session, and the consent of a person to each request. The client asks this person: the server sends the
question with the elicitation of the protocol. `stop` needs no consent.
"""

from __future__ import annotations

# Before urlink: the warning about another distribution named linkcore must come before an import fails.
import linkcore  # noqa: F401

from .server import Server

__all__ = ["Server"]
