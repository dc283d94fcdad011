"""Universal Robots arms for Prometheus: `RobotCollector` reads them at each scrape, `serve_metrics` answers HTTP."""

from __future__ import annotations

from .metrics import RobotCollector
from .server import serve_metrics

__all__ = ["RobotCollector", "serve_metrics"]
