"""Streams, connections, recordings and handles, which urlink and rhdlink share.

Importing it warns if another distribution with a package `urlink` is installed. Every package of this project imports
linkcore first.
"""

from .distribution import warn_of_other as _warn_of_other

_warn_of_other()
