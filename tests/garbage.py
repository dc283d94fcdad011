"""Check that a block of a test leaves no reference cycles."""

from __future__ import annotations

import collections
import contextlib
import gc
from collections.abc import Iterator


@contextlib.contextmanager
def no_garbage() -> Iterator[None]:
    """Fail if the block leaves objects that only the garbage collector can free, and name their types.

    The collector must be off within the block.
    """
    gc.collect()
    try:
        yield
        gc.set_debug(gc.DEBUG_SAVEALL)
        found = gc.collect()
        kinds = collections.Counter(type(each).__qualname__ for each in gc.garbage)
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
    assert not found, f"{found} objects in cycles: {kinds.most_common(12)}"
