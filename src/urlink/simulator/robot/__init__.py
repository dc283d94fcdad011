"""Robot of a simulated controller: the arm, its sensors, the modes, and the inputs and outputs.

Programs and interfaces are not part of this package.
"""
