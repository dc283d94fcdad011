"""An interrupted server rejects, for a while, commands that its clients might have abandoned."""

from __future__ import annotations

import pytest

from linkcore.clock import Expiry
from linkcore.errors import LinkTimeout


def test_expiry_rejects_commands_after_an_interruption() -> None:
    now = 100.0
    expiry = Expiry(4.0, lambda: now)
    now = 200.0  # no tick was recorded yet, so this is not an interruption
    expiry.check()
    assert not expiry.tick()
    now += 2.0
    expiry.check()
    now += 2.1
    for _ in range(2):
        with pytest.raises(LinkTimeout, match=r"interrupted for 2\.1 s.* nothing was done"):
            expiry.check()
    assert [expiry.tick(), expiry.tick()] == [True, False]
    for _ in range(39):
        now += 0.1
        assert not expiry.tick()
    with pytest.raises(LinkTimeout):
        expiry.check()
    now += 0.2
    expiry.check()
    now += 30.0
    assert expiry.tick()
