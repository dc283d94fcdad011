"""The robot of a simulated controller: arm, sensors, modes, inputs and outputs. It knows neither programs nor ports."""
