"""The robot of a simulated controller: arm, sensors, modes, inputs and outputs, without programs and interfaces."""
