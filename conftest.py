"""Plugins for all tests, those in docstrings and documents included."""

pytest_plugins = ["tests.collecting", "tests.watchdog", "tests.mosquitto", "tests.real_time", "tests.matrix"]
