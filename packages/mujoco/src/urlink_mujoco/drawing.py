"""Pictures of a world, drawn in one thread of their own.

An OpenGL context belongs to the thread in which it is current: MuJoCo's renderer neither draws nor is freed elsewhere
(`EGL_BAD_ACCESS`), and what is collected is freed in whichever thread the collector happens to run. So renderers are
made, used and, when the world is gone or the interpreter ends, freed in the same thread.
"""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Drawing"]

STATE = mujoco.mjtState.mjSTATE_INTEGRATION

#: What each drawing thread has of its own, which is freed in that thread when it ends.
_kept = threading.local()


class Drawing:
    """Draws states of a model. It has its own `MjData`, so that the world goes on meanwhile."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self._thread = ThreadPoolExecutor(1, "urlink-mujoco-drawing")

    def picture(self, state: NDArray[np.float64], camera: str, size: tuple[int, int], depth: bool) -> NDArray[Any]:
        """A camera's picture of a state, size as height and width; whatever OpenGL or MuJoCo raises."""
        return self._thread.submit(_drawn, self._model, state, camera, size, depth).result()


def _drawn(model: Any, state: NDArray[np.float64], camera: str, size: tuple[int, int], depth: bool) -> NDArray[Any]:
    if not hasattr(_kept, "data"):
        _kept.data, _kept.renderers = mujoco.MjData(model), {}
    if size not in _kept.renderers:
        _kept.renderers[size] = mujoco.Renderer(model, *size)
    mujoco.mj_setState(model, _kept.data, state, STATE)
    mujoco.mj_fwdPosition(model, _kept.data)
    renderer = _kept.renderers[size]
    renderer.update_scene(_kept.data, camera)
    if not depth:
        return np.array(renderer.render(), dtype=np.uint8)
    renderer.enable_depth_rendering()
    try:
        return np.array(renderer.render(), dtype=np.float32)
    finally:
        renderer.disable_depth_rendering()
