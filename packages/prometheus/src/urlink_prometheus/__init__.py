"""Universal Robots arms for Prometheus: `RobotCollector` reads them at each scrape, `serve_metrics` serves HTTP."""

from __future__ import annotations

# Before urlink: the warning about another distribution named linkcore must come before an import fails.
import linkcore  # noqa: F401

from .metrics import RobotCollector
from .server import serve_metrics

__all__ = ["RobotCollector", "serve_metrics"]
