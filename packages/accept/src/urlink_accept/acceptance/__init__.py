"""Command `urlink accept`: a test of this library together with one controller, which stores the evidence.

    stages -> logbook -> bundle -> evidence -> verdicts -> report

The logbook contains everything that the stages do and receive, including every byte of every connection. Verdicts
depend only on the logbook, so everyone who has the bundle obtains the same verdicts.
"""
