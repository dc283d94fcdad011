"""Models, kinematics, dynamics and poses of arms, and descriptions of an arm for other software."""
