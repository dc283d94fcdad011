"""What pytest leaves alone in here: the extensions need Sphinx, which the tests do without."""

collect_ignore = ["_extensions", "conf.py"]
