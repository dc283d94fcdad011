"""Images of a world, drawn in a dedicated thread.

An OpenGL context belongs to the thread that made it current. MuJoCo's renderer can be used and freed only in this
thread (`EGL_BAD_ACCESS`), but the garbage collector frees objects in any thread. So renderers are made, used and freed
in the same thread; they are freed when the world no longer exists or the interpreter ends.
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

#: Objects of each drawing thread, which are freed in this thread when it ends.
_kept = threading.local()


class Drawing:
    """Drawing of states of a model.

    It has its own `MjData`, so that the world can advance in the meantime.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        self._thread = ThreadPoolExecutor(1, "urlink-mujoco-drawing")

    def picture(self, state: NDArray[np.float64], camera: str, size: tuple[int, int], depth: bool) -> NDArray[Any]:
        """Return the image of a state from a camera, with size as height and width.

        Raises:
            Exception: If OpenGL or MuJoCo raises it.
        """
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
