"""Universal Robots arms for Prometheus: `RobotCollector` reads them at each scrape, `serve_metrics` answers HTTP."""

from __future__ import annotations

# Before urlink, so that a warning about another distribution of that name comes before an import fails.
import linkcore  # noqa: F401

from .metrics import RobotCollector
from .server import serve_metrics

__all__ = ["RobotCollector", "serve_metrics"]
