"""What pytest leaves alone in here: the extensions need Sphinx, which the tests do without; drawings are programs."""

collect_ignore = ["_extensions", "conf.py"]
collect_ignore_glob = ["make_*.py"]
