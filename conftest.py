"""Pytest plugins for all tests, including the examples in docstrings and documents."""

pytest_plugins = [
    "tests.collecting",
    "tests.watchdog",
    "tests.mosquitto",
    "tests.platforms",
    "tests.real_time",
    "tests.matrix",
]
