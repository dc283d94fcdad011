"""What pytest leaves alone in here: extensions need Sphinx, which the tests do without; drawings are programs."""

collect_ignore = ["_extensions", "_plots", "conf.py"]
collect_ignore_glob = ["make_*.py"]
