"""Robot of a simulated controller: arm, sensors, modes, inputs and outputs.

Programs and interfaces are not part of it.
"""
