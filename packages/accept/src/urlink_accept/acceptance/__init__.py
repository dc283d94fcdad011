"""Test of one controller together with this library, for the command `urlink accept`. The evidence is stored.

    stages -> logbook -> bundle -> evidence -> verdicts -> report

The logbook contains everything that the stages do and receive, including every byte of every connection. Verdicts
depend only on the logbook, so everyone who has the bundle obtains the same verdicts.
"""
