"""The arm: models, kinematics, dynamics, poses, and the descriptions of an arm that other software reads."""
