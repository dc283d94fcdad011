"""`urlink accept`: a test of this library and one controller together, which leaves evidence.

    stages -> logbook -> bundle -> evidence -> verdicts -> report

What the stages do and receive is written down, every byte of every connection among it. Verdicts are made of that
and of nothing else, so that whoever has the bundle comes to the same.
"""
