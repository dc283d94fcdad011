"""Fixtures of the library's own tests, which these tests need too."""

from __future__ import annotations

from tests.conftest import (
    leaves_nothing_that_keeps_the_interpreter as leaves_nothing_that_keeps_the_interpreter,
)
from tests.conftest import (
    own_port as own_port,
)
from tests.conftest import (
    time_of_the_test as time_of_the_test,
)
