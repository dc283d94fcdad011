"""Models, kinematics, dynamics and poses of robot arms, and conversions of an arm to formats of other software."""
