"""Programs of a simulated controller: loading them, running them cycle by cycle, and the teach pendant."""
